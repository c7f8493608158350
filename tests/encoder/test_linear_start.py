"""Networks that begin as principal component analysis, against NumPy's own decomposition."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import linear_start as module
from ovibjax.encoder import model
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.orthogonality import orthogonality_penalty
from ovibjax.encoder.train import TrainConfig, fit
from tests.encoder.cases import UAV, assert_trees_close, make_data, member_of, stack

COMPLETING = dataclasses.replace(UAV, kind="completing", rank=20, last_hidden=20)

# One program each, not one for every operation in them.
init, decode = jax.jit(model.init, static_argnums=1), jax.jit(model.decode, static_argnums=3)
encode, principal_axes = jax.jit(model.encode, static_argnums=2), jax.jit(module.principal_axes, static_argnums=1)
linear_start = jax.jit(module.linear_start, static_argnums=2)


def untrained(arch):
    """A network at its start, its corrections taken away: what is left is linear."""
    params = linear_start(init(jax.random.key(0), arch), make_data().x, arch)
    tree = dict(params["params"])
    for name in ("encoder_2", "completion", *(f"descriptor_{view}" for view in range(5))):
        if name in tree:
            tree[name] = jax.tree.map(jnp.zeros_like, tree[name])
    return {"params": tree}


def test_the_axes_are_the_principal_directions_with_a_fixed_sign():
    x = np.asarray(make_data().x).reshape(64, -1)
    values, vectors = np.linalg.eigh(x.T.astype(np.float64) @ x)
    ours = np.asarray(principal_axes(jnp.asarray(x), 40))
    np.testing.assert_allclose(ours[:, :30].T @ ours[:, :30], np.eye(30), atol=1e-5)
    np.testing.assert_array_equal(ours[:, 30:], 0.0)
    leading = values[::-1][:3]
    np.testing.assert_allclose(np.linalg.norm(x @ ours[:, :3], axis=0) ** 2, leading, rtol=1e-4)
    np.testing.assert_allclose(np.abs((ours[:, :3] * vectors[:, ::-1][:, :3]).sum(axis=0)), 1.0, atol=1e-4)
    assert (np.take_along_axis(ours, np.abs(ours).argmax(axis=0)[None], axis=0)[:, :30] > 0).all()


@pytest.mark.parametrize("kind", ["linear", "completing"])
@pytest.mark.parametrize("k", [1, 5, 8])
def test_without_corrections_the_code_is_pca(kind, k):
    arch = dataclasses.replace(COMPLETING, kind=kind)
    x = make_data().x.reshape(64, -1)
    axes = principal_axes(x, k)
    params, kept = untrained(arch), jnp.asarray(np.arange(8) < k, jnp.float32)
    decoded = decode(params, encode(params, x, arch)[0], kept, arch)
    np.testing.assert_allclose(decoded, x @ axes @ axes.T, atol=2e-5)
    assert float(orthogonality_penalty(model.mean_projection(params))) == 0.0


def test_every_coordinate_that_came_is_kept_and_every_other_is_predicted():
    params = linear_start(init(jax.random.key(1), COMPLETING), make_data().x, COMPLETING)
    z = jax.random.normal(jax.random.key(2), (6, 8))
    axes = principal_axes(make_data().x.reshape(64, -1), 20)
    for k in (2, 8):
        kept = jnp.asarray(np.arange(8) < k, jnp.float32)
        coordinates = decode(params, z, kept, COMPLETING) @ axes
        np.testing.assert_allclose(coordinates[:, :k], z[:, :k], atol=1e-5)
        assert float(jnp.abs(coordinates[:, k:]).min(axis=0).max()) > 1e-4
    # What was not sent has no part in it.
    other = z.at[:, 2:].add(3.0)
    kept = jnp.asarray(np.arange(8) < 2, jnp.float32)
    decoded = (decode(params, code, kept, COMPLETING) for code in (z, other))
    np.testing.assert_array_equal(*decoded)


def test_training_begins_there_and_clips():
    static = TrainConfig(arch=COMPLETING, prefixes=(2, 8), steps=4, batch=16, clip=1e-8)
    params, _ = jax.jit(fit, static_argnums=3)(jax.random.key(0), make_hypers(weight_decay=0.0), make_data(), static)
    start = linear_start(init(jax.random.split(jax.random.key(0), 3)[0], COMPLETING), make_data().x, COMPLETING)
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), params, start)
    assert 0.0 < max(jax.tree.leaves(moved)) < 0.02


def test_linear_paths_learn_at_their_share_of_the_rate():
    # The first step of Adam moves whatever has a gradient by the learning rate.
    static = TrainConfig(arch=COMPLETING, prefixes=(2, 8), steps=1, batch=64, warmup=1, linear_lr=0.25)
    hypers, data = make_hypers(lr=1e-3, weight_decay=0.0), make_data()
    params, _ = jax.jit(fit, static_argnums=3)(jax.random.key(0), hypers, data, static)
    start = linear_start(init(jax.random.split(jax.random.key(0), 3)[0], COMPLETING), data.x, COMPLETING)
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), params, start)["params"]
    slow = {name for name, layer in moved.items() if name.startswith(("direct", "principal"))} | {"mean"}
    assert len(slow) == 11
    for name, layer in moved.items():
        share = 0.25 if name in slow else 1.0
        assert max(jax.tree.leaves(layer)) == pytest.approx(1e-3 * share, rel=0.02), name


def test_a_grid_of_the_default_network_equals_a_loop():
    static = TrainConfig(arch=COMPLETING, prefixes=(2, 5, 8), steps=40, batch=32)
    grid = [make_hypers(beta=beta, gamma=gamma) for beta, gamma in ((1e-3, 0.1), (1e-1, 0.1), (1e-3, 10.0))]
    train = jax.jit(jax.vmap(fit, in_axes=(None, 0, None, None)), static_argnums=3)
    together = train(jax.random.key(5), stack(*grid), make_data(), static)
    alone = jax.jit(fit, static_argnums=3)
    for i, hypers in enumerate(grid):
        params, metrics = alone(jax.random.key(5), hypers, make_data(), static)
        assert_trees_close(member_of(together[0], i), params, rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(member_of(together[1], i)["loss"], metrics["loss"], rtol=1e-4)
    last = [float(member_of(together[1], i)["loss"][-1]) for i in range(3)]
    assert len(set(last)) == 3 and metrics["loss"][-1] < metrics["loss"][0]


def test_a_dense_network_is_left_as_it_is():
    params = init(jax.random.key(0), UAV)
    assert module.linear_start(params, make_data().x, UAV) is params


@pytest.mark.parametrize("wrong", [{"kind": "deep"}, {"wave": "cosine"}, {"kind": "linear", "rank": 7}])
def test_impossible_networks_are_refused(wrong):
    with pytest.raises(ValueError, match=str(next(iter(wrong))) if "rank" not in wrong else "rank 7"):
        dataclasses.replace(UAV, **wrong)


def test_principal_coordinates_stay_as_they_are():
    arch = dataclasses.replace(COMPLETING, encoder="principal")
    static = TrainConfig(arch=arch, prefixes=(2, 5, 8), steps=30, batch=32)
    data, x = make_data(), make_data().x.reshape(64, -1)
    params, metrics = jax.jit(fit, static_argnums=3)(jax.random.key(3), make_hypers(weight_decay=0.1), data, static)
    mu, logvar = encode(params, x, arch)
    np.testing.assert_allclose(mu, x @ principal_axes(x, 8), atol=1e-4)
    assert float(jnp.exp(0.5 * logvar).max()) < 1e-8
    assert metrics["loss"][-1] < metrics["loss"][0]
    start = linear_start(init(jax.random.split(jax.random.key(3), 3)[0], arch), data.x, arch)["params"]
    same = {name for name in start if jax.tree.all(jax.tree.map(jnp.array_equal, start[name], params["params"][name]))}
    assert same == {"mean", *(f"direct_{view}" for view in range(5))}
    assert set(model.dense_layers(params)) == set(model.dense_layers(untrained(COMPLETING))) - {
        *("encoder_1", "encoder_2", "logvar"),
    }
    with pytest.raises(ValueError, match="linear path"):
        dataclasses.replace(arch, kind="dense")
