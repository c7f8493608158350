"""Error against bytes that are really sent: learned codes, PCA and product quantisation, each coded in every way.

`ovib` is the scalable model as the paper trains it, `bits` one that is trained for bits, at several prices of a bit;
`pca` the linear code, `pca_completed` the same with a decoder and localizer trained on it; `pq` product quantisation.
`pca` and `pq` are judged with `ovib`'s localizer. Steps and tables are fitted on training codes, streams are those of
test frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray

from ovibjax.cards.job import Sweep
from ovibjax.cards.recipe_study import changed
from ovibjax.edge.judging import Trained, judge, judge_prefixes
from ovibjax.edge.member import TrainAndJudge, labels_of
from ovibjax.encoder.bits import steps_of
from ovibjax.encoder.loss import BETA
from ovibjax.encoder.model import Architecture, encode
from ovibjax.encoder.pca import fit_pca, pca_coordinates
from ovibjax.encoder.product_quantiser import fit_product_quantiser, quantised
from ovibjax.encoder.train import TrainConfig, for_bits
from ovibjax.encoder.training_data import MemberData
from ovibjax.link.coded_packets import CodedRequest, pack_coded, pack_compact
from ovibjax.link.codes.arithmetic import TOTAL_BITS
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import numbers_of
from ovibjax.link.codes.tables import CodeTable, fit_table
from ovibjax.runtime.progress import progress_bar
from ovibjax.sweep.select import tree_of
from ovibjax.sweep.work import Along
from ovibjax.views import MODES, full_mode, mode_mask

KS = (8, 12, 16, 20, 24, 35, 48, 64, 96, 128)
"""Prefix lengths at which codes are judged."""

PQ_BYTES = (8, 16, 32)

_judge_prefixes = jax.jit(judge_prefixes, static_argnames="arch")
_encode = jax.jit(encode, static_argnames="arch")
Row = dict[str, Any]


class BytesSize(NamedTuple):
    """How much is trained.

    Attributes:
        seeds: how many.
        steps: training steps of every method; by the number of frames if None.
        prices: of a bit, lambda.
        betas: weights of the paper's rate term; the paper's must be among them.
        steps_of_codes: steps of entropy-coded `ovib` and PCA.
    """

    seeds: int
    steps: int | None
    prices: tuple[float, ...]
    betas: tuple[float, ...]
    steps_of_codes: tuple[float, ...]


class BytesRuns(NamedTuple):
    """What was found.

    Attributes:
        rows: one per method, setting, code, prefix and seed: `code_bytes`, `ideal_bytes`, `packet_bytes` (version 2),
            `compact_bytes`, `val_mean_m`, `mean_m`; bytes are means over test frames.
        excess_bytes: most that any stream was longer than 1.02 times its ideal length.
        per_coordinate: [K] bits of each coordinate by method and setting, mean over test frames and seeds.
        rate: rate term of the last epoch by setting of `ovib` (nats) and `bits` (bits), [seeds].
    """

    rows: list[Row]
    excess_bytes: float
    per_coordinate: dict[tuple[str, float], np.ndarray]
    rate: dict[tuple[str, float], np.ndarray]


class _Network(NamedTuple):
    """A code that was trained or fitted, with what judges it and its codes of training and test frames."""

    trained: Trained
    arch: Architecture
    training: np.ndarray
    test: np.ndarray
    pca: Any = None


def measure(
    sweep: Sweep, size: BytesSize, static: TrainConfig, members: list[MemberData], seeds: list[int]
) -> BytesRuns:
    """Train every method on every seed, code test frames in every way, and judge what arrives.

    Args:
        sweep: runs a sweep.
        size: how much is trained.
        static: the recipe.
        members: data per seed.
        seeds: seeds, common to all methods.

    Returns:
        What was found.
    """
    static = replace(static, steps=size.steps)
    completed = changed("pca_completed", static, len(members[0].train.x))
    kinds = {
        "ovib": (static, size.betas),
        "bits": (for_bits(static), size.prices),
        "pca_completed": (completed, (BETA,)),
    }
    found = {name: _trained(sweep, name, *kind, members, seeds) for name, kind in kinds.items()}
    runs = _Coding(BytesRuns([], -np.inf, {}, {}), size)
    each = [(name, setting, i) for i in range(len(seeds)) for name, kind in kinds.items() for setting in kind[1]]
    with progress_bar("coding and judging", len(each)) as update:
        for done, (name, setting, i) in enumerate(each, start=1):
            params = {"params": tree_of(found[name], "params", {"beta": setting, "seed": seeds[i]})}
            network = _network(Trained(members[i], params), kinds[name][0].arch)
            runs.code(name, setting, seeds[i], network)
            if name == "ovib" and setting == BETA:
                runs.code("pca", 0.0, seeds[i], _linear(network.trained, network.arch))
                runs.quantise(seeds[i], network, jax.random.fold_in(jax.random.key(0), i))
            update(done)
    for name in ("ovib", "bits"):
        for setting in kinds[name][1]:
            runs.found.rate[name, setting] = found[name].rate.sel(beta=setting).values
    return runs.found._replace(excess_bytes=runs.excess_bytes)


def _trained(
    sweep: Sweep,
    name: str,
    static: TrainConfig,
    settings: Sequence[float],
    members: list[MemberData],
    seeds: list[int],
) -> xarray.Dataset:
    """Members [beta, seed] of one method with their parameters."""
    mode = full_mode(static.arch.n_views)
    return sweep(
        f"training {name}",
        TrainAndJudge(static, KS, (mode,), keep_params=True),
        {"beta": list(settings), "seed": seeds},
        Along("seed", members),
        coords={"prefix": list(KS), "mode": [mode]},
        **labels_of(static.prior),
    )


def _network(trained: Trained, arch: Architecture) -> _Network:
    training, test = (
        np.asarray(_encode(trained.params, x.reshape(x.shape[0], -1), arch)[0])
        for x in (trained.data.train.x, trained.data.test_x)
    )
    return _Network(trained, arch, training, test)


def _linear(trained: Trained, arch: Architecture) -> _Network:
    """PCA under a network's localizer."""
    pca = fit_pca(trained.data.train.x, arch.latent)
    training, test = (
        np.asarray(pca_coordinates(pca, x.reshape(x.shape[0], -1))) for x in (trained.data.train.x, trained.data.test_x)
    )
    return _Network(trained, arch, training, test, pca)


class _Coding:
    """Codes and judges networks, and keeps what it finds."""

    def __init__(self, found: BytesRuns, size: BytesSize) -> None:
        self.found, self.excess_bytes, self._size = found, -np.inf, size

    def code(self, method: str, setting: float, seed: int, network: _Network) -> None:
        """Rows of a network in every code."""
        if method == "bits":
            learned = np.asarray(steps_of(network.trained.params))
            self._coded(method, "entropy", setting, seed, network, learned)
            return
        if setting not in (0.0, BETA):  # other weights of the rate term are for its comparison with bits alone
            self._coded(method, "entropy", setting, seed, network, self._size.steps_of_codes[0])
            return
        for code in ("float32", "int8", "int4"):
            self._coded(method, code, setting, seed, network, 1.0)
        for step in self._size.steps_of_codes:
            self._coded(method, "entropy", setting, seed, network, step)

    def quantise(self, seed: int, network: _Network, key: jax.Array) -> None:
        """Rows of product quantisation under a network's localizer."""
        trained, arch = network.trained, network.arch
        mask = mode_mask(full_mode(arch.n_views), arch.n_views)
        for n_bytes in (size for size in PQ_BYTES if size <= arch.n_views * arch.view_dim):
            quantiser = fit_product_quantiser(key, trained.data.train.x, n_bytes, arch.latent)
            judged = judge(trained, arch, mask, partial(quantised, quantiser))
            sizes = [n_bytes] * 2
            self._row("pq", "bytes", 0.0, 0.0, n_bytes, seed, arch, sizes, (judged.val_error_m, judged.test_error_m))

    # What names a row.
    def _coded(
        self, method: str, code: str, setting: float, seed: int, network: _Network, step: np.ndarray | float
    ) -> None:
        table = fit_table(code, network.training, step)
        coder, arch = Coder(code, table), network.arch
        mask = mode_mask(full_mode(arch.n_views), arch.n_views)
        trained = network.trained if table is None else network.trained._replace(grid=table.grid)
        judged = _judge_prefixes(trained, arch, mask, jnp.array(KS), pca=network.pca)
        of_step = float(step) if code == "entropy" and np.ndim(step) == 0 else 0.0
        if table is not None and code == "entropy":
            bits = bits_of(table, network.test)
            if method == "bits" or of_step == self._size.steps_of_codes[0]:
                sums = self.found.per_coordinate.setdefault((method, setting), np.zeros(bits.shape[1]))
                sums += bits.mean(axis=0) / self._size.seeds
        else:
            bits = np.full(network.test.shape, {"float32": 32.0, "int8": 8.0, "int4": 4.0}[code])
        ideal = np.cumsum(bits, axis=1) / 8
        for i, k in enumerate(KS):
            length = np.array([len(coder.encode(row[:k])) for row in network.test])
            of_k = ideal[:, min(k, ideal.shape[1]) - 1]  # PCA of few features has fewer coordinates
            self.excess_bytes = max(self.excess_bytes, float((length - 1.02 * of_k).max()))
            errors = (judged.val_error_m[i], judged.test_error_m[i])
            sizes = (length.mean(), of_k.mean())
            self._row(method, code, setting, of_step, k, seed, arch, sizes, errors)

    # A row has as many columns.
    def _row(
        self,
        method: str,
        code: str,
        setting: float,
        step: float,
        k: int,
        seed: int,
        arch: Architecture,
        sizes: Sequence[float],
        errors_m: tuple[jax.Array, jax.Array],
    ) -> None:
        full, compact = overheads_bytes(arch.n_views)
        row: Row = {"method": method, "code": code, "setting": setting, "step": step, "k": k, "seed": seed}
        row |= {"code_bytes": float(sizes[0]), "ideal_bytes": float(sizes[1])}
        row |= {"packet_bytes": row["code_bytes"] + full, "compact_bytes": row["code_bytes"] + compact}
        row |= {"val_mean_m": float(errors_m[0].mean()), "mean_m": float(errors_m[1].mean())}
        self.found.rows.append(row)


def overheads_bytes(n_views: int) -> tuple[int, int]:
    """What a packet with every view adds to a code below 128 bytes: version 2, and with a compact header."""
    request = CodedRequest(full_mode(n_views), "entropy", 1, b"", 10.0, 500, 64, 4096)
    sizes = tuple(len(pack(request)) for pack in (pack_coded, pack_compact))
    assert sizes[0] == 20 + 4 * len(MODES[full_mode(n_views)])
    return sizes[0], sizes[1]


def bits_of(table: CodeTable, codes: np.ndarray) -> np.ndarray:
    """Ideal length of each coordinate of codes [N, K] with a table for `entropy`: [N, K] bits."""
    symbols = numbers_of(table.grid, codes) - np.asarray(table.grid.first)
    column = np.arange(codes.shape[1])
    share = table.cumulative[column, symbols + 1] - table.cumulative[column, symbols]
    bits: np.ndarray = TOTAL_BITS - np.log2(share)
    return bits
