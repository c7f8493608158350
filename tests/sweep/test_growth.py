"""A store grows: what it lacks is computed, what it has is read, and no bit depends on which command asked."""

import tempfile
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep import program
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import Store, attach, open_dataset
from ovibjax.sweep.work import PADDING, Along
from tests.sweep.members import AXES, DATA, same, small, snapshot_of, train


def counting(seen, work, lots, path):
    """As on this machine, one batch after another; notes the members."""
    for lot in lots:
        seen += lot[lot != PADDING].tolist()
        rows = work.compute(lot)
        yield len(rows), rows


def curved(key, point, shared):
    """Transcendental functions, random numbers, a product and a scan."""
    w = jax.random.normal(key, (5, 5)) * point["rate"]
    w, norms = jax.lax.scan(lambda w, _: (jnp.tanh(w @ w.T + shared["gain"]), jnp.exp(-jnp.sum(w * w))), w, length=20)
    return {"w": w, "norms": norms, "log": jnp.log1p(point["rate"] * jnp.abs(w).sum()) ** 0.3}


RATES = [0.5, 0.7, 0.9]
GAIN = {"gain": np.float32(0.1)}
FUNCTIONS = {"train": partial(train, steps=5), "curved": curved}


@pytest.mark.parametrize("lanes", [None, 1, 3])
@pytest.mark.parametrize("along", [False, True])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_five_seeds_then_ten(tmp_path, name, along, lanes):
    fn, path, seen = FUNCTIONS[name], tmp_path / "a.zarr", []
    options = {"lanes": lanes, "executor": partial(counting, seen)}

    def grown(seeds, **more):
        data = Along("seed", [{"gain": np.float32(0.1 * (1 + i))} for i in range(seeds)]) if along else GAIN
        return run(fn, {"rate": RATES, "seed": range(seeds)}, data, **options, **more)

    first = grown(5, store=path)
    assert sorted(seen) == list(range(15))
    seen.clear()
    compiled = program.compilations
    ten = grown(10, store=path)
    assert program.compilations == compiled
    # Of each rate the seeds 5 to 9, in a grid of ten seeds.
    assert sorted(seen) == [10 * rate + seed for rate in range(3) for seed in range(5, 10)]
    same(ten.isel(seed=slice(5)), first)
    same(ten, grown(10, store=tmp_path / "fresh.zarr"))
    same(ten, grown(10))
    same(ten, open_dataset(path))
    seen.clear()
    same(grown(5, store=path), first)
    assert not seen


def test_another_value_adds_a_row(tmp_path):
    path, seen = tmp_path / "a.zarr", []
    options = {"store": path, "executor": partial(counting, seen)}
    run(curved, {"rate": RATES, "seed": range(2)}, GAIN, **options)
    seen.clear()
    dataset = run(curved, {"rate": [0.8, *RATES], "seed": range(2)}, GAIN, **options)
    assert seen == [0, 1] and dataset.rate.values.tolist() == [0.8, *RATES]
    same(dataset, run(curved, {"rate": [0.8, *RATES], "seed": range(2)}, GAIN))
    run(curved, {"rate": [0.6], "seed": [7]}, GAIN, **options)
    whole = open_dataset(path)
    assert whole.rate.values.tolist() == [0.5, 0.6, 0.7, 0.8, 0.9] and whole.seed.values.tolist() == [0, 1, 7]
    assert int(whole.finished.sum()) == 9 and np.isnan(whole.log.sel(rate=0.6, seed=0))
    same(whole.sel(rate=dataset.rate.values, seed=[0, 1]), dataset)


def test_a_narrower_command_reads_and_needs_no_lock(tmp_path):
    path, seen = tmp_path / "a.zarr", []
    whole = run(curved, {"rate": RATES, "seed": range(3)}, GAIN, store=path)
    options = {"store": path, "executor": partial(counting, seen), "on_progress": lambda *n: seen.append(n)}
    with attach(path) as other:
        other.lock()
        before, compiled = snapshot_of(path), program.compilations
        for axes, done in (({"rate": [0.9], "seed": [2, 1]}, 2), ({"rate": RATES, "seed": range(3)}, 9)):
            seen.clear()
            same(run(curved, axes, GAIN, **options), whole.sel(rate=axes["rate"], seed=list(axes["seed"])))
            assert seen == [(done, done)]
        assert snapshot_of(path) == before and program.compilations == compiled


def test_axes_in_any_order_and_zipped(tmp_path):
    path, seen = tmp_path / "a.zarr", []
    options = {"store": path, "executor": partial(counting, seen)}
    whole = run(curved, {"rate": RATES, "seed": range(3)}, GAIN, **options)
    seen.clear()
    turned = run(curved, {"seed": range(3), "rate": RATES}, GAIN, **options)
    assert turned.finished.dims == ("seed", "rate")
    same(turned.transpose("rate", "seed", ...), whole)
    diagonal = run(curved, {"seed": range(4), "rate": [*RATES, 0.1]}, GAIN, zipped=[("seed", "rate")], **options)
    assert seen == [3] and diagonal.finished.dims == ("seed_rate",)
    for i in range(3):
        assert (diagonal.w[i].values == whole.w[i, i].values).all()


def test_a_new_name_comes_last(tmp_path):
    def fn(key, point, shared):
        return {"y": shared["table"][point["kind"]]}

    path, table = tmp_path / "a.zarr", {"table": np.float32([3, 5, 7])}
    run(fn, {"kind": ["mean", "max"]}, table, store=path)
    assert run(fn, {"kind": ["mean", "max", "vit"]}, table, store=path).y.values.tolist() == [3, 5, 7]
    assert open_dataset(path).kind.values.tolist() == ["mean", "max", "vit"]


SEEDS = st.lists(st.integers(0, 6), min_size=1, max_size=4, unique=True)
PARTS = st.tuples(st.lists(st.sampled_from([0.25, 0.5, 0.75, 1.0, 1.5]), min_size=1, max_size=4, unique=True), SEEDS)


@settings(max_examples=12, deadline=None)
@given(parts=st.lists(PARTS, min_size=1, max_size=4), shards=st.integers(1, 3))
def test_any_commands_in_any_order_give_the_same_bits(parts, shards):
    """Members stand at other places of other batches, beside other members."""
    grid = {"rate": [0.25, 0.5, 0.75, 1.0, 1.5], "seed": range(7)}
    with tempfile.TemporaryDirectory() as folder:
        for rates, seeds in parts:
            for i in range(1, 1 + shards):
                run(curved, {"rate": rates, "seed": seeds}, GAIN, store=f"{folder}/a.zarr", shard=(i, shards))
        found = open_dataset(f"{folder}/a.zarr")
    whole = run(curved, grid, GAIN).sel(rate=found.rate.values, seed=found.seed.values)
    done = found.finished.values
    assert done.sum() == len({(rate, seed) for rates, seeds in parts for rate in rates for seed in seeds})
    for name in ("w", "norms", "log"):
        assert found[name].values[done].tobytes() == whole[name].values[done].tobytes()


def test_a_whole_sweep_that_another_began_meanwhile_is_not_done_twice(tmp_path, monkeypatch):
    """Between reading and locking, the other one has finished."""
    path, lock, seen = tmp_path / "a.zarr", Store.lock, []

    def late(store):
        monkeypatch.setattr(Store, "lock", lock)
        run(small, AXES, DATA, store=path)
        lock(store)

    monkeypatch.setattr(Store, "lock", late)
    dataset = run(small, AXES, DATA, store=path, executor=partial(counting, seen))
    assert not seen and dataset.finished.all()


def test_a_reader_knows_what_is_to_come(tmp_path):
    path = tmp_path / "a.zarr"
    with pytest.raises(RuntimeError, match="a worker is lost"):
        run(curved, {"rate": RATES, "seed": range(4)}, GAIN, store=path, executor=lost_after_three)
    dataset = open_dataset(path)
    assert dict(dataset.finished.sizes) == {"rate": 3, "seed": 4} and int(dataset.finished.sum()) == 3
    run(curved, {"rate": [0.1], "seed": [9]}, GAIN, store=path)
    dataset = open_dataset(path)
    assert dict(dataset.finished.sizes) == {"rate": 4, "seed": 5} and int(dataset.finished.sum()) == 4
    assert dataset.attrs["asked"] == 13, "of the 20 places seven were never asked for"
    before = sorted(path.rglob("*"))
    run(curved, {"rate": RATES, "seed": range(4)}, GAIN, store=path)
    run(curved, {"rate": RATES[:1], "seed": range(2)}, GAIN, store=path)  # reads only
    assert {p.parent.name for p in set(path.rglob("*")) - set(before)} <= {"members"}
    for damaged in ("{", "[]", '{"axes": {}, "groups": []}', '{"axes": {"rate": 3}, "groups": [["rate"]]}'):
        (path / "asked" / "0.json").write_text(damaged)
        assert open_dataset(path).attrs["asked"] == 13


def lost_after_three(work, lots, path):
    for lot in lots:
        rows = work.compute(lot)[:3]
        yield len(rows), rows
        raise RuntimeError("a worker is lost")
