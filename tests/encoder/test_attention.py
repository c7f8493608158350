"""Multi-view fusion: forward pass against NumPy, masks, view embeddings, and its training."""

import dataclasses
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import attention as module
from ovibjax.encoder.attention import AttentionConfig, fit_attention, init_attention
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.train import TrainData
from ovibjax.encoder.training_data import Standardizer
from ovibjax.views import mask_table
from tests.encoder.cases import QUICK, member_of, quick_jit, stack
from tests.oracles import attention as oracle

# One step an epoch: the metrics show every step.
RUN = AttentionConfig(view_dim=6, width=16, heads=2, blocks=1, mlp=24, steps=200, batch=64, warmup=10)
SAMPLED = dataclasses.replace(RUN, steps=6, batch=32, all_views=False)
ALL = np.ones(5, np.float32)
TRACES = []


def counted_fit(key, hypers, data, static):
    TRACES.append(static)
    return fit_attention(key, hypers, data, static)


predict = jax.jit(module.predict, static_argnums=3)
initial = jax.jit(init_attention, static_argnums=1, compiler_options=QUICK)
train = quick_jit(counted_fit)


def rows(n, static, seed=1):
    return np.random.default_rng(seed).normal(size=(n, static.n_views, static.view_dim)).astype(np.float32)


def make_params(static, seed=0):
    """Parameters with the network's shapes and no structure: no bias is zero, no scale is one."""
    rng = np.random.default_rng(seed)
    shapes = jax.eval_shape(functools.partial(init_attention, static=static), jax.random.key(0))
    return jax.tree.map(lambda leaf: jnp.array(0.4 * rng.normal(size=leaf.shape), jnp.float32), shapes)


@functools.cache
def make_data(seed=0, n=64):
    """Positions are a linear function of the features, the same for every seed: two factors of every view."""
    x = np.random.default_rng(seed).normal(size=(n, 5, 6))
    y = np.einsum("nmr,mrk->nk", x[:, :, :2], np.random.default_rng(99).normal(size=(5, 2, 3))) / np.sqrt(10)
    return TrainData(jnp.array(x, jnp.float32), jnp.array(y, jnp.float32))


# ---- forward pass ----


@pytest.mark.parametrize("n_views", [5, 4])
@pytest.mark.parametrize(("heads", "blocks"), [(2, 1), (4, 2), (1, 0)])
def test_the_network_equals_the_numpy_forward_pass(n_views, heads, blocks):
    static = dataclasses.replace(RUN, n_views=n_views, heads=heads, blocks=blocks)
    params, x = make_params(static), rows(12, static)
    masks = np.random.default_rng(2).integers(0, 2, (12, n_views)).astype(np.float32)
    masks[np.arange(12), np.arange(12) % n_views] = 1.0
    out = predict(params, x, masks, static)
    assert out.shape == (12, 3) and out.dtype == jnp.float32
    np.testing.assert_allclose(out, oracle.predict(params, x, masks), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("mask", np.asarray(mask_table(5)))
def test_one_mask_serves_the_whole_batch(mask):
    params, x = make_params(RUN), rows(4, RUN)
    out = predict(params, x, mask, RUN)
    np.testing.assert_array_equal(out, predict(params, x, np.tile(mask, (4, 1)), RUN))
    np.testing.assert_allclose(out, oracle.predict(params, x, np.tile(mask, (4, 1))), rtol=1e-4, atol=1e-4)


def test_positions_are_in_metres():
    params, x, mask = make_params(RUN), rows(4, RUN), ALL
    standardizer = Standardizer(jnp.array([10.0, -20.0, 3.0]), jnp.float32(50.0))
    out = jax.jit(module.positions_m, static_argnums=4)(params, x, standardizer, mask, RUN)
    expected = 50.0 * oracle.predict(params, x, np.ones((4, 5))) + np.array([10.0, -20.0, 3.0])
    np.testing.assert_allclose(out, expected, rtol=1e-4, atol=1e-3)


# ---- masked views ----


@pytest.mark.parametrize("value", [0.0, -3.0, 1e30, np.inf, np.nan])
def test_a_masked_view_has_no_influence_whatever_its_features(value):
    static = dataclasses.replace(RUN, blocks=2)
    params, x, mask = make_params(static), rows(6, static), np.array([1, 0, 1, 1, 0], np.float32)
    changed = x.copy()
    changed[:, mask == 0] = value
    out = predict(params, x, mask, static)
    assert np.all(np.isfinite(out))
    np.testing.assert_array_equal(predict(params, changed, mask, static), out)
    # The same views count when they are present.
    seen = predict(params, np.clip(np.nan_to_num(changed), -9, 9), ALL, static)
    assert np.all(np.abs(np.asarray(seen - out)).max(axis=1) > 1e-3)


def test_the_embedding_and_projection_of_a_masked_view_have_no_influence():
    static = dataclasses.replace(RUN, blocks=2)
    params, x, mask = make_params(static), rows(6, static), np.array([1, 1, 0, 1, 1], np.float32)
    out = predict(params, x, mask, static)
    for name in ("view_embedding", "token"):
        changed = {"params": {**params["params"], name: params["params"][name].at[2].add(5.0)}}
        np.testing.assert_array_equal(predict(changed, x, mask, static), out)
        assert np.all(predict(changed, x, ALL, static) != out)


def test_gradients_do_not_reach_a_masked_view():
    params, x, mask = make_params(RUN), rows(3, RUN), np.array([1, 0, 1, 1, 1], np.float32)
    x[:, 1] = np.nan
    grad = jax.jit(jax.grad(lambda params, x: jnp.sum(module.predict(params, x, mask, RUN) ** 2), argnums=(0, 1)))
    by_params, by_x = grad(params, x)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(by_params))
    for leaf in (by_params["params"]["view_embedding"], by_params["params"]["token"], by_x.transpose(1, 0, 2)):
        assert np.all(leaf[1] == 0.0) and np.all(np.abs(leaf).reshape(5, -1).max(axis=1)[mask == 1] > 0)


# ---- views are told apart ----


def test_swapped_views_are_told_apart_by_the_embedding():
    params, x, mask = make_params(RUN), rows(6, RUN), ALL
    token, embedding = params["params"]["token"], params["params"]["view_embedding"]
    shared = {"params": {**params["params"], "token": jnp.broadcast_to(token[:1], token.shape)}}
    alike = {"params": {**shared["params"], "view_embedding": jnp.broadcast_to(embedding[:1], embedding.shape)}}
    swapped = x[:, [2, 1, 0, 3, 4]]
    assert np.all(np.abs(np.asarray(predict(shared, swapped, mask, RUN) - predict(shared, x, mask, RUN))) > 1e-4)
    # Without distinct embeddings and projections the network sees a set.
    np.testing.assert_allclose(predict(alike, swapped, mask, RUN), predict(alike, x, mask, RUN), rtol=1e-4, atol=1e-5)


# ---- training ----


@functools.cache
def trained():
    return jax.device_get(train(jax.random.key(0), make_hypers(lr=1e-2), make_data(), RUN))


def squared_error(params, data):
    return np.mean(np.sum(np.asarray(predict(params, data.x, ALL, RUN) - data.y) ** 2, axis=1))


def test_training_learns_a_linear_map_and_beats_the_mean():
    params, metrics = trained()
    loss = metrics["loss"]
    assert loss.shape == (200,) and loss.dtype == np.float32 and np.all(np.isfinite(loss))
    assert loss[-1] < 0.05 * loss[0]
    # 64 rows leave the map open in part; unseen rows must still be better than the mean.
    for data, share in ((make_data(), 0.05), (make_data(seed=5, n=500), 0.6)):
        of_mean = np.mean(np.sum(np.asarray(data.y - data.y.mean(axis=0)[None]) ** 2, axis=1))
        assert squared_error(params, data) < share * of_mean


def test_the_first_loss_is_the_squared_error_of_the_initial_network():
    data = make_data()
    params = initial(jax.random.split(jax.random.key(0), 3)[0], RUN)
    error = oracle.predict(params, data.x, np.ones((64, 5))) - np.asarray(data.y)
    np.testing.assert_allclose(trained()[1]["loss"][0], (error**2).sum(axis=1).mean(), rtol=1e-4)


def test_the_same_key_gives_the_same_result_and_another_key_does_not():
    again = train(jax.random.key(0), make_hypers(lr=1e-2), make_data(), RUN)
    chex.assert_trees_all_equal(jax.device_get(again), trained())
    other = train(jax.random.key(1), make_hypers(lr=1e-2), make_data(), RUN)[1]
    assert np.all(np.asarray(other["loss"]) != trained()[1]["loss"])


def test_the_program_is_compiled_once_for_all_hyperparameters():
    losses = [trained()[1]["loss"][-1]]
    for lr, decay in [(1e-3, 0.0), (3e-3, 0.1)]:
        # Equal settings written anew are the same static argument.
        static = dataclasses.replace(SAMPLED, steps=RUN.steps, batch=RUN.batch, all_views=True)
        metrics = train(jax.random.key(0), make_hypers(lr=lr, weight_decay=decay), make_data(), static)[1]
        losses.append(float(metrics["loss"][-1]))
    assert TRACES.count(RUN) == 1 and len(set(losses)) == 3


def test_a_vmap_over_hyperparameters_equals_a_loop():
    grid = [make_hypers(lr=1e-3), make_hypers(lr=1e-2), make_hypers(lr=1e-3, weight_decay=0.5)]
    key, data = jax.random.key(2), make_data()
    many = quick_jit(jax.vmap(fit_attention, in_axes=(None, 0, None, None)))(key, stack(*grid), data, SAMPLED)
    for i, hypers in enumerate(grid):
        alone = train(key, hypers, data, SAMPLED)
        chex.assert_trees_all_close(member_of(many, i), alone, rtol=1e-4, atol=1e-5)
    # Two steps an epoch; rate and weight decay act.
    assert many[1]["loss"].shape == (3, 3) and len(set(np.asarray(many[1]["loss"])[:, -1].tolist())) == 3


def test_only_views_of_sampled_modes_are_trained(monkeypatch):
    data, hypers = make_data(), make_hypers(lr=1e-2, weight_decay=0.0)
    start = initial(jax.random.split(jax.random.key(0), 3)[0], RUN)["params"]["token"]
    mixed, _ = train(jax.random.key(0), hypers, data, SAMPLED)
    assert np.all(np.abs(np.asarray(mixed["params"]["token"] - start)).max(axis=(1, 2)) > 1e-3)
    # A function of its own is traced anew.
    monkeypatch.setattr(module, "mask_table", lambda n_views: jnp.zeros((3, n_views), jnp.float32).at[:, 4].set(1.0))
    down_only = quick_jit(lambda *arguments: fit_attention(*arguments))
    params, _ = down_only(jax.random.key(0), hypers, data, SAMPLED)
    moved = np.abs(np.asarray(params["params"]["token"] - start)).max(axis=(1, 2))
    assert np.all(moved[:4] < 1e-6) and moved[4] > 1e-3


def test_the_modes_of_the_platform_are_sampled_uniformly():
    # Equal rows and a learning rate of zero: a step's loss is the mean of its modes' errors.
    data, static = make_data(), dataclasses.replace(SAMPLED, steps=200, batch=64)
    data = data._replace(x=data.x[:1].repeat(64, axis=0), y=data.y[:1].repeat(64, axis=0))
    params, metrics = train(jax.random.key(0), make_hypers(lr=0.0), data, static)
    predicted = oracle.predict(params, data.x[:4], np.asarray(mask_table(5)))
    errors = ((predicted - np.asarray(data.y[:4])) ** 2).sum(axis=1)
    assert len(errors) == 4 and np.ptp(errors) > 0.1
    deviation = errors.std() / np.sqrt(200 * 64)
    assert abs(np.mean(metrics["loss"]) - errors.mean()) < 4 * deviation
    np.testing.assert_allclose(np.std(metrics["loss"]), errors.std() / 8, rtol=0.3)


def test_training_on_all_views_does_not_consult_the_modes(monkeypatch):
    def refuse(n_views):
        raise AssertionError

    monkeypatch.setattr(module, "mask_table", refuse)
    untraced = jax.eval_shape(
        lambda *arguments: fit_attention(*arguments, RUN), jax.random.key(0), make_hypers(), make_data()
    )
    assert untraced[1]["loss"].shape == (200,)
    with pytest.raises(AssertionError):
        jax.eval_shape(
            lambda *arguments: fit_attention(*arguments, SAMPLED), jax.random.key(0), make_hypers(), make_data()
        )


def test_a_config_is_a_static_argument():
    config = AttentionConfig()
    assert config == AttentionConfig() and hash(config) == hash(AttentionConfig())
    assert config.all_views and config.width % config.heads == 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.width = 3
