"""A sweep gives what a plain loop over its points gives."""

import pickle
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.store import attach, open_dataset
from ovibjax.sweep.work import Along
from tests.sweep.members import DATA, same, small

OUTPUTS = {
    "walk": (4, np.float32),
    "fit.mean": (None, np.float32),
    "fit.deep.argmax": (None, np.int32),
    "positive": (4, np.bool_),
    "constant": (None, np.float32),
    "code": (None, np.int32),
}


def everything(key, point, shared):
    """All kinds of outputs, of draws, a value on two axes, a name and data."""
    draws = jax.random.normal(key, (4,))
    walk = jnp.cumsum(draws) * point["a"] + shared["table"][point["kind"]]
    return {
        "walk": walk,
        "fit": {"mean": walk.mean(), "deep": {"argmax": jnp.argmax(walk).astype(jnp.int32)}},
        "positive": (walk > 0) == point["flag"],
        "constant": 2.5,
        "code": point["kind"],
    }


def loop(fn, dataset, axes, shared, along=None):
    """Every member by itself, by the axes' own values."""
    dims = dataset.finished.dims
    expected = {}
    for at in np.ndindex(dataset.finished.shape):
        index = dict(zip(dims, at, strict=True))
        point, own = {}, shared
        for name, values in axes.items():
            i = index[next(d for d in dims if name in d.split("_"))]
            cast = {bool: np.bool_, int: np.int32, float: np.float32}
            point[name] = np.int32(i) if isinstance(values[i], str) else cast[type(values[i])](values[i])
            if name == along:
                own = shared[i]
        out = fn(jax.random.key(int(point.get("seed", 0))), point, own)
        flat = jax.tree_util.tree_leaves_with_path(out)
        for path, value in flat:
            name = ".".join(k.key for k in path)
            value = np.asarray(value)
            expected.setdefault(name, np.zeros((*dataset.finished.shape, *value.shape), value.dtype))[at] = value
    return expected


def check(fn, dataset, axes, shared, along=None):
    assert dataset.finished.all() and not dataset.diverged.any()
    for name, values in loop(fn, dataset, axes, shared, along).items():
        found = dataset[name].values
        assert found.shape == values.shape, name
        if values.dtype.kind == "f":
            np.testing.assert_allclose(found, values, rtol=1e-5, atol=1e-6, err_msg=name)
        else:
            np.testing.assert_array_equal(found, values, err_msg=name)


AXES = {
    "a": st.lists(st.floats(0.125, 3, width=16), min_size=1, max_size=4, unique=True),
    "kind": st.lists(st.sampled_from(["mean", "max", "vit", "sum"]), min_size=1, max_size=3, unique=True),
    "flag": st.sampled_from([[True], [False, True]]),
    "seed": st.lists(st.integers(-9, 2**31 - 1), min_size=1, max_size=5, unique=True),
}


TABLE = np.linspace(-1, 1, 4, dtype=np.float32)


@settings(max_examples=12, deadline=None)
@given(
    values=st.fixed_dictionaries(AXES),
    order=st.permutations(list(AXES)),
    seeded=st.booleans(),
    lanes=st.none() | st.integers(1, 6),
    along=st.sampled_from([None, None, "a", "seed", "kind"]),
)
def test_equals_a_loop(values, order, seeded, lanes, along):
    axes = {name: values[name] for name in order if name != "seed" or seeded}
    along = along if along in axes else None
    shared = {"table": TABLE}
    if along:
        shared = [{"table": TABLE + np.float32(i)} for i in range(len(axes[along]))]
    given_data = Along(along, shared) if along else shared
    dataset = run(everything, axes, given_data, lanes=lanes)
    assert dataset.finished.dims == tuple(axes)
    check(everything, dataset, axes, shared, along)


@pytest.mark.parametrize("lanes", [None, 1, 2])
def test_zipped_seed(lanes):
    axes = {"a": [0.5, 1.5], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True]}
    dataset = run(everything, axes, {"table": TABLE}, zipped=[("kind", "seed")], lanes=lanes)
    assert dataset.finished.dims == ("a", "kind_seed", "flag")
    assert dataset.seed.dims == dataset.kind.dims == ("kind_seed",)
    check(everything, dataset, axes, {"table": TABLE})


def test_all_axes_zipped():
    axes = {"a": [0.5, 1.5, 2.0], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True, False, True]}
    zipped = [("a", "seed", "kind", "flag")]
    check(everything, run(everything, axes, {"table": TABLE}, zipped=zipped, lanes=2), axes, {"table": TABLE})


def test_along_a_zipped_axis():
    axes = {"a": [0.5, 1.5], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True]}
    data = [{"table": TABLE * np.float32(i)} for i in range(3)]
    dataset = run(everything, axes, Along("kind", data), zipped=[("seed", "kind")], lanes=2)
    check(everything, dataset, axes, data, "kind")


def test_without_data():
    dataset = run(lambda key, point, shared: {"y": point["x"] * 2, "none": shared is None}, {"x": [1.0, 2.0]})
    assert dataset.y.values.tolist() == [2, 4] and dataset.none.values.tolist() == [True, True]


def test_dataset_is_labelled():
    dataset = run(
        everything,
        {"a": Axis((0.5, 1.0), "m"), "kind": ["x", "y"], "flag": [True], "seed": range(2)},
        {"table": TABLE},
        dims={"walk": ("step",)},
        coords={"step": Axis((0.0, 0.1, 0.2, 0.3), "s")},
        units={"walk": "dB", "fit.mean": "dBm"},
        settings={"model": "walk", "steps": 4},
    )
    grid = ("a", "kind", "flag", "seed")
    assert dataset.walk.dims == (*grid, "step") and dataset.walk.units == "dB"
    assert dataset["fit.mean"].dims == grid and dataset["fit.mean"].units == "dBm"
    assert dataset.positive.dims == (*grid, "positive_dim_0")
    assert dataset.a.units == "m" and dataset.step.units == "s"
    assert dataset.a.values.tolist() == [0.5, 1.0] and dataset.kind.values.tolist() == ["x", "y"]
    assert dataset.step.values.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert {name: dataset[name].dtype for name in OUTPUTS} == {name: np.dtype(d) for name, (_, d) in OUTPUTS.items()}
    assert set(dataset.data_vars) == {*OUTPUTS, "finished", "diverged"}
    assert dataset.attrs["config"]["settings"] == {"model": "walk", "steps": 4}
    assert dataset.sel(kind="y", a=0.5, seed=1).walk.shape == (1, 4)


def test_a_store_holds_what_memory_holds(tmp_path):
    options = {"dims": {"wave": ["t"]}, "coords": {"t": [1, 2, 3]}, "units": {"wave": "V"}, "lanes": 2}
    axes = {"rate": Axis((0.1, 0.2, 0.3), "m"), "kind": ["a", "b"], "seed": range(3)}
    one = run(small, axes, {"offset": np.float32(1)}, **options)
    other = run(small, axes, {"offset": np.float32(1)}, store=tmp_path / "a.zarr", **options)
    same(one, other)
    same(one, open_dataset(tmp_path / "a.zarr"))
    assert one.attrs == other.attrs
    assert {n: v.attrs for n, v in one.variables.items()} == {n: v.attrs for n, v in other.variables.items()}
    assert {n: v.dims for n, v in one.variables.items()} == {n: v.dims for n, v in other.variables.items()}


def draws(key, point, shared):
    return {"bits": jax.random.bits(key, (3,)), "normal": jax.random.normal(key, (3,)) * point["x"]}


def test_common_random_numbers():
    """Members of one seed see the same draws, whatever else they are and however they are computed."""
    axes = {"x": [1.0, 2.0, 4.0], "kind": ["a", "b"], "seed": [5, 0, 11, 7]}
    expected = {seed: np.asarray(jax.random.bits(jax.random.key(seed), (3,))) for seed in axes["seed"]}
    for options in ({}, {"lanes": 1}, {"lanes": 2}, {"lanes": 7}):
        dataset = run(draws, axes, **options)
        for seed, bits in expected.items():
            assert (dataset.bits.sel(seed=seed).values == bits).all(), options
            normal = np.asarray(jax.random.normal(jax.random.key(seed), (3,)))
            for x in axes["x"]:
                np.testing.assert_allclose(dataset.normal.sel(seed=seed, x=x, kind="b"), x * normal, rtol=1e-6)


def test_another_point_moves_no_other():
    axes = {"x": [1.0, 4.0], "seed": [5, 0]}
    before = run(draws, axes)
    for more in ({"x": [0.5, 1.0, 4.0]}, {"seed": [1, 5, 9, 0]}, {"y": [1, 2]}):
        after = run(draws, {**axes, **more}).sel(x=axes["x"], seed=axes["seed"])
        after = after.isel(y=1) if "y" in more else after
        for name in ("bits", "normal"):
            assert after[name].values.tobytes() == before[name].values.tobytes()


def test_without_a_seed_all_see_seed_0():
    dataset = run(draws, {"x": [1.0, 2.0]})
    assert (dataset.bits.values == np.asarray(jax.random.bits(jax.random.key(0), (3,)))).all()


def test_progress_rises_to_the_total():
    seen = []
    run(
        small,
        {"rate": [0.1, 0.2, 0.3], "seed": range(5)},
        {"offset": np.float32(0)},
        lanes=2,
        on_progress=lambda *n: seen.append(n),
    )
    done, totals = zip(*seen, strict=True)
    assert set(totals) == {15} and done[0] == 0 and done[-1] == 15 and sorted(done) == list(done)
    assert len(seen) == 1 + 5 * 2  # one seed at a time, as there are as many points as lanes; three points in two


def elsewhere(work, lots, path, seen):
    """As a cluster would: the work travels, and a worker stores what it computes or sends it back."""
    work = pickle.loads(pickle.dumps(replace(work)))  # without the lowered program
    for lot in reversed(lots):
        rows = work.compute(lot)
        seen.append(len(rows))
        if path is not None:
            with attach(path) as store:
                store.add(rows)
        yield len(rows), None if path is not None else rows


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("along", [False, True])
def test_executor(tmp_path, stored, along):
    axes, data = {"rate": [0.1, 0.2, 0.3], "seed": range(3)}, {"offset": np.float32(1)}
    shared = Along("seed", [data] * 3) if along else data
    seen = []
    dataset = run(
        small, axes, shared, lanes=2, store=tmp_path / "a" if stored else None, executor=partial(elsewhere, seen=seen)
    )
    assert seen == [1, 2] * 3
    same(dataset, run(small, axes, shared, lanes=2))


def test_a_shard_is_every_nth_member(tmp_path):
    axes, path, whole = {"rate": [0.1, 0.2, 0.3], "seed": range(3)}, tmp_path / "a", []
    for i in (3, 1, 2):
        alone = run(small, axes, DATA, shard=(i, 4)).finished.values.ravel()
        assert np.flatnonzero(alone).tolist() == list(range(i - 1, 9, 4))
        whole.append(int(run(small, axes, DATA, shard=(i, 4), store=path).finished.sum()))
    assert whole == [2, 5, 7]
    same(run(small, axes, DATA, shard=(4, 4), store=path), run(small, axes, DATA))
    assert run(small, {"rate": [0.1]}, DATA, shard=(2, 2)).finished.sum() == 0
