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

from ovibjax.errors import InputError
from ovibjax.sweep.engine import Interrupted, run
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.store import attach, open_dataset
from ovibjax.sweep.work import Along, Block
from tests.sweep.members import finish, same, small, start

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
    chunk=st.none() | st.integers(1, 12),
    lanes=st.none() | st.integers(1, 6),
    along=st.sampled_from([None, None, "a", "seed", "kind"]),
)
def test_equals_a_loop(values, order, seeded, chunk, lanes, along):
    axes = {name: values[name] for name in order if name != "seed" or seeded}
    along = along if along in axes else None
    shared = {"table": TABLE}
    if along:
        shared = [{"table": TABLE + np.float32(i)} for i in range(len(axes[along]))]
    given_data = Along(along, shared) if along else shared
    dataset = run(everything, axes, given_data, chunk=chunk, lanes=lanes)
    assert dataset.finished.dims == tuple(axes)
    check(everything, dataset, axes, shared, along)


@pytest.mark.parametrize("chunk", [None, 2])
def test_zipped_seed(chunk):
    axes = {"a": [0.5, 1.5], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True]}
    dataset = run(everything, axes, {"table": TABLE}, zipped=[("kind", "seed")], chunk=chunk)
    assert dataset.finished.dims == ("a", "kind_seed", "flag")
    assert dataset.seed.dims == dataset.kind.dims == ("kind_seed",)
    check(everything, dataset, axes, {"table": TABLE})


def test_all_axes_zipped():
    axes = {"a": [0.5, 1.5, 2.0], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True, False, True]}
    zipped = [("a", "seed", "kind", "flag")]
    check(everything, run(everything, axes, {"table": TABLE}, zipped=zipped, chunk=2), axes, {"table": TABLE})


def test_along_a_zipped_axis():
    axes = {"a": [0.5, 1.5], "seed": [3, 4, 9], "kind": ["x", "y", "z"], "flag": [True]}
    data = [{"table": TABLE * np.float32(i)} for i in range(3)]
    dataset = run(everything, axes, Along("kind", data), zipped=[("seed", "kind")], chunk=4, lanes=2)
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
    options = {"dims": {"wave": ["t"]}, "coords": {"t": [1, 2, 3]}, "units": {"wave": "V"}, "chunk": 4, "lanes": 2}
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
    for options in ({}, {"chunk": 1}, {"chunk": 5, "lanes": 2}, {"chunk": 24, "lanes": 1}, {"lanes": 7}):
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
        np.testing.assert_array_equal(after.bits.transpose(*before.bits.dims[:2], ...), before.bits)
        np.testing.assert_allclose(after.normal.transpose(*before.normal.dims[:2], ...), before.normal, rtol=1e-6)


def test_without_a_seed_all_see_seed_0():
    dataset = run(draws, {"x": [1.0, 2.0]})
    assert (dataset.bits.values == np.asarray(jax.random.bits(jax.random.key(0), (3,)))).all()


def unstable(key, point, shared):
    noise = jax.random.normal(key, (8,))
    x = jax.lax.fori_loop(0, 50, lambda i, x: point["rate"] * x * x - x + noise, noise)
    return {"x": x, "norm": jnp.sqrt(point["rate"]) * noise[0], "n": jnp.int32(3), "ok": x[0] > 0}


@pytest.mark.parametrize("options", [{"chunk": 8, "lanes": 8}, {"chunk": 3, "lanes": 1}, {"chunk": 6, "lanes": 2}, {}])
def test_diverged_member_is_marked_and_touches_no_other(options):
    seeds = {"seed": range(3)}

    def fn(key, point, shared):
        return {"x": jnp.log(point["rate"]) + unstable(key, {"rate": point["rate"] * 1e-3}, shared)["x"]}

    for bad in (-1.0, 0.0, 3e38):  # NaN, -inf, NaN from overflow
        good = run(fn, {"rate": [0.01, 0.1, 0.2, 0.3, 0.05], **seeds}, **options)
        ill = run(fn, {"rate": [0.01, 0.1, bad, 0.3, 0.05], **seeds}, **options)
        assert not good.diverged.any() and good.finished.all() and ill.finished.all()
        np.testing.assert_array_equal(ill.diverged, np.arange(5)[:, None] == [[2] * 3] * 5)
        keep = [0, 1, 3, 4]
        assert ill.x.values[keep].tobytes() == good.x.values[keep].tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float16])
def test_one_number_that_is_not_finite_is_enough(value, dtype):
    def fn(key, point, shared):
        y = jnp.zeros((2, 3), dtype).at[1, 2].set(jnp.where(point["x"] > 1, value, 0).astype(dtype))
        return {"fine": point["x"], "n": jnp.int32(1), "deep": {"y": y}}

    assert run(fn, {"x": [1, 2, 0]}).diverged.values.tolist() == [False, True, False]


@pytest.mark.parametrize(
    "output",
    [
        pytest.param({"y": lambda x: x.astype(jnp.bfloat16)}, id="bfloat16"),
        pytest.param({"y": lambda x: jax.lax.complex(x, x)}, id="complex"),
        pytest.param({"finished": lambda x: x}, id="finished"),
        pytest.param({"diverged": lambda x: x}, id="diverged"),
        pytest.param({"x": lambda x: x}, id="name of an axis"),
        pytest.param({"a.b": lambda x: x, "a": {"b": lambda x: -x}}, id="two of one name"),
    ],
)
def test_outputs_that_cannot_be_held_are_refused_before_they_are_computed(output):
    """In memory as in a store: nothing is lost after hours, nothing overwritten."""
    progress = []
    with pytest.raises(InputError):
        run(
            lambda key, point, shared: jax.tree.map(lambda f: f(point["x"]), output),
            {"x": [1.0, 2.0]},
            on_progress=lambda *n: progress.append(n),
        )
    assert not progress


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axes": {"rate": []}}, "rate has no values"),
        ({"chunk": 0}, "positive"),
        ({"lanes": -1}, "positive"),
        ({"shared": Along("scene", [1.0])}, "'scene'"),
        ({"shared": Along("rate", [{"offset": np.float32(1)}])}, "'rate'"),
        ({"dims": {"wave": ("a", "b")}}, "wave"),
        ({"zipped": [("rate", "other")]}, "'other'"),
        pytest.param({"dims": {"wawe": ("t",)}}, "wawe", id="dims of no output"),
        pytest.param({"units": {"wawe": "m"}}, "wawe", id="units of no output"),
        pytest.param({"axes": {"rate": [1.0], "seed": [0.5]}}, "seed", id="a seed that is no integer"),
    ],
)
def test_bad_input(options, words):
    given_options = {"axes": {"rate": [0.1, 0.2]}, "shared": {"offset": np.float32(1)}, **options}
    with pytest.raises(InputError) as caught:
        run(small, **given_options)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_progress_rises_to_the_total():
    seen = []
    run(
        small,
        {"rate": [0.1, 0.2, 0.3], "seed": range(5)},
        {"offset": np.float32(0)},
        chunk=2,
        on_progress=lambda *n: seen.append(n),
    )
    done, totals = zip(*seen, strict=True)
    assert set(totals) == {15} and done[0] == 0 and done[-1] == 15 and sorted(done) == list(done)
    assert len(seen) == 1 + 5 * 2  # one seed at a time, three points in two chunks


def test_errors_of_the_member_function_come_through():
    def broken(key, point, shared):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        run(broken, {"x": [1, 2]})


def elsewhere(work, pending, path, seen):
    """As a cluster would: the work travels, and a worker stores what it computes or sends it back."""
    work = pickle.loads(pickle.dumps(replace(work)))  # without the lowered program
    seen += pending
    for chunk in reversed(pending):
        block = work.compute(chunk)
        if path is not None:
            attach(path).write(chunk, block.arrays, block.diverged)
        yield chunk, Block(block.arrays, block.diverged) if path is None else None


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("along", [False, True])
def test_executor(tmp_path, stored, along):
    axes, data = {"rate": [0.1, 0.2, 0.3], "seed": range(3)}, {"offset": np.float32(1)}
    shared = Along("seed", [data] * 3) if along else data
    seen = []
    dataset = run(
        small, axes, shared, chunk=2, store=tmp_path / "a" if stored else None, executor=partial(elsewhere, seen=seen)
    )
    assert seen == list(range(6))
    same(dataset, run(small, axes, shared, chunk=2))


INTERRUPT = """
import sys
import numpy as np
from ovibjax.sweep.engine import Interrupted
from tests.sweep.members import sweep

try:
    sweep(sys.argv[1] or None, on_progress=lambda done, total: print(done, total, flush=True))
except Interrupted as stop:
    np.savez(sys.argv[2], **{n: v.values for n, v in stop.dataset.data_vars.items()})
    print("interrupted")
"""


@pytest.mark.parametrize("stored", [False, True])
def test_ctrl_c_keeps_what_is_finished(tmp_path, stored):
    store = tmp_path / "a.zarr" if stored else ""
    process = start(INTERRUPT, store, tmp_path / "kept.npz")
    seen = []
    for line in process.stdout:
        seen.append(tuple(map(int, line.split())))
        if seen[-1][0] >= 7:
            break
    process.send_signal(2)
    lines = finish(process).split("\n")
    assert lines[-2] == "interrupted", lines
    seen += [tuple(map(int, line.split())) for line in lines[:-2]]
    assert [done for done, _ in seen] == list(range(len(seen))) and {total for _, total in seen} == {64}
    with np.load(tmp_path / "kept.npz") as kept:
        finished = kept["finished"]
        assert len(seen) - 1 <= finished.sum() <= len(seen) and finished.sum() < 64
        assert np.isfinite(kept["weights"][finished]).all() and np.isnan(kept["weights"][~finished]).all()
        assert (kept["steps"] == np.where(finished, 9000, 0)).all()
        if stored:
            dataset = open_dataset(store)
            for name, values in dataset.data_vars.items():
                np.testing.assert_array_equal(values, kept[name])


def test_interrupted_is_a_keyboard_interrupt():
    def stop(done, total):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run(small, {"rate": np.linspace(0, 1, 10)}, {"offset": np.float32(0)}, chunk=2, lanes=1, on_progress=stop)
    assert isinstance(caught.value, Interrupted)
    assert caught.value.dataset.finished.sum() == 4
