"""Error against bytes that are really sent: learned codes, PCA and product quantisation, each coded in every way.

`ovib` is the scalable model as the paper trains it, `bits` one that is trained for bits, at several prices of a bit;
`ard` fixed-rate models of the conference version, one for each length; `pca` the linear code, `pca_completed` the same
with a decoder and localizer trained on it; `pq` product quantisation. `pca` and `pq` are judged with `ovib`'s
localizer.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray

from ovibjax.cards.bytes_coding import KS, Coding, Row, linear_network, network_of
from ovibjax.cards.job import Job, Sweep
from ovibjax.cards.recipe_study import changed
from ovibjax.edge.judging import Trained
from ovibjax.edge.member import TrainAndJudge, labels_of
from ovibjax.encoder.loss import BETA
from ovibjax.encoder.train import TrainConfig, fixed_rate, for_bits
from ovibjax.encoder.training_data import MemberData
from ovibjax.runtime.progress import progress_bar
from ovibjax.sweep.select import tree_of
from ovibjax.sweep.work import Along
from ovibjax.views import full_mode

FEW_SEEDS = 2
"""Seeds that the rate term is compared with bits on at other weights than the paper's: it differs little by seed."""


class BytesSize(NamedTuple):
    """How much is trained.

    Attributes:
        seeds: how many.
        steps: training steps of every method; by the number of frames if None.
        prices: of a bit, lambda.
        betas: other weights of the rate term than the paper's, whose rate is compared with bits on the first
            `FEW_SEEDS` seeds.
        steps_of_codes: steps of entropy-coded networks that have none of their own, the finest first.
        fixed: lengths of fixed-rate models.
    """

    seeds: int
    steps: int | None
    prices: tuple[float, ...]
    betas: tuple[float, ...]
    steps_of_codes: tuple[float, ...]
    fixed: tuple[int, ...]


class BytesRuns(NamedTuple):
    """What was found.

    Attributes:
        rows: see `Coding`, as the next two.
        excess_bytes: most that any stream was longer than 1.02 times its ideal length.
        per_coordinate: [K] bits of each coordinate by method and setting.
        rate: rate of all coordinates by setting, [seeds]: of `ovib` the rate term of the last epoch in nats, of `bits`
            the length of test codes under the learned prior in bits.
        params: trained `ovib` by seed, at the paper's weight of the rate term.
    """

    rows: list[Row]
    excess_bytes: float
    per_coordinate: dict[tuple[str, float], np.ndarray]
    rate: dict[tuple[str, float], np.ndarray]
    params: dict[int, Any]


class _Kind(NamedTuple):
    """How one method is trained: static choices, settings, the prefixes that are sent, and on how many seeds."""

    method: str
    static: TrainConfig
    settings: tuple[float, ...]
    ks: tuple[int, ...]
    seeds: int


def _kinds(size: BytesSize, static: TrainConfig, n: int) -> dict[str, _Kind]:
    """What is trained, by the name of its sweep; n training examples."""
    static = replace(static, steps=size.steps)
    kinds = {
        "ovib": _Kind("ovib", static, (BETA,), KS, size.seeds),
        "bits": _Kind("bits", for_bits(static), size.prices, KS, size.seeds),
        "pca_completed": _Kind("pca_completed", changed("pca_completed", static, n), (BETA,), KS, size.seeds),
    }
    for k in size.fixed:
        kinds[f"fixed rate {k}"] = _Kind("ard", fixed_rate(static, k), (BETA,), (k,), size.seeds)
    if size.betas:
        # For the rate term alone, of all coordinates.
        kinds["other rates"] = _Kind("ovib", static, size.betas, KS[-1:], min(FEW_SEEDS, size.seeds))
    return kinds


def measure(job: Job, size: BytesSize, static: TrainConfig, members: list[MemberData], seeds: list[int]) -> BytesRuns:
    """Train every method on every seed, code test frames in every way, and judge what arrives.

    Args:
        job: runs sweeps and counts time.
        size: how much is trained.
        static: the recipe.
        members: data per seed.
        seeds: seeds, common to all methods.

    Returns:
        What was found.
    """
    kinds = _kinds(size, static, len(members[0].train.x))
    found = {name: _trained(job.sweep, name, kind, members, seeds) for name, kind in kinds.items()}
    coding, kept = Coding(size.steps_of_codes), {}
    each = [(name, at, i) for name, kind in kinds.items() for at in kind.settings for i in range(kind.seeds)]
    with job.stage("judge"), progress_bar("coding and judging", len(each)) as update:
        for done, (name, setting, i) in enumerate(each, start=1):
            kind, seed = kinds[name], seeds[i]
            params = {"params": tree_of(found[name], "params", {"beta": setting, "seed": seed})}
            network = network_of(Trained(members[i], params), kind.static.arch, kind.ks)
            coding.code(kind.method, setting, seed, network)
            if name == "ovib" and setting == BETA:
                kept[seed] = params
                coding.code("pca", 0.0, seed, linear_network(network.trained, network.arch))
                coding.quantise(seed, network, jax.random.fold_in(jax.random.key(0), i))
            update(done)
    rate = {
        ("ovib", at): found[name].rate.sel(beta=at).values
        for name, kind in kinds.items()
        if kind.method == "ovib"
        for at in kind.settings
    }
    learned = found["bits"].code_bits.isel(mode=0, prefix=0)
    rate |= {("bits", price): learned.sel(beta=price).values for price in size.prices}
    return BytesRuns(coding.rows, coding.excess_bytes, coding.mean_bits(), rate, kept)


def _trained(sweep: Sweep, name: str, kind: _Kind, members: list[MemberData], seeds: Sequence[int]) -> xarray.Dataset:
    """Members [beta, seed] of one method with their parameters; they are judged later, as they are coded."""
    mode, longest = full_mode(kind.static.arch.n_views), kind.ks[-1:]
    return sweep(
        f"training {name}",
        TrainAndJudge(kind.static, longest, (mode,), keep_params=True),
        {"beta": list(kind.settings), "seed": list(seeds[: kind.seeds])},
        Along("seed", members[: kind.seeds]),
        coords={"prefix": list(longest), "mode": [mode]},
        **labels_of(kind.static.prior),
    )
