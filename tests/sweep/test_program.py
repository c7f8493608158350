"""One compilation per sweep, chunks of a fitting shape, and programs that are told apart."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.sweep import program
from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import make_chunks, make_grid
from ovibjax.sweep.program import choose_shape, flatten, trace_member
from ovibjax.sweep.work import Along
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
    list(enumerate([{}, {"chunk": 5}, {"chunk": 7, "lanes": 3}, {"chunk": 1}, {"lanes": 1}])),
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
            run(small, {"scene": range(5), "rate": [0.1, 0.2, 0.3 + repeat]}, Along("scene", data), chunk=2)
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


class Device:
    def __init__(self, platform="cpu"):
        self.platform = platform


def shape_for(n_inner, n_outer, cost, chunk=None, lanes=None, devices=1, workers=2, available=2**33, platform="cpu"):
    grid = make_grid({"x": range(n_inner), **({"seed": range(n_outer)} if n_outer else {})})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program.jax, "local_devices", lambda: [Device(platform)] * devices)
        patch.setattr(program, "available_bytes", lambda _: available)
        patch.setattr(program, "workers", lambda: workers)
        shape = choose_shape(grid, 1 if n_outer else None, cost, chunk, lanes)
    assert shape.devices == devices
    return grid, shape


def test_members_larger_than_the_cache_run_alone():
    _, shape = shape_for(100, 5, (5 << 20, 100))
    assert (shape.lanes, shape.rows, shape.columns) == (1, 1, 1)


def test_tiny_members_share_it():
    _, shape = shape_for(1000, 5, (1 << 10, 4))
    assert 500 <= shape.lanes <= 1024


def test_accelerator_takes_as_many_as_fit():
    _, shape = shape_for(1000, 1, (10 << 20, 100), platform="gpu", workers=1, available=1 << 33)
    assert 300 < shape.lanes <= (1 << 32) // (10 << 20)


def test_memory_bounds_tiny_members_too():
    _, shape = shape_for(1000, 1, (1 << 10, 1 << 10), available=40 << 10)
    assert shape.lanes == 5  # half of 40 KB, two workers, 2 KB each


def test_a_long_grid_has_a_bounded_number_of_chunks():
    grid, shape = shape_for(400, 60, (5 << 20, 4))
    assert len(make_chunks(grid, 1, shape.rows, shape.columns).members) <= 1024 and shape.lanes == 1


def test_cost_of_a_member():
    _, (alive, outputs) = trace_member(small, {"rate": np.float32(1)}, OFFSET)
    assert outputs == 3 * 4 + 2 * 4 + 4 and 12 <= alive < 10_000


@settings(max_examples=300, deadline=None)
@given(
    n_inner=st.integers(1, 60),
    n_outer=st.integers(0, 20),
    alive=st.integers(0, 1 << 22),
    output=st.integers(0, 1 << 16),
    chunk=st.none() | st.integers(1, 70),
    lanes=st.none() | st.integers(1, 40),
    devices=st.integers(1, 9),
    workers=st.integers(1, 8),
    available=st.integers(1 << 10, 1 << 34),
    platform=st.sampled_from(["cpu", "gpu"]),
)
def test_any_shape_covers_its_grid(
    n_inner, n_outer, alive, output, chunk, lanes, devices, workers, available, platform
):
    grid, shape = shape_for(n_inner, n_outer, (alive, output), chunk, lanes, devices, workers, available, platform)
    outer = 1 if n_outer else None
    members = make_chunks(grid, outer, shape.rows, shape.columns).members
    assert sorted(members[members >= 0]) == list(range(grid.size))
    assert shape.rows == 1 or n_outer
    # Whole groups of lanes on every device, or whole columns.
    by_columns = shape.columns % devices == 0
    rows, columns = (shape.rows, shape.columns // devices) if by_columns else (shape.rows // devices, shape.columns)
    assert by_columns or shape.rows % devices == 0
    if by_columns and n_inner >= devices:
        assert columns % min(shape.lanes, columns) == 0
        assert rows % max(1, shape.lanes // columns) == 0
    if lanes is not None:
        assert shape.lanes <= lanes
    if chunk is not None and lanes is None:
        assert shape.lanes <= chunk
    if chunk is None and lanes is None:
        at_once = devices if devices > 1 else workers
        needed = shape.lanes * (max(alive, 1) + output) * at_once
        assert shape.lanes == 1 or needed <= available / 2
        if platform == "cpu":
            assert shape.lanes == 1 or shape.lanes * alive <= 1 << 20
    if chunk is not None:
        slots = shape.rows * shape.columns
        assert slots <= max(chunk, shape.lanes, 1) * 2 * devices
    if shape.rows > 1 and n_inner >= devices:
        assert shape.columns >= n_inner  # rows only once all inner points are in


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
    assert dataset.attrs["config"]["execution"]["devices"] == len(jax.devices())
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
                np.testing.assert_allclose(found[name], values, rtol=1e-6, atol=1e-6, err_msg=f"{name}, {n} devices")
