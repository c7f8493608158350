"""The orthogonality penalty and its gradient against NumPy, and what Proposition 1 promises of the singular values."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.encoder import orthogonality as module
from ovibjax.encoder.orthogonality import orthogonality_penalty
from tests.encoder.cases import member_of
from tests.oracles import encoder as oracle

singular_values = jax.jit(module.singular_values)


penalty = jax.jit(orthogonality_penalty)

penalty_grad = jax.jit(jax.grad(orthogonality_penalty))


def orthonormal_rows(size, width, seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(width, size)))
    return q.T


@pytest.mark.parametrize(("size", "width"), [(1, 1), (3, 3), (8, 12), (64, 256)])
def test_the_penalty_is_zero_for_orthonormal_rows(size, width):
    w = jnp.array(orthonormal_rows(size, width), jnp.float32)
    assert abs(float(penalty(w))) < 1e-12 * width
    # For rows of length c it is (c^2 - 1)^2 / K.
    np.testing.assert_allclose(penalty(1.5 * w), 1.25**2 / size, rtol=1e-5)


@pytest.mark.parametrize(("size", "width"), [(1, 5), (6, 4), (8, 12), (40, 64)])
@pytest.mark.parametrize("scale", [1e-2, 1.0, 30.0])
def test_the_penalty_equals_the_oracle(size, width, scale):
    w = (np.random.default_rng(size).normal(size=(size, width)) * scale).astype(np.float32)
    value = penalty(jnp.array(w))
    assert value.shape == () and value.dtype == jnp.float32
    np.testing.assert_allclose(value, oracle.orthogonality(w), rtol=2e-5)


def test_the_penalty_is_normalised_by_the_square_of_k():
    for size in (2, 8):
        # ||0 - I||_F^2 = K; all rows equal and of unit length: ||1 1^T - I||_F^2 = K^2 - K.
        np.testing.assert_allclose(penalty(np.zeros((size, 12), np.float32)), 1 / size, rtol=1e-6)
        row = np.eye(12, dtype=np.float32)[[5] * size]
        np.testing.assert_allclose(penalty(row), (size**2 - size) / size**2, rtol=1e-6)


def test_the_gradient_of_the_penalty_is_its_closed_form():
    w = np.random.default_rng(1).normal(size=(6, 9)).astype(np.float32)
    exact = w.astype(np.float64)
    expected = 4 * (exact @ exact.T - np.eye(6)) @ exact / 36
    np.testing.assert_allclose(penalty_grad(jnp.array(w)), expected, rtol=1e-4, atol=1e-5)
    for w in (np.zeros((6, 9)), orthonormal_rows(6, 9)):
        grad = penalty_grad(jnp.array(w, jnp.float32))
        np.testing.assert_allclose(grad, 0.0, atol=1e-6)


def plain_penalty(w):
    """The formula, for automatic differentiation."""
    return jnp.sum((w @ w.T - jnp.eye(w.shape[0], dtype=w.dtype)) ** 2) / w.shape[0] ** 2


@pytest.mark.parametrize(("size", "width"), [(1, 5), (6, 4), (8, 12), (40, 64)])
@pytest.mark.parametrize("scale", [1e-2, 1.0, 30.0])
def test_the_gradient_of_the_penalty_equals_automatic_and_numerical_differentiation(size, width, scale):
    rng = np.random.default_rng(size)
    w = (rng.normal(size=(size, width)) * scale).astype(np.float32)
    grad = np.asarray(penalty_grad(jnp.array(w)), np.float64)
    automatic = jax.jit(jax.grad(plain_penalty))(jnp.array(w))
    np.testing.assert_allclose(grad, automatic, rtol=1e-4, atol=1e-5 * np.abs(grad).max())
    for _ in range(5):
        direction = rng.normal(size=w.shape)
        direction *= 1e-5 * scale / np.linalg.norm(direction)
        rise = oracle.orthogonality(w + direction) - oracle.orthogonality(w - direction)
        np.testing.assert_allclose((grad * 2 * direction).sum(), rise, rtol=1e-3, atol=1e-5 * abs(grad).max() * scale)


def test_the_gradient_of_the_penalty_follows_vmap_transposes_and_scale():
    kernels = jnp.array(np.random.default_rng(2).normal(size=(3, 12, 8)), jnp.float32)
    weights = jnp.array([2.0, -0.5, 0.0])

    def total(penalty):
        # As in training: the matrix is a transposed kernel, the penalty has a weight, members are mapped.
        members = jax.vmap(jax.value_and_grad(lambda kernel, weight: weight * penalty(kernel.T)))
        return jax.jit(members)(kernels, weights)

    ours, theirs = total(orthogonality_penalty), total(plain_penalty)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    assert ours[1].shape == (3, 12, 8) and np.abs(ours[1][:2]).max() > 0.1 and np.all(ours[1][2] == 0.0)
    for kernel, weight, grad in zip(kernels, weights, ours[1], strict=True):
        np.testing.assert_allclose(grad, weight * penalty_grad(kernel.T).T, rtol=1e-4, atol=1e-5)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.floats(1e-4, 0.05))
def test_proposition_1_bounds_the_singular_values(seed, spread):
    rng = np.random.default_rng(seed)
    w = (orthonormal_rows(12, 20, seed) + spread * rng.normal(size=(12, 20))).astype(np.float32)
    singular = np.linalg.svd(w.astype(np.float64), compute_uv=False)
    # ||Delta||_2 <= ||Delta||_F = K sqrt(penalty).
    spectral = np.linalg.norm(w.astype(np.float64) @ w.T - np.eye(12), 2)
    epsilon = 12 * float(penalty(jnp.array(w))) ** 0.5 * (1 + 1e-4) + 1e-6
    assert spectral <= epsilon
    for bound in [b for b in (spectral + 1e-9, epsilon) if b < 1]:
        assert np.all(singular >= np.sqrt(1 - bound)) and np.all(singular <= np.sqrt(1 + bound))


def test_a_penalty_below_k_to_the_minus_two_excludes_rank_collapse():
    rng = np.random.default_rng(5)
    for _ in range(20):
        w = orthonormal_rows(5, 9, int(rng.integers(1000)))
        w[4] = rng.normal(size=4) @ w[:4]
        assert float(penalty(jnp.array(w, jnp.float32))) >= (1 - 1e-5) / 25


@pytest.mark.parametrize(("size", "width"), [(1, 1), (5, 8), (32, 64), (16, 16)])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.01, 0.03])
def test_proposition_1_holds_near_row_orthonormality(size, width, noise):
    rng = np.random.default_rng(size)
    for _ in range(5):
        rows = np.linalg.qr(rng.normal(size=(width, size)))[0].T
        W = (rows + noise * rng.normal(size=rows.shape)).astype(np.float32)
        result = singular_values(jnp.asarray(W))
        exact = np.linalg.svd(W.astype(np.float64), compute_uv=False)
        epsilon = np.linalg.norm(W.astype(np.float64) @ W.T.astype(np.float64) - np.eye(size), 2)
        assert result.values.shape == (size,) and epsilon < 1
        np.testing.assert_allclose(result.values, exact, atol=1e-5)
        np.testing.assert_allclose(result.epsilon, epsilon, atol=1e-5)
        np.testing.assert_allclose(result.lower, math.sqrt(1 - epsilon), atol=1e-5)
        np.testing.assert_allclose(result.upper, math.sqrt(1 + epsilon), atol=1e-5)
        assert result.lower - 1e-5 <= result.values.min() and result.values.max() <= result.upper + 1e-5
        # One of the two bounds is attained: epsilon is the smallest that will do.
        assert min(result.values.min() - result.lower, result.upper - result.values.max()) < 1e-5
        assert np.linalg.matrix_rank(W) == size
        # The penalty of the loss controls epsilon through the Frobenius norm.
        assert float(result.epsilon) <= size * math.sqrt(float(orthogonality_penalty(jnp.asarray(W)))) + 1e-5


def test_proposition_1_does_not_apply_where_the_rank_collapses():
    rows = np.linalg.qr(np.random.default_rng(0).normal(size=(8, 4)))[0].T
    aligned, vanished = rows.copy(), rows.copy()
    aligned[1], vanished[2] = aligned[0], 0.0
    wide = np.linalg.qr(np.random.default_rng(1).normal(size=(6, 4)))[0]
    for W in (aligned, vanished, wide):
        result = singular_values(jnp.asarray(W, jnp.float32))
        assert result.values.shape == (len(W),)
        assert result.values[-1] < 1e-5 and result.epsilon >= 1 - 1e-5 and result.lower < 4e-3
        assert result.values.max() <= result.upper + 1e-5
    # More rows than columns: the last K - d_h values are zero.
    np.testing.assert_allclose(result.values, [1, 1, 1, 1, 0, 0], atol=1e-5)


def test_proposition_1_is_sufficient_and_not_necessary():
    # Far too long rows of full rank: epsilon >= 1, the lower bound says nothing, the upper one still holds.
    result = singular_values(2.0 * jnp.eye(3, 5))
    np.testing.assert_allclose([result.epsilon, result.lower, result.upper], [3.0, 0.0, 2.0], atol=1e-6)
    np.testing.assert_allclose(result.values, 2.0, atol=1e-6)


def test_singular_values_under_vmap_equal_a_loop():
    W = (np.random.default_rng(0).normal(size=(6, 5, 9)) / 3).astype(np.float32)
    together = jax.jit(jax.vmap(module.singular_values))(W)
    for i in range(6):
        for ours, theirs in zip(member_of(together, i), singular_values(W[i]), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-5)
