"""The network against an independent NumPy forward pass, and the promises of its parts."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import model
from ovibjax.encoder.model import OVIB, Architecture, init, mean_projection, parameter_bytes
from tests.oracles import encoder as oracle

UAV = Architecture(n_views=5, view_dim=6, latent=8, hidden=16, last_hidden=12, head=10)
UGV = dataclasses.replace(UAV, n_views=4)
encode, decode, locate = (jax.jit(f, static_argnums=2) for f in (model.encode, model.decode, model.locate))


def shapes_of(arch):
    return jax.eval_shape(functools.partial(init, arch=arch), jax.random.key(0))


def make_params(arch, seed=0):
    """Parameters with the model's shapes and no structure: no bias is zero."""
    rng = np.random.default_rng(seed)

    def draw(leaf):
        scale = leaf.shape[0] ** -0.5 if len(leaf.shape) == 2 else 0.3
        return jnp.array(1.5 * scale * rng.normal(size=leaf.shape), jnp.float32)

    return jax.tree.map(draw, shapes_of(arch))


def rows(n, width, seed=1):
    return np.random.default_rng(seed).normal(size=(n, width)).astype(np.float32)


@pytest.mark.parametrize("arch", [UAV, UGV])
def test_every_part_equals_the_numpy_forward_pass(arch):
    params, width = make_params(arch), arch.n_views * arch.view_dim
    x, z, descriptor = rows(9, width, 1), rows(9, arch.latent, 2), rows(9, width, 3)
    mu, logvar = encode(params, x, arch)
    assert mu.shape == logvar.shape == (9, arch.latent)
    theirs = oracle.encode(params, x)
    np.testing.assert_allclose(mu, theirs[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(logvar, theirs[1], rtol=1e-4, atol=1e-5)
    decoded = decode(params, z, arch)
    assert decoded.shape == (9, width)
    np.testing.assert_allclose(decoded, oracle.decode(params, z), rtol=1e-4, atol=1e-5)
    position = locate(params, descriptor, arch)
    assert position.shape == (9, 3)
    np.testing.assert_allclose(position, oracle.locate(params, descriptor), rtol=1e-4, atol=1e-5)


def test_the_whole_chain_is_its_parts_without_noise():
    params, x = make_params(UAV), rows(4, 30)
    descriptor, position = jax.jit(OVIB(UAV).apply)(params, x)
    theirs = oracle.decode(params, oracle.encode(params, x)[0])
    np.testing.assert_allclose(descriptor, theirs, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(position, oracle.locate(params, theirs), rtol=1e-4, atol=1e-5)


def test_each_row_of_a_batch_is_treated_alone():
    params, x = make_params(UAV), rows(6, 30)
    together = encode(params, x, UAV)
    changed = x.copy()
    changed[1:] *= -3
    for whole, other in zip(together, encode(params, changed, UAV), strict=True):
        np.testing.assert_array_equal(whole[0], other[0])
        assert np.all(np.abs(np.asarray(whole - other))[1:].max(axis=1) > 1e-3)


def test_the_posterior_variance_is_bounded():
    _, logvar = encode(make_params(UAV), rows(50, 30) * 1e3, UAV)
    # An overflow of exp(logvar) would poison a whole grid.
    assert float(jnp.min(logvar)) == -12.0 and float(jnp.max(logvar)) == 6.0


def test_the_mean_projection_is_the_matrix_the_mean_uses():
    params = make_params(UAV)
    w = mean_projection(params)
    assert w.shape == (UAV.latent, UAV.last_hidden)
    x = rows(5, 30)
    before, _ = encode(params, x, UAV)
    # Doubling row 3 of W moves coordinate 3 of the mean only.
    kernel = params["params"]["mean"]["kernel"]
    params["params"]["mean"]["kernel"] = kernel.at[:, 3].multiply(2.0)
    np.testing.assert_array_equal(mean_projection(params)[3], 2 * w[3])
    after, _ = encode(params, x, UAV)
    moved = np.abs(np.asarray(after - before)).max(axis=0)
    assert moved[3] > 1e-2 and np.all(np.delete(moved, 3) == 0.0)


@pytest.mark.parametrize("arch", [UAV, UGV, Architecture()])
def test_parameters_are_float32_and_counted_in_bytes(arch):
    width, shapes = arch.n_views * arch.view_dim, shapes_of(arch)
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(shapes))
    layers = [(width, arch.hidden), (arch.hidden, arch.last_hidden), (arch.last_hidden, 2 * arch.latent)]
    layers += [(arch.latent, arch.last_hidden), (arch.last_hidden, arch.hidden), (arch.hidden, width)]
    layers += [(width, arch.head), (arch.head, 3)]
    assert parameter_bytes(shapes) == 4 * sum(fan_in * out + out for fan_in, out in layers)


def test_an_architecture_is_a_static_argument_with_the_papers_widths():
    arch = Architecture()
    assert arch == Architecture() and hash(arch) == hash(Architecture())
    assert arch != dataclasses.replace(arch, latent=64)
    with pytest.raises(dataclasses.FrozenInstanceError):
        arch.latent = 3
    # K = 128 and d_h = 256 (paper, "Experimental Setup" and "Orthogonality Under the IB Objective").
    assert (arch.n_views, arch.latent, arch.last_hidden) == (5, 128, 256)


@functools.cache
def initial(arch):
    """Parameters as the model initialises them."""
    quick = {"xla_backend_optimization_level": 0}
    return jax.jit(init, static_argnums=1, compiler_options=quick)(jax.random.key(1), arch)


WIDE = Architecture(hidden=256, last_hidden=192, logvar_bias=-2.5)


def test_initial_kernels_have_the_variance_that_keeps_a_signal():
    params = initial(WIDE)["params"]
    fans = {"encoder_1": 320, "encoder_2": 256, "decoder_1": 128, "decoder_2": 192, "head_1": 320}
    for name, fan_in in fans.items():
        np.testing.assert_allclose(np.std(params[name]["kernel"]), math.sqrt(2 / fan_in), rtol=0.03)
        assert float(jnp.abs(params[name]["bias"]).max()) == 0.0


def test_the_initial_posterior_variance_is_small_and_almost_constant():
    _, logvar = encode(initial(WIDE), rows(500, 320), WIDE)
    assert abs(float(jnp.mean(logvar)) - WIDE.logvar_bias) < 0.05 and float(jnp.std(logvar)) < 0.3
    assert math.exp(0.5 * Architecture().logvar_bias) < 0.2
