"""Leave-one-out retrieval and how distinct it is against a loop over the other rows."""

import jax
import numpy as np
import pytest

from ovibjax.edge import retrieval as module
from tests.oracles import control as oracle

_jitted = jax.jit(module.leave_one_out)


def places(n):
    """References along a line, a metre apart."""
    return np.stack([np.arange(n), np.zeros(n)], axis=1).astype(np.float32)


def leave_one_out(query, reference, own, elsewhere_m=2.5):
    """Rows of the jitted function, as distinct as the oracle says."""
    found = _jitted(query, reference, own, places(len(reference)), elsewhere_m)
    want = most_similar_other(query, reference, own, elsewhere_m)[1]
    np.testing.assert_allclose(found.distinctness, want, atol=2e-5)
    return np.asarray(found.row)


def most_similar_other(query, reference, own, elsewhere_m=2.5):
    return oracle.most_similar_other(query, reference, own, places(len(reference)), elsewhere_m)


def rows(n, d, seed):
    return np.random.default_rng(seed).normal(size=(n, d)).astype(np.float32)


@pytest.mark.parametrize("n", [2, 3, 40])
def test_equals_the_oracle(n):
    reference = rows(n, 6, 0) * np.exp(np.random.default_rng(1).normal(size=(n, 1))).astype(np.float32)
    # Rows of the database themselves, and frames that are not in it.
    query, own = np.concatenate([reference, rows(25, 6, 2)]), np.r_[np.arange(n), np.full(25, -1)].astype(np.int32)
    found = np.asarray(leave_one_out(query, reference, own))
    assert found.dtype == np.int32
    np.testing.assert_array_equal(found, most_similar_other(query, reference, own)[0])
    assert np.all(found[:n] != np.arange(n))
    np.testing.assert_array_equal(leave_one_out(reference, reference, np.full(n, -1, np.int32)), np.arange(n))


def test_equal_similarities_go_to_the_lower_row_that_is_not_the_query():
    # Numbers that float32 holds exactly: unit vectors along the axes.
    reference = np.eye(4, dtype=np.float32)[[0, 1, 0, 2, 0, 3]]
    own = np.arange(6, dtype=np.int32)
    found = np.asarray(leave_one_out(reference, reference, own))
    np.testing.assert_array_equal(found, [2, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(found, most_similar_other(reference, reference, own)[0])
    np.testing.assert_array_equal(leave_one_out(reference, reference, np.full(6, -1, np.int32)), [0, 1, 0, 3, 0, 5])


def test_a_null_descriptor_and_a_null_reference():
    reference = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    query = np.array([[0, 0], [-1, 0], [0, 2]], np.float32)
    own = np.array([0, -1, 2], np.int32)
    found = np.asarray(leave_one_out(query, reference, own))
    np.testing.assert_array_equal(found, most_similar_other(query, reference, own)[0])


def test_blocks_do_not_show():
    reference = rows(31, 5, 3)
    query = rows(2 * module._OWN_BLOCK + 3, 5, 4)
    own = np.random.default_rng(5).integers(-1, 31, len(query)).astype(np.int32)
    whole = np.asarray(_jitted(query, reference, own, places(31), 2.5).row)
    some = [0, module._OWN_BLOCK - 1, module._OWN_BLOCK, len(query) - 1]
    np.testing.assert_array_equal(whole[some], most_similar_other(query[some], reference, own[some])[0])
    assert np.all(whole != own)


def test_distinctness_is_a_ratio_to_the_best_match_in_another_place():
    reference = np.array([[1, 0], [0.8, 0.6], [0, 1]], np.float32)
    query, own = np.array([[0.96, 0.28]], np.float32), np.array([-1], np.int32)
    near = 1 - 0.96
    for elsewhere_m, rival in ((0.5, 0.96 * 0.8 + 0.28 * 0.6), (1.5, 0.28), (9.0, -1.0)):
        found = _jitted(query, reference, own, places(3), elsewhere_m)
        assert found.row == 0 and found.distinctness[0] == pytest.approx(1 - near / (1 - rival), abs=1e-5)
    # The same frame in two places: nothing tells them apart.
    twice = np.array([[1, 0], [0, 1], [1, 0]], np.float32)
    assert _jitted(twice[:1], twice, own, places(3), 1.5).distinctness[0] == pytest.approx(0.0, abs=1e-6)
