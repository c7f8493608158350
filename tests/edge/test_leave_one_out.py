"""Leave-one-out retrieval against a loop over the other rows."""

import jax
import numpy as np
import pytest

from ovibjax.edge import retrieval as module
from tests.oracles import control as oracle

leave_one_out = jax.jit(module.leave_one_out)


def rows(n, d, seed):
    return np.random.default_rng(seed).normal(size=(n, d)).astype(np.float32)


@pytest.mark.parametrize("n", [2, 3, 40])
def test_equals_the_oracle(n):
    reference = rows(n, 6, 0) * np.exp(np.random.default_rng(1).normal(size=(n, 1))).astype(np.float32)
    # Rows of the database themselves, and frames that are not in it.
    query, own = np.concatenate([reference, rows(25, 6, 2)]), np.r_[np.arange(n), np.full(25, -1)].astype(np.int32)
    found = np.asarray(leave_one_out(query, reference, own))
    assert found.dtype == np.int32
    np.testing.assert_array_equal(found, oracle.most_similar_other(query, reference, own))
    assert np.all(found[:n] != np.arange(n))
    np.testing.assert_array_equal(leave_one_out(reference, reference, np.full(n, -1, np.int32)), np.arange(n))


def test_equal_similarities_go_to_the_lower_row_that_is_not_the_query():
    # Numbers that float32 holds exactly: unit vectors along the axes.
    reference = np.eye(4, dtype=np.float32)[[0, 1, 0, 2, 0, 3]]
    own = np.arange(6, dtype=np.int32)
    found = np.asarray(leave_one_out(reference, reference, own))
    np.testing.assert_array_equal(found, [2, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(found, oracle.most_similar_other(reference, reference, own))
    np.testing.assert_array_equal(leave_one_out(reference, reference, np.full(6, -1, np.int32)), [0, 1, 0, 3, 0, 5])


def test_a_null_descriptor_and_a_null_reference():
    reference = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    query = np.array([[0, 0], [-1, 0], [0, 2]], np.float32)
    own = np.array([0, -1, 2], np.int32)
    found = np.asarray(leave_one_out(query, reference, own))
    np.testing.assert_array_equal(found, oracle.most_similar_other(query, reference, own))


def test_blocks_do_not_show():
    reference = rows(31, 5, 3)
    query = rows(2 * module._OWN_BLOCK + 3, 5, 4)
    own = np.random.default_rng(5).integers(-1, 31, len(query)).astype(np.int32)
    whole = np.asarray(leave_one_out(query, reference, own))
    some = [0, module._OWN_BLOCK - 1, module._OWN_BLOCK, len(query) - 1]
    np.testing.assert_array_equal(whole[some], oracle.most_similar_other(query[some], reference, own[some]))
    assert np.all(whole != own)
