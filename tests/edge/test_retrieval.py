"""Exhaustive cosine retrieval against a float64 argmax."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ovibjax.edge import retrieval
from tests.oracles import edge as oracle

brute_force, normalize = jax.jit(retrieval.brute_force), jax.jit(retrieval.normalize)
small_integers = st.integers(-3, 3).map(np.float32)


def random_rows(n, d, seed):
    return np.random.default_rng(seed).normal(size=(n, d)).astype(np.float32)


def assert_most_similar(out, query, db, tolerance=2e-6):
    """Every answer is a most similar row to rounding, and exactly the oracle's where the best one is clear."""
    similarity = oracle.cosines(query, db)
    out = np.asarray(out)
    assert out.dtype == np.int32 and out.shape == (len(query),)
    assert np.all((out >= 0) & (out < len(db)))
    chosen = similarity[np.arange(len(out)), out]
    assert np.all(chosen >= similarity.max(axis=1) - tolerance)
    if len(db) > 1:
        clear = np.diff(np.partition(similarity, -2, axis=1)[:, -2:], axis=1)[:, 0] > tolerance
        np.testing.assert_array_equal(out[clear], oracle.retrieve(query, db)[clear])
        return clear.mean()
    return 1.0


@pytest.mark.parametrize(("q", "n", "d"), [(1, 1, 4), (40, 75, 1), (40, 75, 2), (33, 101, 16), (20, 300, 640)])
def test_brute_force_equals_the_oracle(q, n, d):
    query, db = random_rows(q, d, 0), random_rows(n, d, 1)
    db *= np.exp(np.random.default_rng(2).uniform(-3, 3, (n, 1))).astype(np.float32)
    share = assert_most_similar(brute_force(query, db), query, db)
    # In one dimension every row of a sign ties.
    assert share > 0.95 or d == 1


def test_a_row_finds_itself():
    db = random_rows(200, 12, 3)
    np.testing.assert_array_equal(brute_force(db, db), np.arange(200))
    np.testing.assert_array_equal(brute_force(db[::-1].copy() * 7, db), np.arange(200)[::-1])
    # The inner product alone would send everything to the longest row.
    longest = db.copy()
    longest[17] *= 1000
    np.testing.assert_array_equal(brute_force(db, longest), np.arange(200))


@settings(deadline=None, max_examples=50)
@given(arrays(np.float32, (5, 4), elements=small_integers), arrays(np.float32, (8, 4), elements=small_integers))
def test_brute_force_on_rows_with_many_ties_and_zeros(query, db):
    assert_most_similar(brute_force(query, db), query, db)


@settings(deadline=None, max_examples=40)
@given(
    arrays(np.float32, (6,), elements=st.floats(2.0**-20, 2.0**20, width=32)),
    arrays(np.float32, (30,), elements=st.floats(2.0**-20, 2.0**20, width=32)),
)
def test_scale_does_not_matter(query_scale, db_scale):
    query, db = random_rows(6, 8, 4), random_rows(30, 8, 5)
    expected = oracle.retrieve(query, db)
    np.testing.assert_array_equal(brute_force(query * query_scale[:, None], db * db_scale[:, None]), expected)


def signs(d):
    """All 2^d rows of +-1, shuffled; at d = 4 their unit norm and their products with integers are exact."""
    rows = np.float32(np.unravel_index(np.arange(2**d), (2,) * d)).T * 2 - 1
    return np.random.default_rng(d).permutation(rows)


def test_exact_ties_go_to_the_lower_index():
    db = signs(4)
    order = np.random.default_rng(7).permutation(16)
    # Each row stands there three times, the last one at another power of two.
    tripled = np.concatenate([db, db[order], db[order] * 4])
    np.testing.assert_array_equal(brute_force(db, tripled), np.arange(16))
    np.testing.assert_array_equal(brute_force(db, tripled[::-1].copy()), 15 - np.argsort(order))
    axes = np.eye(3, dtype=np.float32)
    np.testing.assert_array_equal(brute_force(np.ones((1, 3), np.float32), axes), [0])
    np.testing.assert_array_equal(brute_force(axes, np.concatenate([axes[::-1], axes])), [2, 1, 0])


def test_a_zero_row_is_similar_to_nothing_and_a_zero_query_to_all_alike():
    db = np.float32([[-1, 0], [0, 0], [-1, -1], [0, 0]])
    query = np.float32([[1, 0], [-1, 0], [0, 0]])
    np.testing.assert_array_equal(brute_force(query, db), [1, 0, 0])
    np.testing.assert_array_equal(brute_force(query, np.zeros((3, 2), np.float32)), [0, 0, 0])


@pytest.mark.parametrize("q", [8192, 8193, 20001])
def test_long_lists_of_queries_go_in_blocks_with_the_same_answers(q):
    query, db = random_rows(q, 3, 8), random_rows(24, 3, 9)
    query[[0, 8191, -1]] = 0.0
    out = np.asarray(brute_force(query, db))
    assert assert_most_similar(out, query, db) > 0.99
    np.testing.assert_array_equal(out[[0, 8191, -1]], [0, 0, 0])


def test_ties_in_long_lists_of_queries_go_to_the_lower_index():
    query = np.random.default_rng(10).integers(-2, 3, (8200, 4)).astype(np.float32)
    db = np.concatenate([signs(4), signs(4)])
    expected = (query @ db.T).argmax(axis=1)
    assert np.sum((query @ db.T) == (query @ db.T).max(axis=1, keepdims=True)) > 3 * 8200
    np.testing.assert_array_equal(brute_force(query, db), expected)
    np.testing.assert_array_equal(brute_force(query[:100], db), expected[:100])


def test_brute_force_maps_and_compiles():
    query, db = random_rows(2 * 15, 6, 10).reshape(2, 15, 6), random_rows(2 * 40, 6, 11).reshape(2, 40, 6)
    together = jax.jit(jax.vmap(brute_force))(query, db)
    for lane in range(2):
        np.testing.assert_array_equal(together[lane], brute_force(query[lane], db[lane]))


def test_normalize_gives_unit_rows_and_keeps_zero_rows():
    rows = random_rows(4 * 5, 7, 12).reshape(4, 5, 7) * 100
    rows[1, 2] = 0.0
    out = np.asarray(normalize(jnp.array(rows)))
    lengths = np.linalg.norm(out, axis=-1)
    assert lengths[1, 2] == 0.0 and np.all(out[1, 2] == 0.0)
    lengths[1, 2] = 1.0
    np.testing.assert_allclose(lengths, 1.0, rtol=1e-6)
    np.testing.assert_allclose(out * np.linalg.norm(rows, axis=-1, keepdims=True), rows, rtol=1e-5, atol=1e-5)
