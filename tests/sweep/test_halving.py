"""Halving: what goes on, what a store holds of it, what a second command adds; nothing is computed twice."""

import resource

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep import program
from ovibjax.sweep.engine import Interrupted, run
from ovibjax.sweep.halving import halve
from ovibjax.sweep.staged import Staged
from ovibjax.sweep.store import open_dataset
from tests.sweep.members import same, snapshot_of
from tests.sweep.staged_members import AXES, DATA, STEPS, differences, halved, last_of, momentum


def given_losses(losses, steps=9):
    """Members whose loss after some steps is given, [points, seeds]; NaN diverges."""

    def judge(key, point, shared, state):
        return {"loss": shared[point["i"], point["seed"]] + 0.0 * state, "trained": state, "test_loss": -state}

    def go_on(key, point, shared, state, first, last):
        return jax.lax.fori_loop(first, last, lambda i, n: n + 1, state)

    fn = Staged(lambda key, point, shared: 0.0, go_on, judge, steps)
    return fn, {"i": range(len(losses)), "seed": range(len(losses[0]))}, np.float32(losses)


def by_rung(dataset):
    """Points of each rung, by its steps."""
    found = {}
    for steps, point in zip(dataset.steps.values.tolist(), dataset.i.values.tolist(), strict=True):
        found.setdefault(steps, []).append(point)
    return {steps: sorted(points) for steps, points in found.items()}


def test_the_best_points_go_on_with_all_their_seeds():
    losses = [[9, 1], [4, 4], [1, 9.5], [5, 5], [3, 6], [7, 7], [8, 8], [9, 9], [9, 9]]
    dataset = halve(*given_losses(losses), score="loss")
    assert by_rung(dataset) == {1: list(range(9)), 3: [0, 1, 4], 9: [1]}
    assert dataset.finished.all() and dict(dataset.sizes) == {"i_steps": 13, "seed": 2}
    np.testing.assert_array_equal(dataset.trained, np.broadcast_to(dataset.steps.values[:, None], (13, 2)))
    assert dataset.attrs["rungs"] == [{"steps": 1, "points": 9}, {"steps": 3, "points": 3}, {"steps": 9, "points": 1}]
    assert dataset.attrs["spent"] == pytest.approx((9 * 1 + 3 * 2 + 1 * 6) / 81)


def test_a_point_of_which_a_seed_diverged_is_the_worst():
    nan = float("nan")
    dataset = halve(*given_losses([[0, nan], [5, 5], [-1, np.inf], [6, 6], [7, 7], [nan, nan]]), score="loss", factor=2)
    assert by_rung(dataset) == {2: [0, 1, 2, 3, 4, 5], 3: [1, 3, 4], 5: [1], 9: [1]}
    # Fewer than were to go on, or none.
    dataset = halve(*given_losses([[5], [nan], [nan], [nan], [nan], [nan]]), score="loss", factor=2)
    assert by_rung(dataset)[3] == by_rung(dataset)[9] == [0]
    dataset = halve(*given_losses([[nan], [nan], [nan]]), score="loss")
    assert by_rung(dataset) == {1: [0, 1, 2]} and dataset.diverged.all()


def test_what_is_infinite_in_a_state_alone_has_not_diverged():
    fn = Staged(
        lambda key, point, shared: {"best": jnp.inf, "w": 1.0},
        lambda key, point, shared, state, first, last: jax.lax.fori_loop(
            first, last, lambda i, s: s | {"w": s["w"] * point["rate"]}, state
        ),
        lambda key, point, shared, state: {"loss": state["w"]},
        9,
    )
    assert not halve(fn, {"rate": [0.1, 0.2, 0.3]}, score="loss").diverged.any()


def test_all_rungs_are_one_program_per_stage_and_those_of_a_whole_training(tmp_path):
    before = program.compilations
    halved(lanes=5)
    assert program.compilations == before + 3
    run(momentum(), AXES, DATA, lanes=5)
    halved(lanes=5, factor=2, store=tmp_path / "a.zarr")
    assert program.compilations == before + 3


def test_the_same_again_computes_nothing_and_keeps_no_state(tmp_path):
    path, count = tmp_path / "a.zarr", []
    one = halved(store=path, on_progress=lambda *n: count.append(n))
    assert count[0] == (0, 57) and count[-1] == (57, 57)
    assert {entry.name for entry in path.iterdir()} == {"sweep.json", "members", "asked", "lock"}
    assert len(list((path / "asked").iterdir())) == 3
    before, compiled, seen = snapshot_of(path), program.compilations, []
    same(halved(store=path, on_progress=lambda *n: seen.append(n)), one)
    assert set(seen) == {(42, 57), (54, 57), (57, 57)}
    assert snapshot_of(path) == before and program.compilations == compiled
    whole = open_dataset(path)
    assert whole.finished.all() and whole.attrs["asked"] == 57 and whole.sizes["rate_decay_steps"] == 19
    same(halved(), one)


def test_more_points_and_seeds_add_to_a_store(tmp_path):
    """Also where a point goes on that did not before, and whose state is no longer there."""
    path = tmp_path / "a.zarr"
    few = AXES | {"rate": [0.1, 0.3, 1.0], "seed": range(2)}
    halved(axes=few, store=path)
    assert not (path / "states").exists()
    for axes in (AXES | {"seed": range(2)}, AXES, AXES | {"decay": [0.1, 0.2, 0.3], "seed": range(1, 4)}):
        seen = []
        grown = halved(axes=axes, store=path, on_progress=lambda *n, seen=seen: seen.append(n))
        fresh = halved(axes=axes)
        same(grown, fresh)
        assert 0 < seen[0][0] < seen[-1][0] == grown.finished.size
        assert not differences(grown, run(momentum(), axes, DATA))
    computed = []
    narrow = halved(axes=few, store=path, on_progress=lambda *n: computed.append(n))
    same(narrow, halved(axes=few))
    assert len(computed) == 3, "nothing but a look at every rung"


def test_a_damaged_state_is_computed_again(tmp_path):
    path = tmp_path / "a.zarr"

    def stop(done, total):
        if done == 42:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        halved(store=path, lanes=1, on_progress=stop)
    assert caught.value.dataset.finished.sum() == 42 and caught.value.dataset.attrs["asked"] == 57
    # What is to come is counted, so that whoever watches does not take the first rung for all.
    assert open_dataset(path).attrs["asked"] == 57
    files = sorted((path / "states").rglob("*/*"))
    assert len(files) == 42
    for i, file in enumerate(files):
        content = file.read_bytes()
        if i % 3 == 0:
            file.unlink()
        elif i % 3 == 1:
            file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    same(halved(store=path), halved(lanes=1))
    assert not (path / "states").exists() and open_dataset(path).attrs["asked"] == 57


def test_a_disk_without_room_for_states(tmp_path):
    """One line, what was judged stays, and the same command goes on with room."""
    path, limits = tmp_path / "a.zarr", resource.getrlimit(resource.RLIMIT_FSIZE)

    def big():
        def begin(key, point, shared):
            return jnp.full(20_000, point["rate"])

        def go_on(key, point, shared, state, first, last):
            return jax.lax.fori_loop(first, last, lambda i, w: w * 0.5, state)

        return Staged(begin, go_on, lambda key, point, shared, state: {"loss": state.mean()}, 9)

    def tight(done, total):
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000 if done >= 4 else limits[0], limits[1]))

    axes = {"rate": [0.1 * i for i in range(1, 10)]}
    try:
        with pytest.raises(
            InputError, match=r"cannot write \(File too large\); \d+ members are kept; make room"
        ) as caught:
            halve(big(), axes, score="loss", store=path, lanes=1, on_progress=tight)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert open_dataset(path).finished.sum() >= 4
    same(halve(big(), axes, score="loss", store=path), halve(big(), axes, score="loss", lanes=1))
    assert not list(path.rglob("*.partial")) and not (path / "states").exists()


def test_states_that_a_killed_command_left_at_its_end_go_with_the_next(tmp_path):
    path = tmp_path / "a.zarr"
    halved(store=path)
    (path / "states" / "9").mkdir(parents=True)
    (path / "states" / "9" / "x").write_text("left")
    (path / "asked" / "expected").write_text("99")
    assert open_dataset(path).attrs["asked"] == 99
    halved(store=path)
    assert not (path / "states").exists() and open_dataset(path).attrs["asked"] == 57


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"score": "los"}, "score los: there is no such output; there are loss, test_loss, trained"),
        ({"score": "test_loss"}, "score test_loss: chosen by a test, the winner's would tell nothing"),
        ({"factor": 1}, "halving by 1"),
        ({"rungs": 9}, "9 rungs by 3: a training of 9 pieces cannot be cut so often; ask for fewer rungs"),
        ({"zipped": [["i", "seed"]]}, "seeds of a point live and die together"),
    ],
)
def test_what_cannot_be_halved_is_refused(tmp_path, options, words):
    fn, axes, shared = given_losses([[1, 2], [3, 4]])
    with pytest.raises(InputError, match=words):
        halve(fn, axes, shared, store=tmp_path / "a.zarr", **{"score": "loss", **options})
    assert not (tmp_path / "a.zarr").exists()


def test_a_halving_is_never_mixed_with_other_sweeps(tmp_path):
    fn, axes, shared = given_losses([[1, 2], [3, 4], [5, 6]])
    halve(fn, axes, shared, score="loss", store=tmp_path / "h.zarr")
    run(fn, axes, shared, store=tmp_path / "p.zarr")
    for change in ({"factor": 2}, {"rungs": 2}, {"score": "trained"}):
        with pytest.raises(InputError, match="holds another sweep: halving"):
            halve(fn, axes, shared, store=tmp_path / "h.zarr", **{"score": "loss", **change})
    with pytest.raises(InputError, match=r"halving is .* there and absent here"):
        run(fn, axes, shared, store=tmp_path / "h.zarr")
    with pytest.raises(InputError, match="halving is absent there"):
        halve(fn, axes, shared, score="loss", store=tmp_path / "p.zarr")
    with pytest.raises(InputError, match="its data are others there"):
        halve(fn, axes, shared + 1, score="loss", store=tmp_path / "h.zarr")


def test_the_last_rung_is_that_of_the_whole_grid_on_it():
    dataset = halved()
    end = last_of(dataset)
    assert end.sizes["rate_decay_steps"] == 1 and (end.n == STEPS).all()
