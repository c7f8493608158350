"""The compression methods that are compared under one frozen localizer: how each is trained and judged.

`ovib` is the scalable model; `vib` the same without the orthogonality penalty; `fixed_<K>` a fixed-rate O-VIB of its
own latent dimension K with the ARD prior; `pca_completed` the linear code with `ovib`'s decoder and localizer, trained
on it; `pca` the linear code alone; `raw` no compression. The last two need no training of their own and are judged
with `ovib`'s localizer.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.recipe_study import changed
from ovibjax.edge.judging import Judged, Trained, judge_prefixes, judge_raw
from ovibjax.encoder.loss import GAMMA, Hypers, make_hypers
from ovibjax.encoder.model import Architecture, Params
from ovibjax.encoder.pca import fit_pca
from ovibjax.encoder.train import TrainConfig, fit, fixed_rate
from ovibjax.encoder.training_data import MemberData
from ovibjax.features.basis import ViewBasis
from ovibjax.runtime.progress import progress_bar
from ovibjax.runtime.threads import in_threads
from ovibjax.views import full_mode, mode_mask, modes_for

LATENT = 128
"""Full latent dimension K of the nested models."""

FIXED = (32, 128)
"""Latent dimensions of the fixed-rate bank."""

TRAINED = ("ovib", "vib", "pca_completed", *(f"fixed_{k}" for k in FIXED))
"""Methods that can be trained; without `ovib` there is no figure."""

SPARSE_PREFIXES = (4, 6, 8, 12, 16, 20, 24, 28, 32, 35, 48, 64, 96, 128)
"""Prefixes at which the rivals of `ovib` are judged; `ovib` is judged at every one."""

_fit = jax.jit(fit, static_argnames="static")
_judge_prefixes = jax.jit(judge_prefixes, static_argnames=("arch", "recode"))
judge_raw_jit = jax.jit(judge_raw, static_argnames="arch")


class Outcome(NamedTuple):
    """What one trained method contributes on one seed; arrays on the host.

    Attributes:
        params: the trained network.
        judged: outcome per method (`ovib` brings `pca` and `raw`), leading axis its prefixes.
        recoded: the same at `SPARSE_PREFIXES` where the database passes through the code too (`ovib` only).
        raw_mode_m: mean error of uncompressed features by view mode (`ovib` only).
        losses: [epochs] loss and its terms.
    """

    params: Params
    judged: dict[str, Judged]
    recoded: dict[str, Judged]
    raw_mode_m: dict[str, float]
    losses: dict[str, np.ndarray]


def prefixes_of(method: str) -> np.ndarray:
    """Prefix lengths a method is judged at."""
    if method == "ovib":
        return np.arange(1, LATENT + 1)
    return np.array([int(method.removeprefix("fixed_"))] if method.startswith("fixed_") else SPARSE_PREFIXES)


def architecture_of(data: MemberData) -> Architecture:
    """Widths of the nested models on these data."""
    views, dim = data.train.x.shape[1:]
    return Architecture(n_views=views, view_dim=dim, latent=LATENT)


def train_config(method: str, data: MemberData, steps: int | None, precision: str) -> TrainConfig:
    """Static choices of a trained method; all are trained alike."""
    static = TrainConfig(arch=architecture_of(data), steps=steps, precision=precision)
    if method == "pca_completed":
        return changed(method, static, len(data.train.x))
    return fixed_rate(static, int(method.removeprefix("fixed_"))) if method.startswith("fixed_") else static


def hypers_of(method: str) -> Hypers:
    """The paper's weights; plain VIB has no orthogonality penalty."""
    return make_hypers(gamma=0.0 if method == "vib" else GAMMA)


def run_method(method: str, seed: int, data: MemberData, steps: int | None, precision: str) -> Outcome:
    """Train one method on one seed and judge it, in the mode that uses every view.

    Args:
        method: one of `TRAINED`.
        seed: initialisation, minibatch order and noise; shared by all methods.
        data: the seed's data.
        steps: training steps; by the number of frames if None (`encoder.recipe`).
        precision: operands of the networks' products.

    Returns:
        The outcome, on the host.
    """
    static = train_config(method, data, steps, precision)
    views = static.arch.n_views
    params, losses = _fit(jax.random.key(seed), hypers_of(method), data.train, static)
    trained = Trained(data, params)
    mask = mode_mask(full_mode(views), views)
    judge = partial(_judge_prefixes, trained, static.arch, mask)
    judged = {method: judge(jnp.asarray(prefixes_of(method)))}
    recoded: dict[str, Judged] = {}
    raw_mode_m: dict[str, float] = {}
    if method == "ovib":
        sparse = jnp.array(SPARSE_PREFIXES)
        pca = fit_pca(data.train.x, static.arch.latent)
        judged["pca"] = judge(sparse, pca=pca)
        recoded = {"ovib": judge(sparse, recode=True), "pca": judge(sparse, pca=pca, recode=True)}
        raw = {name: judge_raw_jit(trained, static.arch, mode_mask(name, views)) for name in modes_for(views)}
        judged["raw"] = jax.tree.map(lambda x: x[None], raw[full_mode(views)])
        raw_mode_m = {name: float(jnp.mean(value.test_error_m)) for name, value in raw.items()}
    params, judged, recoded, losses = jax.device_get((params, judged, recoded, losses))
    return Outcome(params, judged, recoded, raw_mode_m, losses)


def run_methods(
    prepared: Mapping[int, tuple[MemberData, ViewBasis]], methods: Sequence[str], steps: int | None, precision: str
) -> tuple[dict[int, dict[str, Outcome]], bool]:
    """Train and judge methods on every seed, with a progress bar; Ctrl-C keeps the seeds that are finished.

    Args:
        prepared: data and basis per seed.
        methods: which of `TRAINED`.
        steps: training steps; by the number of frames if None (`encoder.recipe`).
        precision: operands of the networks' products.

    Returns:
        Outcomes by method, of the seeds on which all methods are finished; and whether Ctrl-C came.

    Raises:
        KeyboardInterrupt: Ctrl-C came before any seed was finished.
    """
    tasks = [(seed, method) for seed in prepared for method in methods]
    finished: dict[int, dict[str, Outcome]] = {seed: {} for seed in prepared}

    def work(task: tuple[int, str]) -> tuple[int, str, Outcome]:
        seed, method = task
        return seed, method, run_method(method, seed, prepared[seed][0], steps, precision)

    interrupted = False
    try:
        with progress_bar("training and judging", len(tasks)) as update:
            update(0)
            for done, (seed, method, outcome) in enumerate(in_threads(work, tasks), start=1):
                finished[seed][method] = outcome
                update(done)
    except KeyboardInterrupt:
        interrupted = True
    finished = {seed: outcomes for seed, outcomes in finished.items() if len(outcomes) == len(methods)}
    if not finished:
        raise KeyboardInterrupt
    return finished, interrupted
