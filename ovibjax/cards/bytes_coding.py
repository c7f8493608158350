"""Networks coded in every way: the bytes of test frames' streams, and the errors of what arrives.

Steps and tables are fitted on training codes, streams are those of test frames, coded one by one.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.judging import Trained, judge, judge_prefixes
from ovibjax.encoder.bits import steps_of
from ovibjax.encoder.loss import BETA
from ovibjax.encoder.model import Architecture, encode
from ovibjax.encoder.pca import fit_pca, pca_coordinates
from ovibjax.encoder.product_quantiser import fit_product_quantiser, quantised
from ovibjax.encoder.training_data import MemberData
from ovibjax.link.coded_packets import CodedRequest, pack_coded, pack_compact
from ovibjax.link.codes.arithmetic import TOTAL_BITS
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import numbers_of
from ovibjax.link.codes.tables import CodeTable, fit_table
from ovibjax.views import MODES, full_mode, mode_mask

KS = (4, 6, 8, 12, 16, 20, 24, 32, 35, 48, 64, 96, 128)
"""Prefix lengths at which nested codes are judged."""

PQ_BYTES = (8, 16, 32)

_judge_prefixes = jax.jit(judge_prefixes, static_argnames="arch")
_encode = jax.jit(encode, static_argnames="arch")
Row = dict[str, Any]
"""What one coding of one prefix comes to on one seed; see `Coding`."""


class Network(NamedTuple):
    """A code that was trained or fitted, with what judges it and its codes of training and test frames.

    Attributes:
        trained: the localizer and the data of its seed.
        arch: widths of the network.
        ks: prefixes that may be sent.
        training: [N, K] codes of training frames.
        test: [T, K] codes of test frames.
        pca: the linear code, if it is one.
    """

    trained: Trained
    arch: Architecture
    ks: tuple[int, ...]
    training: np.ndarray
    test: np.ndarray
    pca: Any = None


def network_of(trained: Trained, arch: Architecture, ks: tuple[int, ...] = KS) -> Network:
    """A trained network with its codes."""
    return Network(trained, arch, ks, *(np.asarray(_encode(trained.params, x, arch)[0]) for x in _frames(trained.data)))


def linear_network(trained: Trained, arch: Architecture) -> Network:
    """PCA under a network's localizer."""
    pca = fit_pca(trained.data.train.x, arch.latent)
    training, test = (np.asarray(pca_coordinates(pca, x)) for x in _frames(trained.data))
    return Network(trained, arch, KS, training, test, pca)


def _frames(data: MemberData) -> list[jax.Array]:
    """Training and test features, flat."""
    return [x.reshape(x.shape[0], -1) for x in (data.train.x, data.test_x)]


class Coding:
    """Codes and judges networks, and keeps what it finds.

    Args:
        steps: steps of entropy-coded networks that have none of their own, the finest first.

    Attributes:
        rows: one per method, setting, code, prefix and seed: `code_bytes`, `ideal_bytes`, `packet_bytes` (version 2),
            `compact_bytes`, `val_mean_m`, `mean_m`; bytes are means over test frames.
        excess_bytes: most that any stream was longer than 1.02 times its ideal length.
    """

    def __init__(self, steps: Sequence[float]) -> None:
        self.rows: list[Row] = []
        self.excess_bytes = -np.inf
        self._steps = steps
        self._bits: dict[tuple[str, float], list[np.ndarray]] = {}

    def mean_bits(self) -> dict[tuple[str, float], np.ndarray]:
        """[K] bits of each coordinate of `ovib` and `bits` by setting, mean over test frames and seeds; finest step."""
        return {named: np.mean(each, axis=0) for named, each in self._bits.items()}

    def code(self, method: str, setting: float, seed: int, network: Network) -> None:
        """Rows of a network in every code."""
        if method == "bits":
            learned = np.asarray(steps_of(network.trained.params))
            self._coded(method, "entropy", setting, seed, network, learned)
            return
        if setting not in (0.0, BETA):  # other weights of the rate term are for its comparison with bits alone
            self._coded(method, "entropy", setting, seed, network, self._steps[0])
            return
        for code in ("float32", "int8", "int4"):
            self._coded(method, code, setting, seed, network, 1.0)
        for step in self._steps:
            self._coded(method, "entropy", setting, seed, network, step)

    def quantise(self, seed: int, network: Network, key: jax.Array) -> None:
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
        self, method: str, code: str, setting: float, seed: int, network: Network, step: np.ndarray | float
    ) -> None:
        table = fit_table(code, network.training, step)
        coder, arch = Coder(code, table), network.arch
        mask = mode_mask(full_mode(arch.n_views), arch.n_views)
        trained = network.trained if table is None else network.trained._replace(grid=table.grid)
        judged = _judge_prefixes(trained, arch, mask, jnp.array(network.ks), pca=network.pca)
        of_step = float(step) if code == "entropy" and np.ndim(step) == 0 else 0.0
        if table is not None and code == "entropy":
            bits = bits_of(table, network.test)
            if method == "bits" or (method == "ovib" and of_step == self._steps[0]):
                self._bits.setdefault((method, setting), []).append(bits.mean(axis=0))
        else:
            bits = np.full(network.test.shape, {"float32": 32.0, "int8": 8.0, "int4": 4.0}[code])
        ideal = np.cumsum(bits, axis=1) / 8
        for i, k in enumerate(network.ks):
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
        self.rows.append(row)


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
