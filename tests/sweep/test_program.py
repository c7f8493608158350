"""One compilation per sweep, batches of a fitting size, and programs that are told apart."""

import logging
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep import program
from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import make_grid
from ovibjax.sweep.program import Batch, choose_batch, flatten, trace_member
from ovibjax.sweep.work import PADDING, Along, Work
from tests.sweep.members import cases, finish, small, start, sweep

OFFSET = {"offset": np.float32(0.5)}


class Compilations:
    """Counted twice: by the program and by jax's own log."""

    def __init__(self, caplog):
        self.caplog, self.last = caplog, program.compilations
        caplog.set_level(logging.DEBUG, "jax")

    def __call__(self):
        logged = [r.getMessage() for r in self.caplog.records if "Finished XLA compilation" in r.getMessage()]
        counted, self.last = program.compilations - self.last, program.compilations
        self.caplog.clear()
        assert len(logged) == counted, logged
        return counted


@pytest.mark.parametrize(
    ("tag", "options"),  # a program of its own for every parameter
    list(enumerate([{}, {"lanes": 1}, {"lanes": 3}, {"lanes": 64}])),
)
def test_one_compilation_per_sweep(caplog, tag, options):

    def fn(key, point, shared):
        return {"y": small(key, point, shared)["wave"] * (2.5 + tag)}

    count = Compilations(caplog)
    with jax.log_compiles():
        assert run(fn, {"rate": np.linspace(0, 1, 16), "seed": range(4)}, OFFSET, **options).finished.all()
        assert count() == 1
        run(fn, {"rate": np.linspace(2, 3, 16), "seed": range(10, 14)}, {"offset": np.float32(7)}, **options)
        assert count() == 0


def test_one_compilation_with_data_along_an_axis(caplog):
    data = [{"offset": np.float32(i)} for i in range(5)]
    count = Compilations(caplog)
    with jax.log_compiles():
        for repeat in range(2):
            run(small, {"scene": range(5), "rate": [0.1, 0.2, 0.3 + repeat]}, Along("scene", data))
            assert count() == 1 - repeat


def test_functions_of_equal_text_are_told_apart():
    """Their programs differ in which argument they read, or in its name, alone."""
    axes = {"x": [1.0, 2.0], "y": [10.0, 20.0]}
    assert run(lambda k, p, s: {"r": p["x"] * 2}, axes).r.values.tolist() == [[2, 2], [4, 4]]
    assert run(lambda k, p, s: {"r": p["y"] * 2}, axes).r.values.tolist() == [[20, 40], [20, 40]]
    data = {"a": np.float32(3), "b": np.float32(5)}
    x, y = (run(lambda k, p, s, n=n: {"r": p["x"] * s[n]}, {"x": [1.0, 2.0]}, data) for n in "ab")
    assert x.r.values.tolist() == [3, 6] and y.r.values.tolist() == [5, 10]
    assert x.attrs["config"]["program"] != y.attrs["config"]["program"]
    for name in ("u", "v"):
        assert run(lambda k, p, s, n=name: {"r": p[n] * 2}, {name: [1.0, 2.0]}).r.values.tolist() == [2, 4]
    for name in ("u", "v"):
        assert run(lambda k, p, s, n=name: {n: p["x"] * 3}, {"x": [1.0, 2.0]})[name].values.tolist() == [3, 6]


@pytest.mark.parametrize("size", [5, 100_000])
def test_values_the_function_has_closed_over_are_told_apart(size):
    hashes = set()
    for value in (0.0, 1.0):
        table = np.zeros(size, np.float32)
        table[size // 2] = value
        for kind in (jnp.asarray(table), table):

            def fn(key, point, shared, kind=kind):
                return {"y": point["x"] + kind.sum()}

            dataset = run(fn, {"x": [1.0, 2.0]})
            assert dataset.y.values.tolist() == [1 + value, 2 + value]
            hashes |= {(value, dataset.attrs["config"]["program"])}
    assert len({h for _, h in hashes}) >= 2


def test_program_text_is_the_same_in_every_process():
    code = "from tests.sweep.members import *\nprint(sweep(None, steps=3).attrs['config']['program'])"
    there = finish(start(code, hash_seed="3")).strip()
    assert there == sweep(None, 3).attrs["config"]["program"] and len(there) == 64


def test_flatten():
    assert flatten({"a": {"b": 1, "c": {"d": 2}}, "e": 3}) == {"a.b": 1, "a.c.d": 2, "e": 3}


def batch_for(alive, own=0, members=100, inner=None, platform="cpu"):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program.jax, "default_backend", lambda: platform)
        return choose_batch(alive, own, members, inner)


def test_members_larger_than_the_cache_run_alone():
    assert batch_for(5 << 20) == batch_for(600 << 10) == Batch(1, False)


def test_tiny_members_share_it():
    assert batch_for(1 << 10) == Batch(64, False) and batch_for(100 << 10) == Batch(8, False)


def test_data_of_their_own_bound_them():
    assert batch_for(1 << 10, own=16 << 20) == Batch(4, False) and batch_for(1 << 10, own=1 << 30) == Batch(1, False)


def test_accelerator_takes_as_many_as_fit_and_as_there_are():
    assert batch_for(10 << 20, members=10_000, platform="gpu") == Batch(512, False)
    assert batch_for(10 << 20, members=5, platform="gpu") == Batch(8, False)
    assert batch_for(10 << 20, members=65, platform="gpu") == Batch(128, False)
    assert batch_for(10 << 20, members=10_000, inner=1000, platform="gpu") == Batch(512, True)
    assert batch_for(1 << 20, own=1 << 30, members=10_000, inner=10, platform="gpu") == Batch(4, False)
    assert batch_for(1 << 40, members=10_000, inner=10, platform="gpu") == Batch(1, False)


@settings(max_examples=200, deadline=None)
@given(
    alive=st.integers(0, 1 << 40),
    own=st.integers(0, 1 << 34),
    grids=st.lists(st.tuples(st.integers(1, 60), st.none() | st.integers(1, 300)), min_size=2, max_size=2),
    platform=st.sampled_from(["cpu", "gpu"]),
)
def test_a_batch_fits_and_on_a_cpu_no_grid_changes_it(alive, own, grids, platform):
    one, other = (batch_for(alive, own, n * (inner or 1), inner, platform) for n, inner in grids)
    assert platform == "gpu" or one == other
    for batch in (one, other):
        assert batch.lanes & (batch.lanes - 1) == 0 and not (batch.grouped and batch.lanes == 1)
        assert batch.lanes == 1 or batch.lanes * alive <= (1 << 20 if platform == "cpu" else 8 << 30)


def test_what_a_member_keeps_alive():
    _, alive = trace_member(small, {"rate": np.float32(1)}, OFFSET)
    assert 3 * 4 + 2 * 4 + 4 + 12 <= alive < 10_000


@settings(max_examples=100, deadline=None)
@given(
    n_inner=st.integers(1, 12),
    n_outer=st.none() | st.integers(1, 6),
    lanes=st.integers(1, 9),
    grouped=st.booleans(),
    devices=st.integers(1, 4),
    data=st.data(),
)
def test_lots_hold_every_member_once(n_inner, n_outer, lanes, grouped, devices, data):
    grid = make_grid({"x": range(n_inner), **({"seed": range(n_outer)} if n_outer else {})})
    members = np.array(sorted(data.draw(st.sets(st.integers(0, grid.size - 1)))), int)
    grouped = grouped and n_outer is not None
    lots = Work(None, grid, 1 if n_outer else None, Batch(lanes, grouped), devices, 1, None).lots(members)
    assert all(lot.shape == (devices, lanes) for lot in lots)
    every = np.concatenate([lot.ravel() for lot in lots]) if lots else np.zeros(0, int)
    assert sorted(every[every != PADDING]) == members.tolist()
    for lot in lots:
        assert lot[0, 0] != PADDING, "padding is at the ends, so that the first entry can stand in for it"
        for row in lot:
            real = row[row != PADDING]
            assert (row[: len(real)] == real).all()
            assert not grouped or len({member % n_outer for member in real.tolist()}) <= 1
    if not grouped:
        assert len(lots) == -(-len(members) // (lanes * devices))


def uneven(key, point, shared, whole=0):
    """A function whose batches treat their last place otherwise, but those of whole vectors."""

    @jax.custom_batching.custom_vmap
    def f(x):
        return x * 1.0

    @f.def_vmap
    def _(size, batched, x):
        odd = (jnp.arange(size) == size - 1) & (whole == 0 or size % whole > 0)
        return x * jnp.where(odd, 1.0 + 1e-6, 1.0), True

    return {"y": f(point["rate"])}


@pytest.mark.parametrize(
    ("whole", "asked", "used"), [(0, None, 1), (0, 13, 1), (8, 13, 16), (8, 16, 16), (1, 13, 13), (1, None, 64)]
)
def test_members_run_alone_or_in_whole_vectors_where_places_of_a_batch_differ(whole, asked, used):
    dataset = run(partial(uneven, whole=whole), {"rate": np.linspace(1, 2, 100)}, lanes=asked)
    assert dataset.attrs["config"]["execution"] == {"lanes": used, "grouped": False}
    assert (dataset.y.values == np.linspace(1, 2, 100).astype(np.float32)).all()


def test_places_of_a_batch_are_compared_once(monkeypatch):
    calls = []
    monkeypatch.setattr(program.Program, "__call__", counted(program.Program.__call__, calls))
    for rates in (np.linspace(0, 1, 3), np.linspace(0, 1, 70)):
        run(lambda key, point, shared: {"y": point["rate"] * 3.25}, {"rate": rates})
    assert len(calls) == 1 + 1 + 2


def counted(function, calls):
    def call(*args):
        calls.append(args)
        return function(*args)

    return call


DEVICES = """
import sys
import jax, numpy as np
from ovibjax.sweep import program
from tests.sweep.members import cases

assert len(jax.devices()) == int(sys.argv[2])
arrays = {}
failed = []
for name, case in cases().items():
    program._compiled.clear()
    try:
        dataset = case()
    except Exception as error:
        failed.append(f"{name}: {type(error).__name__} {error}")
        continue
    arrays |= {f"{name}/{v}": dataset[v].values for v in dataset.data_vars}
    (compiled,) = program._compiled.values()
    for sharding in jax.tree.leaves(compiled.output_shardings):
        assert len(sharding.device_set) == len(jax.devices()) and not sharding.is_fully_replicated, (name, sharding)
np.savez(sys.argv[1], **arrays)
print("\\n".join(failed))
"""


@pytest.mark.slow
def test_several_devices_give_the_same(tmp_path):
    processes = {n: start(DEVICES, tmp_path / f"{n}.npz", n, devices=n) for n in (2, 3)}
    expected = {
        f"{name}/{v}": dataset[v].values
        for name, dataset in ((name, case()) for name, case in cases().items())
        for v in dataset.data_vars
    }
    for n, process in processes.items():
        assert finish(process).strip() == ""
        with np.load(tmp_path / f"{n}.npz") as found:
            assert set(found) == set(expected)
            for name, values in expected.items():
                assert found[name].dtype == values.dtype
                assert found[name].tobytes() == values.tobytes(), f"{name}, {n} devices"
