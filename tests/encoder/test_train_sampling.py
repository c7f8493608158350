"""Minibatches: shares of the view modes, prefixes, noise, and the share that is trained without nesting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from ovibjax.encoder.train import TrainConfig, sample_batch, view_rows, without_nesting
from ovibjax.views import modes_for
from tests.encoder.cases import UAV, UGV, assert_trees_equal, make_data, quick_jit
from tests.oracles import encoder as oracle

RUN = TrainConfig(arch=UAV, prefixes=(2, 5, 8))
sample = quick_jit(sample_batch)


def draw(key, static, data, size):
    return sample(jax.random.key(key), jnp.arange(size) % data.x.shape[0], data, static)


NESTED = ("A5", "H4", "FS", "F")


@pytest.mark.parametrize("modes", [None, ("A5",), ("F",), ("F", "A5"), ("H4", "F", "FS"), ("FS", "H4")])
@pytest.mark.parametrize("n_views", [5, 4])
@pytest.mark.parametrize("size", [1, 3, 12, 50, 128])
def test_a_batch_is_shared_out_equally_with_most_views_first(n_views, modes, size):
    if n_views == 4 and modes and "A5" in modes:
        pytest.skip("a UGV has no such mode")
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, modes=modes)
    masks, rows = view_rows(static, size)
    names = modes or modes_for(n_views)
    assert masks.shape == (size, n_views) and masks.dtype == np.float32
    np.testing.assert_array_equal(masks, oracle.equal_shares(size, names, n_views))
    table = np.stack([oracle.view_mask(mode, n_views) for mode in NESTED if mode in names])
    shares = (masks[:, None] == table[None]).all(axis=2).sum(axis=0)
    assert shares.sum() == size and np.ptp(shares) <= (size % len(names) > 0)
    assert np.all(np.diff(masks.sum(axis=1)) <= 0)
    # Every view is in the first rows, and in no other.
    assert isinstance(rows, tuple) and all(type(count) is int for count in rows)
    np.testing.assert_array_equal(masks, np.arange(size)[:, None] < np.array(rows)[None])
    assert rows[0] == size


def test_the_order_in_which_modes_are_named_is_immaterial():
    for names in (("F", "H4", "A5"), ("A5", "F", "H4")):
        np.testing.assert_array_equal(
            view_rows(TrainConfig(modes=names), 9)[0].sum(axis=1), [5, 5, 5, 4, 4, 4, 1, 1, 1]
        )
    assert view_rows(TrainConfig(modes=("A5",)), 7)[1] == (7,) * 5
    assert view_rows(TrainConfig(modes=("F",)), 7)[1] == (7, 0, 0, 0, 0)


@pytest.mark.parametrize(("n_views", "prefixes"), [(5, (1, 3, 4, 8)), (4, (2, 8)), (5, (8,))])
def test_modes_have_equal_shares_and_prefixes_are_uniform_in_each(n_views, prefixes):
    data = make_data(n_views)
    static = TrainConfig(arch=UAV if n_views == 5 else UGV, prefixes=prefixes)
    batch = draw(7, static, data, 36_000)
    np.testing.assert_array_equal(batch.view_mask, oracle.equal_shares(36_000, modes_for(n_views), n_views))
    masks = np.stack([oracle.prefix_mask(k, 8) for k in prefixes])
    drawn_prefix = (np.asarray(batch.prefix_mask)[:, None] == masks[None]).all(axis=2)
    np.testing.assert_array_equal(drawn_prefix.sum(axis=1), 1)
    modes = len(modes_for(n_views))
    table = drawn_prefix.reshape(modes, -1, len(prefixes)).sum(axis=1)
    if len(prefixes) > 1:
        # The shares of the modes are fixed, which takes degrees of freedom.
        assert stats.chisquare(table.ravel(), ddof=modes - 1).pvalue > 1e-3


def test_a_biased_sampler_would_be_noticed():
    counts = np.full(16, 2500.0)
    counts[3] *= 1.15
    assert stats.chisquare(counts, np.full(16, counts.mean())).pvalue < 1e-3


def test_noise_is_standard_normal_and_fresh_for_each_coordinate():
    batch = draw(1, RUN, make_data(), 10_000)
    noise = np.asarray(batch.noise, np.float64)
    assert noise.shape == (10_000, 8) and batch.noise.dtype == jnp.float32
    assert stats.kstest(noise.ravel(), "norm").pvalue > 1e-3
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(8), atol=0.05)
    lengths = np.asarray(batch.prefix_mask).sum(axis=1)
    assert abs(np.corrcoef(lengths, noise[:, 0])[0, 1]) < 0.05


def test_rows_and_masks_belong_to_the_index():
    data, index = make_data(), jnp.array([5, 5, 0, 63, 17])
    batch = sample(jax.random.key(0), index, data, RUN)
    np.testing.assert_array_equal(batch.x, np.asarray(data.x)[np.asarray(index)])
    np.testing.assert_array_equal(batch.y, np.asarray(data.y)[np.asarray(index)])
    shapes = [(5, 5, 6), (5, 3), (5, 5), (5, 8), (5, 8)]
    assert [leaf.shape for leaf in batch] == shapes
    assert all(leaf.dtype == jnp.float32 for leaf in batch)


def test_a_batch_is_a_function_of_its_key_and_row_numbers():
    data = make_data()
    batch = draw(4, RUN, data, 64)
    assert_trees_equal(batch, draw(4, RUN, data, 64))
    other = draw(5, RUN, data, 64)
    np.testing.assert_array_equal(batch.view_mask, other.view_mask)
    for name in ("prefix_mask", "noise"):
        assert not np.array_equal(getattr(batch, name), getattr(other, name))
    # Masks and noise ignore what the rows hold.
    blank = draw(4, RUN, data._replace(x=data.x * 0, y=data.y * 0), 64)
    for name in ("view_mask", "prefix_mask", "noise"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(blank, name))


@pytest.mark.parametrize("nesting", [0.0, 0.3, 0.5, 1.0])
def test_the_share_without_nesting_sees_all_coordinates(nesting):
    mask = np.tile(np.stack([oracle.prefix_mask(k, 8) for k in (1, 3, 4, 8)]), (2500, 1)).astype(np.float32)
    out = np.asarray(jax.jit(without_nesting)(jax.random.key(3), mask, jnp.float32(nesting)))
    assert out.shape == mask.shape and out.dtype == np.float32
    whole = out.min(axis=1) == 1.0
    np.testing.assert_array_equal(out[~whole], mask[~whole])
    partial = mask.min(axis=1) == 0.0
    if nesting in (0.0, 1.0):
        assert np.all(whole[partial] == (nesting == 0.0))
    count = int(whole[partial].sum())
    assert stats.binomtest(count, int(partial.sum()), 1 - nesting).pvalue > 1e-3
    # Whatever the prefix.
    for k in (1, 3, 4):
        assert abs(whole[mask.sum(axis=1) == k].mean() - (1 - nesting)) < 0.04


def test_a_higher_share_of_nesting_masks_more_examples_and_no_others():
    mask = jnp.zeros((1000, 8), jnp.float32)
    whole = [np.asarray(without_nesting(jax.random.key(0), mask, jnp.float32(share))) for share in (0.2, 0.6)]
    assert np.all(whole[0] >= whole[1]) and 300 < (whole[0] - whole[1])[:, 0].sum() < 500
