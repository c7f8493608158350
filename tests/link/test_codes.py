"""Codes of prefixes: the exact coder against fractions, grids against exact division, every cut, every bit the same."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.link.codes.arithmetic import TOTAL, StreamError, read_symbols, read_whole, write_symbols
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import Grid, numbers_of, snapped, values_of
from ovibjax.link.codes.tables import CODES, LOST, CodeTable, check_table, fit_table, fitted_step
from tests.oracles import codes as oracle

K = 24


@functools.cache
def training(k=K, n=1500):
    """Codes as a nested encoder makes them: ever smaller, one of them constant, one never positive, one far off."""
    rng = np.random.default_rng(0)
    made = rng.normal(size=(n, K)) * 4 * np.arange(1, K + 1) ** -0.6
    made[:, 5], made[:, 7], made[:, 9] = 0.75, -np.abs(made[:, 7]), made[:, 9] + 30
    return made[:, :k].astype(np.float32)


@functools.cache
def coder_of(code):
    return Coder(code, fit_table(code, training()))


def unseen(n, seed=1, k=K):
    """Codes of the same kind, of which one in ten coordinates is anywhere at all."""
    rng = np.random.default_rng(seed)
    made = training(k)[rng.integers(0, len(training(k)), n)] + rng.normal(size=(n, k)) * 0.3
    return np.where(rng.random((n, k)) < 0.1, rng.normal(size=(n, k)) * 20, made).astype(np.float32)


@pytest.mark.parametrize("seed", range(40))
def test_streams_equal_those_made_in_fractions(seed):
    rng = np.random.default_rng(seed)
    tables = [oracle.random_table(rng, int(rng.integers(1, 12))) for _ in range(rng.integers(0, 7))]
    symbols = [int(rng.integers(len(table) - 1)) for table in tables]
    low, width = oracle.interval(symbols, tables)
    data = write_symbols(symbols, tables)
    assert data == oracle.shortest(low, width)
    assert read_symbols(data, len(tables), tables) == oracle.read(data, tables) == symbols
    assert 8 * len(data) < float(-np.log2(float(width))) + 8


def test_bytes_that_nobody_sends_are_refused_and_the_others_come_back():
    rng = np.random.default_rng(0)
    tables = [oracle.random_table(rng, 6) for _ in range(3)]
    accepted = 0
    for number in range(65536):
        data = number.to_bytes(2, "big")
        symbols = oracle.read(data, tables) if number % 997 == 0 else read_symbols(data, 3, tables)
        if write_symbols(symbols, tables) == data:
            assert read_whole(data, 3, tables) == symbols
            accepted += 1
        elif number % 97 == 0:
            with pytest.raises(StreamError, match="2 bytes are no stream of 3"):
                read_whole(data, 3, tables)
    assert 10 < accepted <= 6**3


@pytest.mark.parametrize("code", CODES)
def test_every_cut_is_what_the_robot_would_have_sent(code):
    coder = coder_of(code)
    for prefix in unseen(25):
        whole = coder.encode(prefix)
        for k in range(K + 1):
            assert coder.cut(whole, K, k) == coder.encode(prefix[:k])
            np.testing.assert_array_equal(coder.decode(coder.encode(prefix[:k]), k), coder.decode(whole, K)[:k])
    with pytest.raises(ValueError, match="cannot be cut"):
        coder.cut(whole, K, K + 1)


def test_a_hundred_thousand_random_codes_decode_to_the_same_symbols():
    table = fit_table("entropy", training(8))
    coder, rows = Coder("entropy", table), [[*row[row < TOTAL].tolist(), TOTAL] for row in table.cumulative]
    rng = np.random.default_rng(2)
    levels = table.grid.last - table.grid.first + 1
    # Half as they come, half with every place of the grid as likely as another.
    symbols = np.concatenate(
        [numbers_of(table.grid, unseen(50_000, 3, 8)) - table.grid.first, rng.integers(0, levels, (50_000, 8))]
    ).tolist()
    assert all(read_whole(write_symbols(s, rows), 8, rows) == s for s in symbols)
    some = values_of(table.grid, np.array(symbols[::100]) + table.grid.first)
    assert all((coder.decode(coder.encode(prefix), 8) == prefix).all() for prefix in some)


@pytest.mark.parametrize("k", [4, 16, K])
def test_streams_are_within_two_percent_and_a_byte_of_the_ideal_length(k):
    coder, frames = coder_of("entropy"), unseen(400, 4)
    ideal = np.array([coder.ideal_bits(prefix[:k]) for prefix in frames]) / 8
    measured = np.array([len(coder.encode(prefix[:k])) for prefix in frames])
    assert (measured < ideal + 1).all() and measured.mean() < 1.02 * ideal.mean() + 1
    # The ideal is that of the table, and the table that of the training codes: as short as their own histogram allows.
    seen = numbers_of(coder.table.grid, training())[:, :k]
    counts = [np.unique(column, return_counts=True)[1] / len(seen) for column in seen.T]
    entropy = sum(float(-(share * np.log2(share)).sum()) for share in counts)
    spent = np.mean([coder.ideal_bits(prefix[:k]) for prefix in training()])
    assert entropy < spent < 1.04 * entropy + 1


@pytest.mark.parametrize("code", CODES[1:])
def test_values_are_the_nearest_places_of_the_grid_on_host_and_device_bit_by_bit(code):
    grid, frames = coder_of(code).table.grid, unseen(60, 5)
    halves = (np.arange(-40, 40)[:, None] + np.float32(0.5)) * grid.step[None]
    frames = np.concatenate([frames, halves.astype(np.float32)])
    numbers = numbers_of(grid, frames)
    exact = [[oracle.nearest(*cell) for cell in zip(row, *grid, strict=True)] for row in frames]
    # Products in float32 may round to a half that exact quotients only come close to.
    assert np.abs(numbers - exact).max() <= 1 and np.mean((numbers != exact)[:60]) < 1e-3
    for snap in (functools.partial(jax.jit(snapped), grid), jax.jit(functools.partial(snapped, grid))):
        np.testing.assert_array_equal(np.asarray(snap(frames)), values_of(grid, numbers))
    for prefix, row in zip(frames[:40], values_of(grid, numbers), strict=False):
        np.testing.assert_array_equal(coder_of(code).decode(coder_of(code).encode(prefix), K), row)


def test_whatever_order_a_robot_sums_in_the_edge_reads_what_it_sent():
    """Two robots whose float32 sums differ may send neighbours; the edge reads either exactly, without deciding."""
    coder = Coder("entropy", fit_table("entropy", training(), 0.5))
    rng = np.random.default_rng(6)
    weights, x = rng.normal(size=(64, K)).astype(np.float32), rng.normal(size=(300, 64)).astype(np.float32)
    orders = [np.arange(64), np.arange(64)[::-1], rng.permutation(64)]
    sums = [np.add.reduce(x[:, order, None] * weights[order], axis=1, dtype=np.float32) / 8 for order in orders]
    # In one order as numbers that lie on the line between two places, in another beside it.
    sums.append(np.round(sums[0] / 0.25).astype(np.float32) * np.float32(0.25))
    sums.append(np.nextafter(sums[-1], np.float32(9)))
    symbols = [numbers_of(coder.table.grid, each) for each in sums]
    assert (symbols[3] != symbols[4]).any() and np.abs(symbols[3] - symbols[4]).max() == 1
    for each, sent in zip(sums, symbols, strict=True):
        received = np.stack([coder.decode(coder.encode(prefix), K) for prefix in each])
        np.testing.assert_array_equal(received, values_of(coder.table.grid, sent))


def test_bytes_of_whole_numbers_are_as_documented():
    prefix = unseen(1)[0, :7]
    for code, of in (("int8", bytes), ("int4", oracle.nibbles)):
        grid = coder_of(code).table.grid
        numbers = numbers_of(grid, prefix) - grid.first[:7]
        assert coder_of(code).encode(prefix) == of(numbers.tolist())
        assert coder_of(code).ideal_bits(prefix) == 7 * int(code[3:])
    assert coder_of("float32").encode(prefix) == prefix.astype("<f4").tobytes()


@pytest.mark.parametrize(("code", "most"), [("int8", 0.01), ("int4", 0.15)])
def test_bytes_lose_little_and_half_bytes_more(code, most):
    coder = coder_of(code)
    received = np.stack([coder.decode(coder.encode(prefix), K) for prefix in training()[:200]])
    lost = np.sqrt(np.mean((received - training()[:200]) ** 2, axis=0))
    spread = np.maximum(training().std(axis=0), 1e-4)
    assert (lost < most * spread).all()


REFUSED = [("float32", b"\0" * 9), ("int8", b"\0" * 4), ("int4", b"\0"), ("int4", b"\0\x10"), ("entropy", b"\xff" * 7)]


@pytest.mark.parametrize(("code", "data"), REFUSED)
def test_bytes_of_a_wrong_length_are_refused(code, data):
    with pytest.raises(StreamError, match="bytes are n"):
        coder_of(code).decode(data, 3)


def damaged(**changes):
    table = fit_table("entropy", training())
    parts = table.grid._asdict() | {"cumulative": table.cumulative}
    parts = {name: np.array(changes.get(name, lambda part: part)(np.array(part))) for name, part in parts.items()}
    return CodeTable(Grid(parts["step"], parts["first"], parts["last"]), parts["cumulative"])


DAMAGE = {
    "differ in length": {"step": lambda part: part[1:]},
    "not positive": {"step": lambda part: part - part.max()},
    "bounds": {"first": lambda part: part - 5000},
    "add up": {"cumulative": lambda part: np.maximum(part - 1, 0)},
    "shares": {"cumulative": lambda part: np.sort(part[:, ::-1] // 2 * 2)},
}


@pytest.mark.parametrize("message", DAMAGE)
def test_a_damaged_table_is_refused(message):
    check_table(damaged())
    with pytest.raises(ValueError, match=message):
        Coder("entropy", damaged(**DAMAGE[message]))


def test_a_fitted_step_costs_the_share_of_the_variance_that_it_may():
    rng = np.random.default_rng(7)
    for size in (1, 5, 60):
        variance = rng.exponential(size=size) ** 4 + 1e-6
        step = float(fitted_step(variance, np))
        lost = np.minimum(step**2 / 12, variance).sum() / variance.sum()
        assert lost == pytest.approx(LOST, rel=1e-6)
        assert float(fitted_step(jnp.asarray(variance, jnp.float32), jnp)) == pytest.approx(step, rel=1e-3)
    assert fitted_step(np.zeros(4), np) == 1.0
    codes = rng.normal(size=(4000, 1)).astype(np.float32)
    coder = Coder("entropy", fit_table("entropy", codes))
    received = np.stack([coder.decode(coder.encode(code), 1) for code in codes])
    assert np.mean((received - codes) ** 2) / codes.var() == pytest.approx(LOST, rel=0.1)


def test_what_cannot_be_fitted_is_refused():
    for codes in (np.zeros((0, 3)), np.zeros(3), np.full((4, 3), np.nan)):
        with pytest.raises(ValueError, match="finite table"):
            fit_table("int8", codes)
    for step, message in ((0.0, "positive"), (1e-7, "far below"), (1e-3, "more than 4096")):
        with pytest.raises(ValueError, match=message):
            fit_table("entropy", training(), step)
    with pytest.raises(ValueError, match="code is one of float32, int8"):
        fit_table("int16", training())
    for code, table in (("entropy", fit_table("int8", training())), ("int4", fit_table("int8", training()))):
        with pytest.raises(ValueError, match=f"no table of code {code}"):
            Coder(code, table)
    with pytest.raises(ValueError, match="without a table"):
        Coder("int8")
