"""Products in bfloat16 against float64 NumPy on rounded operands, and the programs XLA makes of them."""

import dataclasses
import functools
import re

import jax
import jax.numpy as jnp
import ml_dtypes
import numpy as np
import pytest
from jax import lax

from ovibjax.encoder.loss import Batch, composite_loss, make_hypers
from ovibjax.encoder.model import Architecture, init
from ovibjax.encoder.train import TrainConfig, view_rows
from ovibjax.runtime.precision import PRECISIONS, dot_general
from tests.runtime.cases import QUICK

DIMENSIONS = (((1,), (0,)), ((), ()))
# Where a processor multiplies in float32, XLA may leave out the rounding of an operand: "excess precision".
EXACT = {**QUICK, "xla_allow_excess_precision": False}


def product(x, kernel):
    return dot_general("bfloat16")(x, kernel, DIMENSIONS, precision=None)


def with_gradients(x, kernel, g):
    """The product and the gradients of its inner product with g."""
    out, backward = jax.vjp(product, x, kernel)
    return out, *backward(g)


with_gradients_jit = jax.jit(with_gradients, compiler_options=EXACT)


def rounded(x):
    """Nearest bfloat16, as float64."""
    return x.astype(ml_dtypes.bfloat16).astype(np.float64)


def numpy_with_gradients(x, kernel, g):
    """Each result with the sum of magnitudes that bounds its rounding."""
    x, kernel, g = map(rounded, (x, kernel, g))
    pairs = [(x, kernel), (g, kernel.T), (x.T, g)]
    return [(a @ b, np.abs(a) @ np.abs(b)) for a, b in pairs]


def operands(batch, inputs, outputs, seed=0):
    rng = np.random.default_rng(seed)
    shapes = [(batch, inputs), (inputs, outputs), (batch, outputs)]
    return [rng.normal(size=shape).astype(np.float32) for shape in shapes]


def assert_rounded_product(ours, arrays):
    for out, (expected, magnitude) in zip(ours, numpy_with_gradients(*arrays), strict=True):
        assert out.dtype == jnp.float32 and out.shape == expected.shape
        assert np.all(np.abs(np.asarray(out, np.float64) - expected) <= 1e-5 * magnitude)


# Whole blocks, parts of blocks in one dimension or in all, single rows, no rows.
SHAPES = [(32, 64, 48), (16, 16, 16), (32, 64, 7), (32, 10, 48), (7, 64, 48), (5, 3, 17), (1, 64, 16), (0, 64, 16)]


@pytest.mark.parametrize("shape", SHAPES)
def test_product_and_gradients_are_those_of_the_rounded_operands(shape):
    arrays = operands(*shape)
    assert_rounded_product(with_gradients_jit(*arrays), arrays)


def test_a_product_in_float32_would_be_noticed():
    x, kernel, g = operands(32, 64, 48)
    exact = [a.astype(np.float64) @ b for a, b in ((x, kernel), (g, kernel.T), (x.T, g))]
    for value, (expected, magnitude) in zip(exact, numpy_with_gradients(x, kernel, g), strict=True):
        assert np.mean(np.abs(value - expected) > 1e-5 * magnitude) > 0.9


def test_sums_are_kept_in_float32():
    # In bfloat16, 256 + 1 is 256: a sum of 1024 ones would end there.
    x, kernel = np.ones((2, 1024), np.float32), np.ones((1024, 3), np.float32)
    out, dx, dkernel = with_gradients_jit(x, kernel, np.full((2, 3), 1.0, np.float32))
    np.testing.assert_array_equal(out, 1024.0)
    np.testing.assert_array_equal(dx, 3.0)
    np.testing.assert_array_equal(dkernel, 2.0)
    _, _, dkernel = with_gradients_jit(x[:1].repeat(1024, 0), kernel, np.ones((1024, 3), np.float32))
    np.testing.assert_array_equal(dkernel, 1024.0)


@pytest.mark.parametrize("shape", [(16, 32, 48), (43, 32, 48), (32, 10, 48), (6, 5, 4)])
def test_members_are_mapped(shape):
    lanes = [operands(*shape, seed=seed) for seed in range(3)]
    stacked = [np.stack(leaves) for leaves in zip(*lanes, strict=True)]
    many = jax.jit(jax.vmap(with_gradients), compiler_options=EXACT)(*stacked)
    for i, arrays in enumerate(lanes):
        assert_rounded_product([out[i] for out in many], arrays)
    # Members share their first input.
    x = lanes[0][0]
    shared = jax.jit(jax.vmap(with_gradients, in_axes=(None, 0, 0)), compiler_options=EXACT)(x, *stacked[1:])
    for i, arrays in enumerate(lanes):
        assert_rounded_product([out[i] for out in shared], [x, *arrays[1:]])


@pytest.mark.parametrize("precision", ["", "bf16", "float16", "Float32", None])
def test_an_unknown_precision_is_an_error(precision):
    with pytest.raises(ValueError, match=r"float32.*bfloat16"):
        dot_general(precision)


def test_float32_is_the_product_of_jax():
    assert PRECISIONS == ("float32", "bfloat16")
    assert dot_general("float32") is lax.dot_general and dot_general("bfloat16") is not lax.dot_general


# ---- programs ----

ARCH = Architecture(n_views=5, view_dim=16, latent=32, hidden=64, last_hidden=48, head=32, kind="dense")
KINDS = {kind: dataclasses.replace(ARCH, kind=kind, rank=40) for kind in ("dense", "completing")}


@functools.cache
def lowered(precision, mapped=True, kind="dense"):
    """Loss and gradients of two members, or of one, on a batch of 128, as in training; nothing is executed."""
    arch = KINDS[kind]
    rows = view_rows(TrainConfig(arch=arch), 128)[1]

    def shape(*sizes):
        return jax.ShapeDtypeStruct(sizes, jnp.float32)

    def members(tree):
        return jax.tree.map(lambda leaf: shape(2, *leaf.shape), tree)

    params = jax.eval_shape(functools.partial(init, arch=arch), jax.random.key(0))
    latent = shape(128, ARCH.latent)
    batch = Batch(shape(128, 5, ARCH.view_dim), shape(128, 3), shape(128, 5), latent, latent)

    def loss(params, batch, hypers):
        return composite_loss(params, batch, hypers, arch, "gaussian", rows, precision)

    function, hypers = jax.value_and_grad(loss, has_aux=True), jax.eval_shape(make_hypers)
    if not mapped:
        return jax.jit(function).lower(params, batch, hypers)
    return jax.jit(jax.vmap(function, in_axes=(0, None, 0))).lower(members(params), batch, members(hypers))


# One product a layer forwards, one backwards for the kernel and one for the input, which the first layer lacks:
# 15 products of views and 5 others in the network; the position's layer and the penalty, forwards and backwards,
# stay in float32. The linear paths add five products of views and their kernels', and the completion; the width of the
# posterior has no part in the gradient of what it is computed from.
NETWORK, OTHERS = {"dense": 3 * 20 - 5, "completing": 3 * 20 - 5 + 2 * 5 + 3 - 1}, 3 + 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_all_products_of_the_network_and_no_others_have_bfloat16_operands(precision, kind):
    pattern = r"stablehlo\.dot_general.*: \(tensor<[\dx]*x(\w+)>, tensor<[\dx]*x(\w+)>\) -> tensor<[\dx]*x(\w+)>"
    types = re.findall(pattern, lowered(precision, kind=kind).as_text())
    assert {result for _, _, result in types} == {"f32"} and all(a == b for a, b, _ in types)
    in_bfloat16 = sum(a == "bf16" for a, _, _ in types)
    assert (in_bfloat16, len(types)) == (NETWORK[kind] if precision == "bfloat16" else 0, NETWORK[kind] + OTHERS)


def compiled_products(text):
    """Operand types and contracted dimension (first, last) of both operands, and origin, of XLA's every product."""
    types, products = {}, []
    for line in text.splitlines():
        if match := re.match(r"\s*(?:ROOT )?%?(\S+) = (\w+)\[([\d,]*)\]", line):
            types[match[1]] = match[2], len(match[3].split(","))
    for line in text.splitlines():
        if match := re.search(r" dot\(([^)]*)\)", line):
            names = re.findall(r"%([\w.\-]+)", match[1])
            contracted = [int(re.search(rf"{side}_contracting_dims={{(\d+)}}", line)[1]) for side in ("lhs", "rhs")]
            ends = ["last" if d == types[n][1] - 1 else "first" for d, n in zip(contracted, names, strict=True)]
            products.append(([types[name][0] for name in names], ends, re.search('op_name="([^"]*)"', line)[1]))
    return products


@pytest.mark.skipif(
    jax.__version_info__ >= (0, 11), reason="what XLA makes of a product, and how it prints it, is known up to jax 0.10"
)
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="about programs for CPUs")
@pytest.mark.parametrize("mapped", [False, True])
def test_the_compiled_program_multiplies_in_bfloat16_without_transposed_first_operands(mapped):
    products = compiled_products(lowered("bfloat16", mapped).compile().as_text())
    ends_in_bfloat16 = [ends for types, ends, _ in products if types == ["bf16", "bf16"]]
    # No product was raised to float32; some of the views' were joined at most.
    assert NETWORK["dense"] - 15 <= len(ends_in_bfloat16) <= NETWORK["dense"]
    in_float32 = [origin for types, _, origin in products if types != ["bf16", "bf16"]]
    layers = [origin for origin in in_float32 if "OVIB" in origin and origin.endswith("dot_general")]
    raised = [origin for origin in layers if "head_2" not in origin]
    # The shared first layer gives members an activation in another order of dimensions, which XLA raises to float32
    # for the next product, one of 55.
    known = "jvp(OVIB.encode)" in raised[0] and "encoder_2" in raised[0] if mapped and raised else not raised
    assert known and len(raised) <= 1 and not any("transpose" in origin for origin in raised), raised
    # A product over the first dimension of both, as of a folded transpose, is three times slower.
    assert ["first", "first"] not in ends_in_bfloat16
