"""Training as a pure function of a key, hyperparameters and data: one member, and a grid of them."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder.epochs import schedule_of
from ovibjax.encoder.loss import Hypers, make_hypers
from ovibjax.encoder.recipe import PAPER_PREFIXES, training_prefixes, training_steps
from ovibjax.encoder.train import TrainConfig, fit, fixed_rate, paper_recipe
from tests.encoder.cases import (
    TERMS,
    UAV,
    UGV,
    assert_trees_equal,
    make_data,
    member_of,
    quick_jit,
    stack,
    train,
    train_grid,
)

METRICS = ["loss", *TERMS]


# As many rows in a batch as there are: one step an epoch, so that the metrics show every step.
RUN = TrainConfig(arch=UAV, prefixes=(2, 5, 8), steps=300, batch=64, warmup=10)

GRID = [
    make_hypers(lr=1e-2),
    make_hypers(lr=1e-2),
    make_hypers(lr=1e-2, beta=0.5, gamma=3.0),
    make_hypers(alpha=5.0, lr=1e-2, weight_decay=0.1),
    make_hypers(lr=0.0),
    make_hypers(lr=0.0, beta=0.7, gamma=9.0, weight_decay=0.5),
    make_hypers(lr=1e-2, nesting=0.3),
]


@functools.cache
def grid_run():
    """Two seeds by seven members."""
    return jax.device_get(train_grid(jax.random.split(jax.random.key(3), 2), stack(*GRID), make_data(), RUN))


def assert_learned(metrics):
    assert sorted(metrics) == sorted(METRICS)
    for name in METRICS:
        assert metrics[name].shape == (300,) and metrics[name].dtype == jnp.float32
        assert np.all(np.isfinite(metrics[name]))
    for name in ("loss", "reconstruction", "localization"):
        assert np.mean(metrics[name][-20:]) < 0.6 * metrics[name][0], name


def test_training_lowers_the_loss():
    params, metrics = train(jax.random.key(0), make_hypers(lr=1e-2), make_data(), RUN)
    assert_learned(metrics)
    total = metrics["reconstruction"] + metrics["localization"]
    total = total + 1e-3 * metrics["rate"] + 0.1 * metrics["orthogonality"]
    np.testing.assert_allclose(metrics["loss"], total, rtol=1e-4)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(params))


@pytest.mark.parametrize(("n", "batch", "steps", "epochs"), [(10, 128, 5, 5), (10, 4, 5, 3), (10, 10, 1, 1)])
def test_steps_are_rounded_up_to_whole_epochs_and_few_rows_make_a_small_batch(n, batch, steps, epochs):
    static = TrainConfig(arch=UAV, prefixes=(8,), steps=steps, batch=batch)
    shapes = jax.eval_shape(functools.partial(fit, static=static), jax.random.key(0), make_hypers(), make_data(n=n))
    assert {name: leaf.shape for name, leaf in shapes[1].items()} == dict.fromkeys(METRICS, (epochs,))


def test_a_run_is_a_function_of_its_key():
    data = make_data()
    first = train(jax.random.key(11), make_hypers(), data, RUN)
    assert_trees_equal(first, train(jax.random.key(11), make_hypers(), data, RUN))
    other = train(jax.random.key(12), make_hypers(), data, RUN)
    assert np.all(first[1]["loss"] != other[1]["loss"])
    for a, b in zip(jax.tree.leaves(first[0]), jax.tree.leaves(other[0]), strict=True):
        assert not np.array_equal(a, b)


@pytest.mark.parametrize(("seed", "member"), [(0, 0), (0, 2), (1, 3), (1, 5), (0, 6)])
def test_a_member_alone_equals_its_lane_of_the_grid(seed, member):
    _, metrics = grid_run()
    key = jax.random.split(jax.random.key(3), 2)[seed]
    _, alone = train(key, GRID[member], make_data(), RUN)
    for name in METRICS:
        assert metrics[name].shape == (2, 7, 300)
        # Later steps drift: Adam divides a gradient by its size, so one of rounding noise may turn a step around.
        ours, theirs = metrics[name][seed, member, :6], alone[name][:6]
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, err_msg=name)
    if GRID[member].lr > 0:
        assert np.ptp(alone["orthogonality"][:6]) > 1e-4 * alone["orthogonality"][0]


def test_lanes_differ():
    _, metrics = grid_run()
    last = metrics["loss"][:, :, -1]
    # Members 0 and 1 have equal hyperparameters; all others and both seeds are apart.
    assert len({round(float(value), 5) for value in last[:, 1:].ravel()}) == 12
    assert np.all(metrics["loss"][0, 0] != metrics["loss"][1, 0])


def test_equal_hyperparameters_and_key_are_equal_to_the_bit():
    params, metrics = grid_run()
    for seed in range(2):
        assert_trees_equal(member_of(params, seed, 0), member_of(params, seed, 1))
        assert_trees_equal(member_of(metrics, seed, 0), member_of(metrics, seed, 1))


def test_members_of_a_seed_see_the_same_rows_masks_and_noise():
    params, metrics = grid_run()
    for seed in range(2):
        # A learning rate of zero stops the parameters, whatever the other weights.
        assert_trees_equal(member_of(params, seed, 4), member_of(params, seed, 5))
        for name in ("reconstruction", "localization", "rate", "orthogonality"):
            np.testing.assert_array_equal(metrics[name][seed, 4], metrics[name][seed, 5])
            # All members start from the same parameters and the same first batch, but for the share of nesting.
            np.testing.assert_allclose(metrics[name][seed, :6, 0], metrics[name][seed, 0, 0], rtol=1e-5)
            same = name in ("rate", "orthogonality")
            assert np.isclose(metrics[name][seed, 6, 0], metrics[name][seed, 0, 0], rtol=1e-5) == same
        assert np.all(metrics["loss"][seed, 4] != metrics["loss"][seed, 5])
        # The draws do change from step to step, also for parameters that stand still.
        assert len(set(metrics["reconstruction"][seed, 4].tolist())) > 290
    assert np.all(metrics["reconstruction"][0, 4] != metrics["reconstruction"][1, 4])


def test_masks_and_noise_are_fresh_at_every_step():
    # With equal rows the order of rows has no part in what the metrics see; the learning rate is zero in member 4.
    data = make_data()
    data = data._replace(x=data.x[:1].repeat(64, axis=0), y=data.y[:1].repeat(64, axis=0))
    _, metrics = train_grid(jax.random.split(jax.random.key(3), 2), stack(*GRID), data, RUN)
    # View modes have fixed shares and the rate ignores noise and prefix: it stands still.
    for seed in range(2):
        np.testing.assert_allclose(metrics["rate"][seed, 4], metrics["rate"][seed, 4, 0], rtol=1e-6)
    for name in ("reconstruction", "localization"):
        for seed in range(2):
            assert len(set(np.asarray(metrics[name])[seed, 4].tolist())) > 250, name


def test_members_may_differ_in_every_hyperparameter():
    assert set(Hypers._fields) == {"alpha", "beta", "gamma", "lr", "weight_decay", "nesting"}
    base = GRID[0]
    _, reference = grid_run()
    keys = jax.random.split(jax.random.key(3), 2)
    changed = [base._replace(**{name: jnp.float32(0.9)}) for name in Hypers._fields]
    _, metrics = train_grid(keys, stack(base, *changed), make_data(), RUN)
    np.testing.assert_array_equal(metrics["loss"][:, 0], reference["loss"][:, 0])
    for member, name in enumerate(Hypers._fields, start=1):
        assert np.all(metrics["loss"][:, member, 5] != metrics["loss"][:, 0, 5]), name


def test_without_nesting_a_member_equals_one_of_full_length():
    hypers = make_hypers(lr=1e-2, nesting=0.0)
    _, ours = train(jax.random.key(4), hypers, make_data(), RUN)
    # Row order, initial parameters and noise do not depend on how prefixes are drawn.
    _, theirs = train(jax.random.key(4), hypers, make_data(), dataclasses.replace(RUN, prefixes=(8,)))
    for name in METRICS:
        np.testing.assert_allclose(ours[name][:6], theirs[name][:6], rtol=1e-4, err_msg=name)


@pytest.mark.parametrize("n_views", [pytest.param(5, marks=pytest.mark.long), 4])
def test_a_grid_in_bfloat16_learns_as_one_in_float32(n_views):
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, prefixes=(2, 5, 8), steps=150, batch=32, warmup=10)
    hypers, series = stack(make_hypers(lr=1e-2), make_hypers(lr=1e-2, alpha=2.0)), {}
    for precision in ("float32", "bfloat16"):
        config = dataclasses.replace(static, precision=precision)
        members = quick_jit(jax.vmap(fit, in_axes=(None, 0, None, None)))
        params, metrics = members(jax.random.key(5), hypers, make_data(n_views, n=160), config)
        assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves((params, metrics)))
        series[precision] = np.asarray(metrics["loss"])
        assert series[precision].shape == (2, 30)
        assert np.all(series[precision][:, -3:].mean(axis=1) < 0.6 * series[precision][:, 0])
    first = series["bfloat16"][:, 0] / series["float32"][:, 0] - 1
    assert np.all(np.abs(first) < 0.01) and np.all(first != 0.0)


def test_the_default_prefixes_end_at_the_full_code_as_the_papers_do():
    assert PAPER_PREFIXES == (4, 8, 16, 32, 64, 96, 128)
    static = TrainConfig()
    assert static.prefixes == training_prefixes() and min(static.prefixes) == 4
    assert max(static.prefixes) == max(PAPER_PREFIXES) == static.arch.latent
    assert training_prefixes(10) == (4, *[8] * 5, 10, 10) and training_prefixes(4) == (4, 4)
    assert hash(static) == hash(TrainConfig()) and static != TrainConfig(steps=1)
    assert math.isclose(float(make_hypers().beta), 1e-3, rel_tol=1e-6)


@pytest.mark.parametrize(
    ("n", "batch", "steps"),
    [
        (3495, 128, 75 * 27),
        (1400, 128, 75 * 10),
        (3495, 512, 75 * 6),
        (60, 128, 400),
        (700, 128, 400),
        (10**6, 128, 10**4),
    ],
)
def test_the_length_of_a_training_follows_the_number_of_examples(n, batch, steps):
    assert training_steps(n, batch) == steps
    assert schedule_of(None, batch, n) == schedule_of(steps, batch, n)


def test_the_fixed_rate_model_has_one_length_and_the_ard_prior():
    scalable = TrainConfig(steps=7, precision="bfloat16")
    fixed = fixed_rate(scalable, 32)
    assert fixed.arch.latent == 32 and fixed.prefixes == (32,) and fixed.prior == "ard"
    assert fixed.linear_lr == 1.0
    back = {name: getattr(scalable, name) for name in ("arch", "prefixes", "prior", "linear_lr")}
    back = dataclasses.replace(fixed, **back)
    assert back == scalable


def test_the_papers_recipe_is_what_the_paper_says():
    static = paper_recipe(TrainConfig(precision="bfloat16"), 3495)
    assert static.arch.kind == "dense" and static.prefixes == PAPER_PREFIXES and static.batch == 512
    assert schedule_of(static.steps, static.batch, 3495) == (512, 6, 50) and static.precision == "bfloat16"
    few = paper_recipe(TrainConfig(arch=UAV), 60)
    assert schedule_of(few.steps, few.batch, 60) == (60, 1, 50) and set(few.prefixes) == {4, 8}
