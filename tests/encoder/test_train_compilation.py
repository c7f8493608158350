"""A grid of trainings is one program, and a second grid of other values compiles none."""

import functools
import logging

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.loss import Hypers
from ovibjax.encoder.train import TrainConfig
from tests.encoder.cases import UGV, assert_trees_equal, fit_grid, make_data, member_of, quick_jit


class Compilations(logging.Handler):
    """Names of the programs XLA compiled while the context was open."""

    def __enter__(self):
        self.names = []
        self.logging = jax.log_compiles()
        self.logging.__enter__()
        logging.getLogger("jax").addHandler(self)
        return self

    def __exit__(self, *exception):
        logging.getLogger("jax").removeHandler(self)
        self.logging.__exit__(*exception)

    def emit(self, record):
        message = record.getMessage()
        if message.startswith("Finished XLA compilation of "):
            self.names.append(message.removeprefix("Finished XLA compilation of ").split(" in ")[0])


@functools.cache
def two_grids():
    """Programs compiled by a first grid, by a second of other values, by the first again; traces; metrics."""
    traces = []

    @quick_jit
    def grid(keys, hypers, data, static):
        traces.append(static)
        return fit_grid(keys, hypers, data, static)

    def inputs(seed):
        rng = np.random.default_rng(seed)
        ranges = {
            "alpha": (0.5, 2),
            "beta": (1e-4, 1e-2),
            "gamma": (0.01, 1),
            "lr": (5e-3, 2e-2),
            "weight_decay": (0, 0.1),
            "nesting": (0, 1),
        }
        hypers = Hypers(**{name: jnp.array(rng.uniform(*ends, 3), jnp.float32) for name, ends in ranges.items()})
        # Equal settings written anew are the same static argument.
        static = TrainConfig(arch=UGV, prefixes=(2, 5, 8), prior="ard", steps=300, batch=20, warmup=10)
        return jax.random.split(jax.random.key(seed), 2), hypers, make_data(4, n=40, seed=seed), static

    # Inputs are made before the count starts.
    first, second, again = inputs(0), inputs(1), inputs(0)
    jax.block_until_ready((first[:3], second[:3], again[:3]))
    counts, outputs = [], []
    for arguments in (first, second, again):
        with Compilations() as compiled:
            outputs.append(jax.block_until_ready(grid(*arguments)))
        counts.append(compiled.names)
    return counts, traces, jax.device_get(outputs)


def test_a_grid_compiles_once_and_a_second_grid_of_other_values_never():
    (first, second, again), traces, outputs = two_grids()
    assert len(first) == 1 and "grid" in first[0]
    assert second == [] and again == [] and len(traces) == 1
    assert np.all(outputs[0][1]["loss"] != outputs[1][1]["loss"])
    assert_trees_equal(outputs[0], outputs[2])


def test_the_fixed_rate_model_of_a_ugv_learns_in_every_member_of():
    _, _, outputs = two_grids()
    for _, metrics in outputs[:2]:
        for seed, member in np.ndindex(2, 3):
            # 40 rows in batches of 20: two steps an epoch.
            series = member_of(metrics, seed, member)
            assert series["rate"].shape == (150,) and np.all(series["rate"] > 0)
            assert np.mean(series["localization"][-20:]) < 0.6 * series["localization"][0]
            assert np.mean(series["reconstruction"][-20:]) < 0.6 * series["reconstruction"][0]


def test_the_counter_sees_a_new_program():
    with Compilations() as compiled:
        jax.jit(lambda x: x * 3 + 1)(np.float32(2.0))
    assert len(compiled.names) >= 1
