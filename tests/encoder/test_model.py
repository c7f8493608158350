"""The network against an independent NumPy forward pass, and the promises of its parts."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.encoder import model
from ovibjax.encoder.model import (
    OVIB,
    Architecture,
    dense_layers,
    init,
    mean_projection,
    parameter_bytes,
    split_views,
)
from tests.encoder.cases import QUICK, UAV, UGV, make_params, shapes_of
from tests.oracles import encoder as oracle

encode, decode, locate = (jax.jit(f, static_argnames="arch") for f in (model.encode, model.decode, model.locate))


def rows(n, width, seed=1):
    return np.random.default_rng(seed).normal(size=(n, width)).astype(np.float32)


LINEAR, COMPLETING = (dataclasses.replace(UAV, kind=kind, rank=11) for kind in ("linear", "completing"))
KINDS = [UAV, UGV, LINEAR, COMPLETING, dataclasses.replace(COMPLETING, wave="gelu")]


@pytest.mark.parametrize("arch", KINDS)
def test_every_part_equals_the_numpy_forward_pass(arch):
    params, width = make_params(arch), arch.n_views * arch.view_dim
    x, z, descriptor = rows(9, width, 1), rows(9, arch.latent, 2), rows(9, width, 3)
    mu, logvar = encode(params, x, arch)
    assert mu.shape == logvar.shape == (9, arch.latent)
    theirs = oracle.encode(params, x)
    np.testing.assert_allclose(mu, theirs[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(logvar, theirs[1], rtol=1e-4, atol=1e-5)
    kept = jnp.asarray(np.arange(arch.latent) < 5, jnp.float32)
    decoded = decode(params, z, kept, arch)
    assert decoded.shape == (9, width)
    wave = {"sine": np.sin, "gelu": oracle.gelu}[arch.wave]
    np.testing.assert_allclose(decoded, oracle.decode(params, z, sent=5, wave=wave), rtol=1e-4, atol=1e-5)
    position = locate(params, descriptor, arch)
    assert position.shape == (9, 3)
    np.testing.assert_allclose(position, oracle.locate(params, descriptor), rtol=1e-4, atol=1e-5)


def test_the_whole_chain_is_its_parts_without_noise():
    params, x = make_params(UAV), rows(4, 30)
    position = jax.jit(OVIB(UAV).apply)(params, split_views(x, UAV))
    theirs = oracle.decode(params, oracle.encode(params, x)[0])
    np.testing.assert_allclose(position, oracle.locate(params, theirs), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("arch", KINDS[:4])
def test_the_dense_layers_hold_the_kernels_of_the_views_in_feature_order(arch):
    params, r = make_params(arch), arch.view_dim
    tree, layers = params["params"], dense_layers(params)
    # Every parameter, and nothing else, is in the dense layers.
    values = [np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(t)]) for t in (tree, layers)]
    np.testing.assert_array_equal(*map(np.sort, values))
    for view in range(arch.n_views):
        block = slice(view * r, (view + 1) * r)
        for name in ("encoder_1", "head_1"):
            np.testing.assert_array_equal(layers[name]["kernel"][block], tree[f"{name}_{view}"]["kernel"])
        for name in {"descriptor", "principal"} & set(layers):
            np.testing.assert_array_equal(layers[name]["kernel"][:, block], tree[f"{name}_{view}"]["kernel"])
        if "descriptor" in layers:
            np.testing.assert_array_equal(layers["descriptor"]["bias"][block], tree[f"descriptor_{view}"]["bias"])
    for name in ("encoder_1", "head_1"):
        np.testing.assert_array_equal(layers[name]["bias"], tree[f"{name}_bias"])
        width = arch.hidden if name == "encoder_1" else arch.head
        assert layers[name]["kernel"].shape == (arch.n_views * r, width)


def test_views_are_split_in_feature_order_and_cut_to_their_rows():
    x = rows(6, 30)
    whole, cut = split_views(x, UAV), split_views(x, UAV, (6, 2, 0, 5, 1))
    assert [part.shape for part in cut] == [(6, 6), (2, 6), (0, 6), (5, 6), (1, 6)]
    for view, (part, head) in enumerate(zip(whole, cut, strict=True)):
        np.testing.assert_array_equal(part, x[:, 6 * view : 6 * view + 6])
        np.testing.assert_array_equal(head, part[: len(head)])
    joint = x.reshape(6, 5, 6)
    for part, other in zip(split_views(joint, UAV), whole, strict=True):
        np.testing.assert_array_equal(part, other)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_rows_a_view_lacks_count_as_zeros(precision):
    counts, network = (6, 2, 0, 5, 1), OVIB(UAV, precision)
    masks = [(np.arange(6)[:, None] < count).astype(np.float32) for count in counts]

    @functools.partial(jax.jit, compiler_options=QUICK)
    def parts(params, x, z):
        cut, whole = split_views(x, UAV, counts), split_views(x, UAV)
        zeroed = [part * mask for part, mask in zip(whole, masks, strict=True)]
        joint = [
            [network.apply(params, views, method=part) for part in ("encode", "locate")] for views in (cut, zeroed)
        ]
        return [jax.tree.leaves(parts) for parts in joint], [
            network.apply(params, z, jnp.ones_like(z), rows, method="decode") for rows in (counts, (6,) * 5)
        ]

    joint, (cut, whole) = parts(make_params(UAV), rows(6, 30), rows(6, UAV.latent))
    for ours, theirs in zip(*joint, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)
    for count, ours, theirs in zip(counts, cut, whole, strict=True):
        assert ours.shape == (count, UAV.view_dim)
        np.testing.assert_allclose(ours, theirs[:count], rtol=1e-5, atol=1e-6)


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


@pytest.mark.parametrize("arch", [UAV, UGV, Architecture(kind="dense")])
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
    return jax.jit(init, static_argnums=1, compiler_options=QUICK)(jax.random.key(1), arch)


WIDE = Architecture(hidden=256, last_hidden=192, logvar_bias=-2.5, kind="dense")


def test_initial_kernels_have_the_variance_that_keeps_a_signal():
    tree, layers = initial(WIDE)["params"], dense_layers(initial(WIDE))
    fans = {"encoder_2": 256, "decoder_1": 128, "decoder_2": 192}
    kernels = [(tree[name]["kernel"], 2 / fan_in) for name, fan_in in fans.items()]
    # A kernel of one view is initialised for the inputs of all five, r = 64 each.
    kernels += [(tree[f"{name}_{view}"]["kernel"], 2 / 320) for name in ("encoder_1", "head_1") for view in range(5)]
    kernels += [(layers[name]["kernel"], 2 / 320) for name in ("encoder_1", "head_1")]
    for kernel, variance in kernels:
        np.testing.assert_allclose(np.std(kernel), math.sqrt(variance), rtol=0.03)
        # He's normal distribution, cut at two deviations of the uncut one (0.8796 of them remain).
        assert 2.1 < np.abs(kernel).max() / math.sqrt(variance) < 2 / 0.8796 + 1e-3
    # Linear layers keep the variance; the views of a joint layer are drawn apart.
    for name, fan_in in {"mean": 192, "descriptor": 256, "head_2": 192}.items():
        np.testing.assert_allclose(np.std(layers[name]["kernel"]), math.sqrt(1 / fan_in), rtol=0.06)
    for name in ("encoder_1", "head_1", "descriptor"):
        assert len({float(tree[f"{name}_{view}"]["kernel"][0, 0]) for view in range(5)}) == 5
    assert all(float(jnp.abs(layer["bias"]).max()) == 0.0 for name, layer in layers.items() if name != "logvar")


def test_the_initial_posterior_variance_is_small_and_almost_constant():
    _, logvar = encode(initial(WIDE), rows(500, 320), WIDE)
    assert abs(float(jnp.mean(logvar)) - WIDE.logvar_bias) < 0.05 and float(jnp.std(logvar)) < 0.3
    assert math.exp(0.5 * Architecture().logvar_bias) < 0.2
