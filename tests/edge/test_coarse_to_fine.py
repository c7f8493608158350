"""Coarse-to-fine retrieval against brute force and against explicit loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.edge import index as index_module
from ovibjax.edge import retrieval, tile_search
from ovibjax.edge.pruning import Asked, judge_pruning
from ovibjax.edge.retrieval import build_index, coarse_to_fine, retrieve, search
from ovibjax.errors import InputError
from ovibjax.world.town.feature_set import town_features
from ovibjax.world.town.layout import TownConfig
from tests.oracles import edge as oracle

brute_force = jax.jit(retrieval.brute_force)
EVERY = 10**6


def clustered(seed, n=400, d=16, n_scenes=4):
    """Rows along wandering paths, one per scene, so that neighbours in space are neighbours in description."""
    rng = np.random.default_rng(seed)
    scene = np.sort(rng.integers(n_scenes, size=n)).astype(np.int32)
    position = np.cumsum(rng.normal(size=(n, 2)), axis=0)
    centre = rng.normal(size=(n_scenes, d))[scene]
    db = centre + 0.4 * np.cumsum(rng.normal(size=(n, d)), axis=0) / np.sqrt(n) + 0.1 * rng.normal(size=(n, d))
    order = rng.permutation(n)
    return db[order].astype(np.float32), position[order], scene[order]


@pytest.fixture(scope="module")
def case():
    db, position, scene = clustered(0)
    query = (db[:64] + 0.3 * np.random.default_rng(1).normal(size=(64, db.shape[1]))).astype(np.float32)
    return query, db, position, scene, build_index(db, position, scene, 3.0)


def all_but_padding(index):
    """Number of tiles that keeps all real ones but is not the whole table."""
    return int((index.tile_scene >= 0).sum())


def test_with_everything_kept_it_is_brute_force(case):
    query, db, _, scene, index = case
    expected = np.asarray(brute_force(query, db))
    for tiles in (EVERY, all_but_padding(index)):
        found = search(query, index, scenes=len(set(scene)), tiles=tiles)
        np.testing.assert_array_equal(found.row, expected)
        assert found.row.dtype == jnp.int32 and np.all(np.asarray(found.searched) == len(db))


@pytest.mark.parametrize("rank", [4, 31, 33, 90])
def test_the_sketch_changes_no_answer(monkeypatch, rank):
    """With a bound that never rules anything out every kept descriptor is read."""
    monkeypatch.setattr(tile_search, "_TILES_AT_ONCE", 7)
    rng = np.random.default_rng(rank)
    db, position, scene = clustered(7, d=90)  # equal tiles, hence shapes, for every rank
    db = (db @ np.linalg.qr(rng.normal(size=(90, rank)))[0] @ rng.normal(size=(rank, 90))).astype(np.float32)
    query = np.concatenate([db[::7], db[::5] + 0.1 * rng.normal(size=(80, 90)), rng.normal(size=(20, 90))])
    query = (query * 10.0 ** rng.uniform(-4, 4, (len(query), 1))).astype(np.float32)
    index = build_index(db, position, scene, 2.0)
    blind = index._replace(sketch=jnp.zeros_like(index.sketch).at[:, -1].set(1e6))
    for tiles in (5, EVERY):
        np.testing.assert_array_equal(search(query, index, 3, tiles).row, search(query, blind, 3, tiles).row)
    # And it does bound: nothing is more similar than the sketch says.
    unit = np.asarray(index.descriptor)[: len(db)]
    one = query / np.linalg.norm(query, axis=1, keepdims=True)
    leading = one @ np.asarray(index.basis)
    rest = np.sqrt(np.maximum(1 - np.sum(leading**2, axis=1, keepdims=True), 0) + 4e-6)
    bound = np.concatenate([leading, rest], axis=1) @ np.asarray(index.sketch)[: len(db)].T
    assert np.all(one @ unit.T <= bound + 2e-5)
    assert rank > 32 or np.max((bound - one @ unit.T)[: len(db[::7])]) < 1e-2  # and tightly, where it holds all


def test_a_query_equal_to_a_reference_finds_it_when_its_tile_is_kept(case):
    _, db, _, _, index = case
    found = search(db, index, 4, EVERY)
    np.testing.assert_array_equal(found.row, np.arange(len(db)))
    pruned = search(db, index, 2, 3)
    kept = (np.asarray(pruned.tiles) == np.asarray(index.row_tile)[:, None]).any(axis=1)
    assert kept.mean() > 0.3
    np.testing.assert_array_equal(np.asarray(pruned.row)[kept], np.arange(len(db))[kept])


@pytest.mark.parametrize(("scenes", "tiles"), [(1, 1), (2, 12), (3, 5), (2, 200)])
def test_pruning_equals_explicit_loops(case, scenes, tiles):
    query, db, _, scene, index = case
    rows, kept_scenes, kept_tiles = oracle.coarse_to_fine(query, db, np.asarray(index.row_tile), scene, scenes, tiles)
    found = search(query, index, scenes, tiles)
    np.testing.assert_array_equal(found.scenes, kept_scenes)
    for ours, theirs in zip(np.asarray(found.tiles), kept_tiles, strict=True):
        np.testing.assert_array_equal(ours[ours >= 0], theirs)
    np.testing.assert_array_equal(found.row, rows)
    size = np.bincount(index.row_tile)
    np.testing.assert_array_equal(found.searched, [size[kept].sum() for kept in kept_tiles])


def test_reading_only_the_tiles_of_kept_scenes_equals_the_product_over_all(monkeypatch):
    db, position, scene = clustered(3, n=900, n_scenes=30)
    index = build_index(db, position, scene, 1.0)
    assert index.tile_prototype.shape[0] > 4 * 2 * index.tile_slots.shape[0]
    query = db[::9] + 0.2
    ours = search(query, index, 2, 6)
    rows, kept_scenes, _ = oracle.coarse_to_fine(query, db, np.asarray(index.row_tile), scene, 2, 6)
    np.testing.assert_array_equal(ours.row, rows)
    np.testing.assert_array_equal(ours.scenes, kept_scenes)
    monkeypatch.setattr(tile_search, "_DENSE", EVERY)
    jax.clear_caches()
    for one, other in zip(ours, search(query, index, 2, 6), strict=True):
        np.testing.assert_array_equal(one, other)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from([(1, 1), (2, 5)]))
def test_ties_go_to_the_lower_row(seed, kept):
    """Rows of +-1 have exact products, and 60 rows of 16 different ones many duplicates, in one tile and in several."""
    rng = np.random.default_rng(seed)
    db = (2.0 * rng.integers(0, 2, (60, 4)) - 1).astype(np.float32)
    tile = np.sort(np.r_[rng.integers(0, 24, 57), 0, 8, 23])  # the table of tiles has one shape
    scene = tile // 8
    shuffled = rng.permutation(60)
    db, tile, scene = db[shuffled], tile[shuffled], scene[shuffled]
    query = rng.integers(-3, 4, (8, 4)).astype(np.float32)
    index = index_module.index_of_tiles(db, tile, scene)
    np.testing.assert_array_equal(coarse_to_fine(query, index, 3, EVERY), brute_force(query, db))
    found = search(query, index, *kept)
    searched = (np.asarray(found.tiles)[:, :, None] == np.asarray(index.row_tile)[None, None]).any(axis=1)
    expected = np.where(searched, query @ db.T, -np.inf).argmax(axis=1)
    np.testing.assert_array_equal(found.row, expected)


def test_duplicates_and_one_descriptor_tiles():
    db, position, scene = clustered(5, n=60)
    position[:20] += 1000.0 * np.arange(1, 21)[:, None]  # twenty tiles of their own
    twice, where, which = np.concatenate([db, db]), np.concatenate([position] * 2), np.concatenate([scene] * 2)
    for tiled, sizes in ((where, {2}), (np.concatenate([position, position + 7e4]), {1})):
        index = build_index(twice, tiled, which, 5.0)
        assert sizes <= set(np.asarray(index.tile_size).tolist())
        np.testing.assert_array_equal(coarse_to_fine(db, index, 4, EVERY), np.arange(60))


def test_empty_tiles_are_never_kept(case):
    query, db, _, scene, _ = case
    order = np.argsort(scene, kind="stable")
    query, db, scene = query, db[order], scene[order]
    grid = scene * 10 + np.arange(len(db)) % 10
    hollow = np.where(grid % 10 == 4, grid + 1, grid)  # the fifth cell of each scene's grid holds nothing
    index = index_module.index_of_tiles(db, hollow, scene)
    assert int((np.asarray(index.tile_size)[:40] == 0).sum()) == 4
    np.testing.assert_array_equal(coarse_to_fine(query, index, 4, EVERY), brute_force(query, db))
    # The opposite of everything is less similar to each tile than the zero prototype of an empty one.
    away = -np.tile(db.mean(axis=0), (3, 1))
    found = search(away, index, 4, 36)
    assert sorted(np.asarray(found.tiles)[0]) == [t for t in range(40) if t % 10 != 4]


def test_any_number_of_queries_compiles_few_programs(case):
    query, _, _, _, index = case
    queries = np.tile(query, (10, 1))
    jax.clear_caches()
    expected = np.asarray(coarse_to_fine(queries, index))
    np.testing.assert_array_equal(expected, np.tile(expected[:64], 10))
    for q in (1, 33, 50, 63, 64, 513, 577, 600):
        np.testing.assert_array_equal(coarse_to_fine(queries[:q], index), expected[:q])
    assert tile_search._search._cache_size() == 3  # room for 1, 64 and 1,024 queries


def test_other_databases_of_a_size_run_in_the_same_program():
    jax.clear_caches()
    for seed in range(3):
        db, position, scene = clustered(seed)
        coarse_to_fine(db[:10], build_index(db, position * (1 + 0.02 * seed), scene, 3.0))
    assert tile_search._search._cache_size() == 1


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Two short drives through one town, as descriptors of all views."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OVIBJAX_CACHE", str(tmp_path_factory.mktemp("cache")))
        drives = [town_features(TownConfig(size_m=120.0), 20, route) for route in range(2)]
    features = np.concatenate([drive.features.reshape(20, -1) for drive in drives])
    return features, np.concatenate([drive.positions_m[:, :2] for drive in drives]), np.repeat([0, 1], 20)


@pytest.mark.parametrize("centred", [False, True])
def test_real_descriptors_with_everything_kept(real, centred):
    features, position, scene = real
    features = features - features.mean(axis=0) if centred else features
    for query, kept in ((features[1::2], np.arange(0, 40, 2)), (features, np.arange(40))):
        index = build_index(features[kept], position[kept], scene[kept], 10.0)
        found = search(query, index, 2, EVERY)
        np.testing.assert_array_equal(found.row, brute_force(query, features[kept]))
        assert np.all(np.asarray(found.searched) == len(kept))


def test_it_maps_and_compiles(case):
    query, _, _, _, index = case
    expected = np.asarray(coarse_to_fine(query, index, 2, 5))
    compiled = jax.jit(coarse_to_fine, static_argnames=("scenes", "tiles"))
    np.testing.assert_array_equal(compiled(query, index, scenes=2, tiles=5), expected)
    halves = jax.vmap(lambda q: coarse_to_fine(q, index, 2, 5))(query.reshape(2, 32, -1))
    np.testing.assert_array_equal(np.asarray(halves).ravel(), expected)


def test_no_query_is_no_answer(case):
    assert coarse_to_fine(np.zeros((0, 16), np.float32), case[-1]).shape == (0,)


def test_blocks_of_brute_force_give_the_same_answers(monkeypatch, case):
    query, db = case[:2]
    expected = np.asarray(brute_force(query, db))
    monkeypatch.setattr(retrieval, "_BLOCK_PAIRS", 10 * len(db))
    np.testing.assert_array_equal(jax.jit(lambda q, r: retrieval.brute_force(q, r))(query, db), expected)


@pytest.mark.parametrize(("scenes", "tiles"), [(1, 1), (2, 12), (4, 5)])
def test_the_grid_of_a_study_equals_the_search(case, scenes, tiles):
    query, _, position, scene, index = case
    asked = Asked(jnp.asarray(query), jnp.asarray(position[:64], jnp.float32), jnp.asarray(scene[:64]))
    grid = [jnp.array(kept, jnp.int32) for kept in ((1, 2, 4), (1, 5, 12))]
    judged = jax.jit(judge_pruning)(asked, index, jnp.asarray(position, jnp.float32), *grid)
    at = (1, 2, 4).index(scenes), (1, 5, 12).index(tiles)
    found = search(query, index, scenes, tiles)
    row, right = np.asarray(found.row), np.asarray(index.row_tile)[:64]  # a query stands where its reference does
    error = np.linalg.norm(position[row] - position[:64], axis=1)
    brute = np.linalg.norm(position[np.asarray(brute_force(query, case[1]))] - position[:64], axis=1)
    hit = (np.asarray(found.tiles) == right[:, None]).any(axis=1)
    expected = {
        "pruned": 1 - np.mean(found.searched) / len(position),
        "scene_hit": np.mean((np.asarray(found.scenes) == scene[:64, None]).any(axis=1)),
        "tile_hit": hit.mean(),
        "error_m": error.mean(),
        "brute_m": brute.mean(),
        "error_hit_m": error[hit].mean(),
        "brute_hit_m": brute[hit].mean(),
        "astray_excess_m": np.where(scene[row] != scene[:64], error - brute, 0).mean(),
        "wrong_scene": np.mean(scene[row] != scene[:64]),
        "floor_m": 0.0,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(judged, name)[at], value, rtol=1e-4, atol=1e-5, err_msg=name)


def test_bad_input_is_one_line():
    db, position, scene = clustered(2, n=20)
    bad = db.copy()
    bad[7] = np.nan
    for arguments, word in (
        ((db[:0], position[:0], scene[:0], 3.0), "at least 1"),
        ((db, position[:5], scene, 3.0), "expected"),
        ((db, position, scene, 0.0), "positive edge"),
        ((db, position * np.nan, scene, 3.0), "position"),
        ((bad, position, scene, 3.0), "descriptor 7"),
    ):
        with pytest.raises(InputError, match=word):
            build_index(*arguments)
    index = build_index(db, position, scene, 3.0)
    with pytest.raises(ValueError, match="at least one"):
        search(db, index, 0, 3)


def test_retrieve_searches_an_array_exhaustively_and_an_index_from_coarse_to_fine(case):
    query, db, _, _, index = case
    for database in (db, jnp.asarray(db)):
        np.testing.assert_array_equal(retrieve(query, database), brute_force(query, db))
    np.testing.assert_array_equal(retrieve(query, index), coarse_to_fine(query, index))
    few = np.asarray(retrieve(query, index, scenes=1, tiles=2))
    np.testing.assert_array_equal(few, coarse_to_fine(query, index, 1, 2))
    assert np.any(few != np.asarray(retrieve(query, db)))
