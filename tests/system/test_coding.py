"""Codes inside the system's program against the tables and streams of robots, and what they change in the chain."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.actions import SweptActions
from ovibjax.link.coded_packets import CodedRequest, pack_coded, pack_compact
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import numbers_of, values_of
from ovibjax.link.codes.tables import CODES, LEVELS, fit_table
from ovibjax.link.payload import request_bytes
from ovibjax.system import chain
from ovibjax.system.coding import even_grid, overhead_bytes, received
from ovibjax.system.data import SystemSize, make_system
from ovibjax.system.grids import sweep_system
from ovibjax.views import MODES
from tests.system.test_chain import drive

A, F, K = 3, 500, 12


@pytest.fixture(scope="module")
def codes():
    rng = np.random.default_rng(0)
    made = rng.normal(size=(A, F, K)) * 5 * np.arange(1, K + 1) ** -0.8
    made[..., 4] = 0.3  # one that never moves
    return jnp.asarray(made, jnp.float32), jnp.asarray(np.arange(F) % 3 > 0)


def seen(codes):
    z, known = codes
    return np.asarray(z)[:, np.asarray(known)].reshape(-1, K)


@pytest.mark.parametrize("code", ["int8", "int4"])
def test_grids_are_those_of_tables(codes, code):
    ours, theirs = even_grid(*codes, LEVELS[code]), fit_table(code, seen(codes)).grid
    # Two shares of the range may lose as much; steps differ by their ratio then.
    close = np.isclose(ours.step, theirs.step, rtol=1e-4)
    assert close.mean() > 0.7
    np.testing.assert_allclose(np.asarray(ours.first)[close], theirs.first[close], atol=1)
    lost = [
        np.mean((values_of(grid, numbers_of(grid, seen(codes))) - seen(codes)) ** 2, axis=0) for grid in (ours, theirs)
    ]
    np.testing.assert_allclose(lost[0], lost[1], rtol=0.02, atol=1e-10)


@pytest.mark.parametrize("code", CODES)
def test_sizes_and_values_are_those_of_streams(codes, code):
    sent, sizes_bytes = jax.jit(received, static_argnums=2)(*codes, code)
    coder = Coder(code, fit_table(code, seen(codes)))
    assert sizes_bytes.shape == (A, K) and sent.shape == (A, F, K)
    known = np.flatnonzero(np.asarray(codes[1]))
    for a in range(A):
        some = np.asarray(codes[0])[a, known[::5]]
        for k in (1, 5, K):
            real = np.mean([len(coder.encode(row[:k])) for row in some])
            # An ideal length in whole bytes is half a byte above itself, a stream a third of one.
            assert abs(float(sizes_bytes[a, k - 1]) - real) < 0.03 * real + 0.3 * (code == "entropy")
        if code in ("float32", "entropy"):
            decoded = np.stack([coder.decode(coder.encode(row), K) for row in some])
            np.testing.assert_allclose(np.asarray(sent)[a, known[::5]], decoded, rtol=1e-5, atol=1e-6)


def test_overheads_are_those_of_packets():
    modes = ("F", "FS", "A5")
    for code, size in (("int8", 30), ("int4", 15), ("entropy", 11)):
        requests = [CodedRequest(mode, code, 30, bytes(size), 12.0, 700, 60, 999) for mode in modes]
        assert overhead_bytes(modes, code, False) == [len(pack_coded(one)) - size for one in requests]
        assert overhead_bytes(modes, code, True) == [len(pack_compact(one)) - size for one in requests]
    views = [len(MODES[mode]) for mode in modes]
    for compact in (False, True):
        assert overhead_bytes(modes, "float32", compact) == [request_bytes(0, n) for n in views]


def test_actions_have_the_sizes_that_they_are_given():
    given = SweptActions(modes=("F", "FS"), k=jnp.int32(16), sizes_bytes=jnp.array([30.0, 40.0]))
    assert given.payload_bytes.tolist() == [30.0, 40.0]
    assert SweptActions(modes=("F", "FS"), k=jnp.int32(16)).payload_bytes.tolist() == [88.0, 96.0]


@pytest.fixture(scope="module")
def small():
    size = SystemSize(steps=6, mixed=64, rank=6, clients=2, fleet=3, kb_per_s=4.0, batch=16)
    data, static = make_system([drive(seed) for seed in range(3)], 1, size)
    arch = replace(static.train.arch, latent=16, hidden=24, last_hidden=16)
    static = replace(static, train=replace(static.train, arch=arch, prefixes=(4, 8, 16)), schedulers=("fifo",))
    drift = data.env.drift._replace(rate_m_per_s=6.0 * data.env.drift.rate_m_per_s)
    return data._replace(env=data.env._replace(drift=drift)), static


@pytest.mark.long
def test_floats_among_codes_are_floats_alone_and_fewer_bytes_more_requests(small):
    data, static = small
    point = {"beta": jnp.float32(1e-3), "gamma": jnp.float32(0.1)}
    run = partial(jax.jit(chain.along, static_argnames="static"), jax.random.key(7), point)
    where = jnp.array([8, 16], jnp.int32), jnp.array([8.0], jnp.float32), data
    alone = run(*where, static=static)
    both = run(*where, static=replace(static, codes=("float32", "entropy"), compact=True))
    assert set(both) == set(alone) == set(chain.DIMS)
    for name, value in alone.items():
        assert both[name].shape == (2, *value.shape)
        np.testing.assert_allclose(both[name][0], value, rtol=1e-4, atol=1e-4, err_msg=name)
    each = both["kb"] / both["requests"]
    assert (each[1] < 0.5 * each[0]).all() and (both["requests"][1] >= both["requests"][0]).all()


@pytest.mark.long
def test_code_is_a_dimension_of_the_grid():
    size = SystemSize(steps=2, mixed=16, rank=6, clients=1, fleet=2, batch=16)
    scene, along = ([drive(seed) for seed in range(3)], 1, size), ([8], [8.0], ["fifo"])
    found = sweep_system(scene, {"seed": [3]}, along, coding=(("int8", "int4"), False))
    assert found.mean_route_m.dims == ("seed", "code", "k") and found.top_cost.dims[-4:] == (
        "code",
        "k",
        "V",
        "scheduler",
    )
    assert list(found.code.values) == ["int8", "int4"] and np.isfinite(found.mean_route_m).all()
