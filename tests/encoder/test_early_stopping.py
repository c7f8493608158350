"""Early stopping keeps exactly the parameters that training had at the best checkpoint."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.early_stopping import fit_early
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import init
from ovibjax.encoder.train import TrainConfig, epochs_of, fit
from tests.encoder.cases import UAV, assert_trees_close, make_data, member_of, quick_jit

RUN = TrainConfig(arch=UAV, prefixes=(2, 5, 8), steps=24, batch=32, warmup=5)  # 12 epochs of two steps
CHECKPOINTS = 4
HYPERS = make_hypers(lr=1e-2)
TARGETS = jnp.array([[0.03], [0.2], [9.0], [jnp.nan]], jnp.float32)


def distance(params, target):
    """A score with its minimum where training passes a given bias."""
    return jnp.abs(jnp.sum(jnp.abs(params["params"]["head_2"]["bias"])) - target[0])


def run(key, data, target, static):
    return fit_early(key, HYPERS, data, static, lambda params: distance(params, target), CHECKPOINTS)


def cut(key, data, epochs, static):
    """Training of full schedule, cut after some epochs."""
    epoch, start, _ = epochs_of(key, HYPERS, data, static, multiple=CHECKPOINTS)
    return jax.lax.fori_loop(0, epochs, lambda number, state: epoch(state, number)[0], start)[0]


early = quick_jit(jax.vmap(run, in_axes=(None, None, 0, None)))
cut_at = quick_jit(cut)


@functools.cache
def outcome():
    return jax.device_get(early(jax.random.key(1), make_data(), TARGETS, RUN))


def test_the_kept_parameters_are_those_of_training_cut_at_the_best_checkpoint():
    key, data = jax.random.key(1), make_data()
    kept, metrics = outcome()
    at_checkpoint = [cut_at(key, data, 3 * (i + 1), RUN) for i in range(CHECKPOINTS)]
    assert metrics["score"].shape == (4, CHECKPOINTS) and metrics["loss"].shape == (4, 12)
    for i, target in enumerate(TARGETS[:3]):
        scores = np.array([distance(params, target) for params in at_checkpoint])
        np.testing.assert_allclose(metrics["score"][i], scores, rtol=1e-3, atol=1e-5)
        best = int(metrics["best"][i])
        assert best == int(np.argmin(metrics["score"][i]))
        assert_trees_close(member_of(kept, i), at_checkpoint[best], rtol=1e-3, atol=1e-5)
    # The targets are such that not every member stops at the same checkpoint.
    assert len(set(metrics["best"].tolist())) > 2


def test_scoring_changes_nothing_of_training_itself():
    _, metrics = outcome()
    _, plain = quick_jit(fit)(jax.random.key(1), HYPERS, make_data(), RUN)
    for series in metrics["loss"]:
        np.testing.assert_allclose(series, plain["loss"], rtol=1e-4)


def test_a_score_that_is_not_a_number_never_wins():
    kept, metrics = outcome()
    assert np.isnan(metrics["score"][3]).all() and metrics["best"][3] == -1
    start = jax.jit(init, static_argnums=1)(jax.random.split(jax.random.key(1), 3)[0], UAV)
    assert_trees_close(member_of(kept, 3), start, rtol=1e-6, atol=1e-6)
