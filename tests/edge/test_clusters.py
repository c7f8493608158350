"""Retrieval among clusters of like descriptors: against brute force, loops, itself in other ways, and FAISS."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.edge import brute_force, cluster_index, host_search, nearest, retrieve
from ovibjax.edge.clusters import ClusterIndex
from ovibjax.edge.kmeans import clusters_of_at_most, kmeans
from ovibjax.errors import InputError
from tests.oracles import edge as oracle

EVERY = 10**6


def clustered(seed, n=600, d=24, centres=30, spread=0.3):
    """Rows around centres, and queries beside some of them."""
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=(centres, d))
    db = centre[rng.integers(centres, size=n)] + spread * rng.normal(size=(n, d))
    query = db[rng.permutation(n)[:70]] + 0.5 * spread * rng.normal(size=(min(n, 70), d))
    return db.astype(np.float32), (3 * query).astype(np.float32)


def block_of(index):
    """[N] block of each row."""
    start, row = np.asarray(index.start), np.asarray(index.row)
    block = np.empty(start[-1], np.int64)
    block[row[: start[-1]]] = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return block


def agree(found, expected, db, query, k):
    """Similarities are the expected ones, rows have them, and no row comes twice."""
    rows, values, true = np.asarray(found.row), np.asarray(found.similarity), oracle.cosines(query, db)
    assert rows.shape == values.shape == (len(query), k) and rows.dtype == np.int32
    for q, wanted in enumerate(expected):
        n = len(wanted)
        assert np.all(rows[q, n:] == -1) and np.all(values[q, n:] == -np.inf)
        assert len(set(rows[q, :n])) == n and np.all(rows[q, :n] >= 0)
        np.testing.assert_allclose(values[q, :n], [similarity for _, similarity in wanted], atol=2e-6)
        np.testing.assert_allclose(true[q, rows[q, :n]], values[q, :n], atol=2e-6)


@pytest.fixture(scope="module")
def case():
    db, query = clustered(0)
    return db, query, cluster_index(db)


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 70),
    d=st.integers(1, 40),
    queries=st.integers(1, 9),
    k=st.integers(1, 6),
    probes=st.sampled_from([1, 2, 5, EVERY]),
    rows=st.sampled_from([1, 3, None]),
    twice=st.booleans(),
    seed=st.integers(0, 9),
)
def test_any_shape_equals_explicit_loops(n, d, queries, k, probes, rows, twice, seed):
    rng = np.random.default_rng(seed)
    db = rng.normal(size=(n, d)).astype(np.float32)
    db[rng.integers(n)] = 0.0
    if twice:
        db = db[rng.integers(max(1, n // 3), size=n)]
    query = np.concatenate([db, rng.normal(size=(queries, d))]).astype(np.float32)[-queries:]
    index = cluster_index(db, rows=rows)
    if probes < len(index.prototype):
        # Prototypes that are equal but for rounding may be kept in either order.
        score = np.sort(oracle.unit(query) @ np.asarray(index.prototype, np.float64).T, axis=1)[:, ::-1]
        apart = score[:, probes - 1] - score[:, probes] > 1e-6
        query = query[apart]
    expected = oracle.nearest(query, db, block_of(index), index.prototype, k, probes)
    agree(nearest(query, index, k, probes), expected, db, query, k)


def test_with_every_block_kept_it_is_brute_force(case):
    db, query, index = case
    np.testing.assert_array_equal(nearest(query, index, probes=EVERY).row[:, 0], brute_force(query, db))
    np.testing.assert_array_equal(nearest(db, index, probes=EVERY).row[:, 0], np.arange(len(db)))


def test_it_finds_more_than_its_share_of_the_rows(case):
    """Keeping two blocks of forty finds nearly all that a search of all would, as they follow likeness."""
    db, query, index = case
    exact = np.asarray(brute_force(query, db))
    assert len(index.prototype) > 30
    assert np.mean(nearest(query, index, probes=2).row[:, 0] == exact) > 0.9
    np.testing.assert_array_equal(retrieve(query, index), exact)


def test_compiled_mapped_and_on_the_host_it_is_the_same(case):
    db, query, index = case
    expected = nearest(query, index, 3, 2)
    compiled = jax.jit(nearest, static_argnames=("k", "probes"))(query, index, k=3, probes=2)
    np.testing.assert_array_equal(compiled.row, expected.row)
    np.testing.assert_allclose(compiled.similarity, expected.similarity, atol=1e-6)
    mapped = jax.vmap(lambda q: nearest(q, index, 3, 2).row)(jnp.asarray(query).reshape(7, 10, -1))
    np.testing.assert_array_equal(np.asarray(mapped).reshape(70, 3), expected.row)
    many = jax.jit(lambda q: nearest(q, index, len(db) + 2, EVERY).row)(query[:2])
    np.testing.assert_array_equal(np.sort(many[:, :-2]), np.tile(np.arange(len(db)), (2, 1)))
    assert np.all(np.asarray(many)[:, -2:] == -1)


def test_a_batch_is_its_queries_one_by_one(case, monkeypatch):
    _, query, index = case
    whole = nearest(query, index, 2, 3)
    for q in range(len(query)):
        one = nearest(query[q : q + 1], index, 2, 3)
        np.testing.assert_array_equal(one.row[0], whole.row[q])
        np.testing.assert_array_equal(one.similarity[0], whole.similarity[q])
    monkeypatch.setattr(host_search, "_BOUNDS", 1000)  # parts of some queries, in threads
    monkeypatch.setattr(host_search, "_EXACT_AT_ONCE", 7)
    for name, value in zip(whole._fields, nearest(query, index, 2, 3), strict=True):
        np.testing.assert_array_equal(value, getattr(whole, name))


@pytest.mark.parametrize("rank", [3, 31, 60])
def test_bounds_hold_and_change_no_answer(rank, monkeypatch):
    """Whether 32 directions hold all of the descriptors or little; whether whole blocks are read or rows."""
    rng = np.random.default_rng(rank)
    db, query = clustered(1, d=60)
    turn = np.linalg.qr(rng.normal(size=(60, rank)))[0] @ rng.normal(size=(rank, 60))
    db, query = (db @ turn).astype(np.float32), (query @ turn * 10.0 ** rng.uniform(-4, 4, (70, 1))).astype(np.float32)
    index = cluster_index(db)
    seen = []
    real = host_search._bounds

    def watched(unit, kept, score, visits, tables):
        bound = real(unit, kept, score, visits, tables)
        place = np.asarray(index.start)[kept][..., None] + np.arange(tables.most)
        there = place < np.asarray(index.start)[kept + 1][..., None]
        exact = np.einsum("qd,qnbd->qnb", unit, tables.descriptor[place])
        assert np.all(bound.reshape(exact.shape)[there] >= exact[there])
        assert np.all(bound.reshape(exact.shape)[~there] < host_search._EMPTY)
        seen.append(np.max((bound.reshape(exact.shape) - exact)[there]))
        return bound

    monkeypatch.setattr(host_search, "_bounds", watched)
    found = []
    for dense in (0.0, 2.0):
        monkeypatch.setattr(host_search, "_DENSE", dense)
        found.append(nearest(query, index, 3, 7))
    np.testing.assert_array_equal(found[0].row, found[1].row)
    np.testing.assert_array_equal(found[0].similarity, found[1].similarity)
    assert len(seen) == 2 and (rank > 32 or max(seen) < 0.02)  # tight where the basis holds all


def test_the_key_decides(case):
    db, _, index = case
    for one, other in zip(index, cluster_index(db, key=jax.random.key(0)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(index.row, cluster_index(db, key=jax.random.key(1)).row)


def test_blocks_stay_inside_of_tiles(case):
    db, query, _ = case
    tile = np.random.default_rng(0).choice([3, 7, -40, 900], size=len(db))  # numbers between them are empty tiles
    index = cluster_index(db, tile)
    block = block_of(index)
    assert all(len(set(tile[block == b])) == 1 for b in range(len(index.prototype)))
    assert sorted(np.asarray(index.row)[: len(db)]) == list(range(len(db)))
    assert np.max(np.diff(index.start)) <= index.sketch.shape[2] and np.min(np.diff(index.start)) > 0
    np.testing.assert_array_equal(nearest(query, index, probes=EVERY).row[:, 0], brute_force(query, db))


def test_clusters_are_never_larger_than_asked():
    rows = np.ones((50, 4), np.float32)
    rows[40:] = np.random.default_rng(0).normal(size=(10, 4))
    label = clusters_of_at_most(6, 4, rows, np.zeros(50, np.int64), np.random.default_rng(0))
    assert np.bincount(label).max() <= 6 and np.bincount(label).min() >= 1
    assert len(set(kmeans(np.ones((9, 2), np.float32), 4, np.random.default_rng(0)))) == 1


def test_kmeans_finds_clusters_that_are_apart():
    rng = np.random.default_rng(3)
    truth = np.repeat(np.arange(3), 40)
    rows = (np.eye(3)[truth] * 9 + 0.1 * rng.normal(size=(120, 3))).astype(np.float32)
    label = kmeans(rows, 12, rng)
    assert all(len(set(truth[label == cluster])) == 1 for cluster in set(label))


def test_what_is_no_number_has_no_answer(case):
    _, query, index = case
    broken = query[:3].copy()
    broken[1, 4] = np.nan
    found = nearest(broken, index)
    assert found.row[1, 0] == -1 and np.all(found.row[[0, 2]] >= 0)
    assert nearest(query[:0], index, 2).row.shape == (0, 2)


def test_bad_input_is_one_line(case, monkeypatch):
    db, query, index = case
    bad = db.copy()
    bad[7] = np.nan
    for arguments, word in (
        ((db[:0],), "at least 1"),
        ((db[0],), "expected"),
        ((bad,), "descriptor 7"),
        ((db, [1, 2]), "one per descriptor"),
        ((db, None, None, 0), "at least 1"),
        ((db, None, None, None, "annoy"), "ovibjax and faiss"),
    ):
        with pytest.raises(InputError, match=word):
            cluster_index(*arguments)
    with pytest.raises(InputError, match="24"):
        nearest(query[:, :5], index)
    with pytest.raises(ValueError, match="at least one"):
        nearest(query, index, 0)
    monkeypatch.setitem(__import__("sys").modules, "faiss", None)
    with pytest.raises(InputError, match=r"pip install"):
        cluster_index(db, engine="faiss")


@pytest.mark.parametrize("probes", [1, 4, EVERY])
def test_faiss_answers_the_same(case, probes):
    pytest.importorskip("faiss")
    db, query, index = case
    lists = cluster_index(db, engine="faiss")
    assert isinstance(index, ClusterIndex)
    for k in (1, 5, 40):
        ours, theirs = nearest(query, index, k, probes), nearest(query, lists, k, probes)
        np.testing.assert_array_equal(theirs.row, ours.row)
        np.testing.assert_allclose(theirs.similarity, ours.similarity, atol=2e-6)
    np.testing.assert_array_equal(retrieve(query, lists), retrieve(query, index))
    assert nearest(query[:0], lists, 2).row.shape == (0, 2)
