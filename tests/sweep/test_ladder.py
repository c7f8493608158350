"""Where a training is cut, which members a rung has, and which points go on."""

from itertools import pairwise

import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, make_grid
from ovibjax.sweep.ladder import best_points, cuts_of, points_of


@given(st.integers(1, 2000), st.integers(1, 50), st.integers(2, 10))
def test_cuts_ascend_by_the_factor_to_the_end(units, every, factor):
    cuts = cuts_of(units * every, every, factor)
    assert cuts[-1] == units * every and list(cuts) == sorted(set(cuts)) and not any(cut % every for cut in cuts)
    for one, other in pairwise(cuts):
        assert one * factor >= other > (one - every) * factor
    if units >= 200:
        assert 1 / 16 <= cuts[0] / cuts[-1] <= 1 / 4.8  # about a ninth


def test_as_many_rungs_as_are_asked_for():
    assert cuts_of(10_000, 1, 3) == (1112, 3334, 10_000) and cuts_of(10_000, 1, 3, 1) == (10_000,)
    assert cuts_of(10_000, 1, 2) == (1250, 2500, 5000, 10_000) and cuts_of(8, 1, 2, 4) == (1, 2, 4, 8)
    assert cuts_of(5, 5, 3) == (5,), "nowhere to cut"
    for given_ in ((8, 1, 2, 5), (5, 5, 3, 2), (8, 1, 1), (8, 1, 3, 0)):
        with pytest.raises(InputError, match="rungs"):
            cuts_of(*given_)


def test_points_are_all_combinations_but_of_seeds():
    kind = Axis(("up", "down"), numbers=(4, 2))
    grid = make_grid({"seed": range(3), "x": [1.0, 2.0], "one": [7], "y": [3, 4], "kind": kind}, [["x", "y"]])
    points = points_of(grid)
    assert points.together == ("x", "y", "kind") and len(points) == 4 and points.seeds == 3
    trained = points.trained(np.array([3, 0, 3]), [5, 5, 9])
    assert trained.dims == ("seed", "x_y_kind_steps", "one") and trained.shape == (3, 3, 1)
    values = {name: list(axis.values) for name, axis in trained.axes.items()}
    assert values == {
        "seed": [0, 1, 2],
        "x": [2.0, 1.0, 2.0],
        "one": [7],
        "y": [4, 3, 4],
        "kind": ["down", "up", "down"],
        "steps": [5, 5, 9],
    }
    assert trained.codes("kind").tolist() == [2, 4, 2]


@pytest.mark.parametrize(
    ("axes", "zipped", "words"),
    [
        ({"steps": [1, 2]}, (), "axis steps: halving has one of this name"),
        ({"x": [1, 2], "seed": [1, 2]}, [["x", "seed"]], "seeds of a point live and die together"),
        ({"x": [1], "seed": [1, 2]}, (), "there is only one; give an axis several values"),
        ({"seed": [1, 2]}, (), "there is only one"),
    ],
)
def test_what_leaves_nothing_to_choose_is_refused(axes, zipped, words):
    with pytest.raises(InputError, match=words):
        points_of(make_grid(axes, zipped))


@given(st.integers(0, 10**6), st.integers(1, 12))
def test_the_best_points_are_those_of_a_slow_count(seed, keep):
    rng = np.random.default_rng(seed)
    score, diverged = rng.integers(-8, 8, (3, 12, 2)) / 4, rng.uniform(size=(3, 12)) < 0.05
    score[rng.uniform(size=score.shape) < 0.02] = rng.choice([np.nan, np.inf, -np.inf])
    data = xarray.Dataset({"loss": (("seed", "point", "k"), score), "diverged": (("seed", "point"), diverged)})
    means = {}
    for point in range(12):
        values = score[:, point].ravel().tolist()
        if np.isfinite(values).all() and not diverged[:, point].any():
            means[point] = sum(values) / len(values)
    ranked = sorted(means, key=lambda point: (means[point], point))
    assert best_points(data, "loss", "point", keep).tolist() == sorted(ranked[:keep])
