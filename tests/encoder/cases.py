"""What the tests of the encoder share: small networks and data, members of a grid, batches."""

import dataclasses
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.encoder.loss import Batch, composite_loss
from ovibjax.encoder.model import Architecture, init
from ovibjax.encoder.train import TrainData, fit, view_rows
from ovibjax.features.frames import make_feature_set
from tests.oracles import encoder as oracle
from tests.runtime.cases import QUICK

TERMS = ["reconstruction", "localization", "rate", "orthogonality"]


UAV = Architecture(n_views=5, view_dim=6, latent=8, hidden=16, last_hidden=12, head=10, kind="dense")

UGV = dataclasses.replace(UAV, n_views=4)


@functools.cache
def shapes_of(arch):
    return jax.eval_shape(functools.partial(init, arch=arch), jax.random.key(0))


def make_params(arch, seed=0):
    """Parameters with the model's shapes and no structure: no bias is zero."""
    rng = np.random.default_rng(seed)

    def draw(leaf):
        scale = leaf.shape[0] ** -0.5 if len(leaf.shape) == 2 else 0.3
        return jnp.array(1.5 * scale * rng.normal(size=leaf.shape), jnp.float32)

    return jax.tree.map(draw, shapes_of(arch))


@functools.cache
def make_data(n_views=5, n=64, seed=0):
    """A plane curve seen through every view: position and features share three factors."""
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(n, 3)).astype(np.float32)
    x = np.tanh(np.einsum("nk,kmr->nmr", y, rng.normal(size=(3, n_views, 6))))
    x = (x - x.mean(axis=0)) / x.std()
    return TrainData(jnp.array(x, jnp.float32), jnp.array(y))


def smooth_frames():
    """260 frames of four views whose features change smoothly with the position."""
    rng = np.random.default_rng(0)
    position = rng.uniform(-40, 40, (260, 3)).astype(np.float32)
    features = np.tanh(position @ rng.normal(size=(3, 4 * 9)) / 30).reshape(260, 4, 9) + 0.02
    return make_feature_set(features, position)


def stack(*hypers):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *hypers)


def member_of(tree, *index):
    """One member of a grid's results."""
    return jax.tree.map(lambda leaf: leaf[index], tree)


def assert_trees_equal(a, b):
    chex.assert_trees_all_equal(jax.device_get(a), jax.device_get(b))


def assert_trees_close(a, b, rtol, atol):
    chex.assert_trees_all_close(jax.device_get(a), jax.device_get(b), rtol=rtol, atol=atol)


quick_jit = functools.partial(jax.jit, static_argnums=3, compiler_options=QUICK)


def fit_grid(keys, hypers, data, static):
    """[seeds, members]."""
    over_hypers = jax.vmap(fit, in_axes=(None, 0, None, None))
    return jax.vmap(over_hypers, in_axes=(0, None, None, None))(keys, hypers, data, static)


def value_and_grad(params, batch, hypers, arch, prior, rows=None, precision="float32"):
    return jax.value_and_grad(composite_loss, has_aux=True)(params, batch, hypers, arch, prior, rows, precision)


differentiate = jax.jit(value_and_grad, static_argnums=(3, 4, 5, 6), compiler_options=QUICK)


def random_batch(arch, size=7, seed=0):
    """Every mode and every prefix length of the platform side by side."""
    rng = np.random.default_rng(seed)
    modes = ["A5", "F", "H4", "FS"] if arch.n_views == 5 else ["H4", "F", "FS"]
    return Batch(
        x=rng.normal(size=(size, arch.n_views, arch.view_dim)).astype(np.float32),
        y=rng.normal(size=(size, 3)).astype(np.float32),
        view_mask=np.float32([oracle.view_mask(modes[n % len(modes)], arch.n_views) for n in range(size)]),
        prefix_mask=np.float32([oracle.prefix_mask(1 + (3 * n) % arch.latent, arch.latent) for n in range(size)]),
        noise=rng.normal(size=(size, arch.latent)).astype(np.float32),
    )


def stratified_batch(static, size, seed=0):
    """A batch whose view masks are those of training, with every prefix length."""
    batch = random_batch(static.arch, size, seed)
    return batch._replace(view_mask=view_rows(static, size)[0])


train, train_grid = quick_jit(fit), quick_jit(fit_grid)
