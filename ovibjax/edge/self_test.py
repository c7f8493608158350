"""Does this installation compute what it should: one small encoder is trained and judged against a stored number."""

import time
from typing import NamedTuple

import jax
import numpy as np

from ovibjax.edge.member import TrainAndJudge
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig
from ovibjax.encoder.training_data import member_data
from ovibjax.features.frames import make_feature_set

EXPECTED_M = (3.464, 3.121)
"""Mean test errors at the prefixes of `PREFIXES`, as a processor gave them in float32."""

TOLERANCE = 0.05
"""Share by which an error may differ: processors and versions round differently, and training amplifies that."""

PREFIXES = (4, 16)
_FRAMES, _VIEWS, _DIM, _RANK, _LATENT, _STEPS = 600, 5, 48, 16, 16, 300


class SelfTest(NamedTuple):
    """What the self-test found.

    Attributes:
        error_m: mean test error per prefix of `PREFIXES`.
        passed: whether all are what they should be.
        compile_s: seconds of the first run, nearly all of it compiling.
        run_s: seconds of the second one.
    """

    error_m: tuple[float, ...]
    passed: bool
    compile_s: float
    run_s: float


def self_test() -> SelfTest:
    """Train one member on made features twice, in float32.

    Returns:
        Errors, times, and whether the errors are the stored ones.
    """
    draws = np.random.default_rng(0)
    positions_m = np.concatenate([draws.uniform(-50, 50, (_FRAMES, 2)), draws.uniform(1, 10, (_FRAMES, 1))], axis=1)
    # Waves over the plane, as of images that change with the place; each view has its own.
    waves = draws.normal(0, 0.05, (_VIEWS, 3, _DIM))
    features = np.sin(np.einsum("nc,vcd->nvd", positions_m, waves) + draws.uniform(0, 2 * np.pi, (_VIEWS, _DIM)))
    features += 0.1 * draws.normal(size=features.shape)
    member, _ = member_data(make_feature_set(features.astype(np.float32), positions_m, source="self-test"), 0, _RANK)
    arch = Architecture(view_dim=_RANK, latent=_LATENT, rank=_LATENT, hidden=64, last_hidden=32, head=32)
    static = TrainConfig(arch=arch, prefixes=PREFIXES, steps=_STEPS, batch=64)
    judge = jax.jit(TrainAndJudge(static, PREFIXES, ("A5",)))
    seconds = []
    for _ in range(2):
        started = time.perf_counter()
        outputs = jax.block_until_ready(judge(jax.random.key(0), {}, member))
        seconds.append(time.perf_counter() - started)
    error_m = np.asarray(outputs["test_mean_m"])[0]
    passed = bool(np.allclose(error_m, EXPECTED_M, rtol=TOLERANCE))
    return SelfTest(tuple(error_m.tolist()), passed, *seconds)
