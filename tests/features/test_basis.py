"""The per-view principal basis against NumPy's singular values."""

import numpy as np
import pytest

from ovibjax.features.basis import fit_basis, project


def unit_features(n=60, m=5, d=12, seed=0, decay=0.7):
    """Unit-norm rows with a different mean and falling spectrum in each view."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(m, d, d)) * decay ** np.arange(d)[:, None]
    rows = np.einsum("nmk,mkd->nmd", rng.normal(size=(n, m, d)), mixing) + 2 * rng.normal(size=(m, d))
    return (rows / np.linalg.norm(rows, axis=-1, keepdims=True)).astype(np.float32)


def singular_values(features, view):
    rows = features[:, view].astype(np.float64)
    return np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False)


@pytest.mark.parametrize("m", [4, 5])
@pytest.mark.parametrize("rank", [1, 3, 11])
def test_axes_are_orthonormal_and_span_the_leading_subspace(m, rank):
    features = unit_features(m=m)
    basis = fit_basis(features, rank)
    assert basis.axes.shape == (m, 12, rank) and basis.mean.shape == (m, 12)
    assert all(part.dtype == np.float32 for part in basis)
    np.testing.assert_allclose(basis.mean, features.astype(np.float64).mean(axis=0), atol=1e-6)
    for view in range(m):
        axes = basis.axes[view].astype(np.float64)
        np.testing.assert_allclose(axes.T @ axes, np.eye(rank), atol=1e-5)
        centred = features[:, view] - features[:, view].astype(np.float64).mean(axis=0)
        _, _, vt = np.linalg.svd(centred)
        np.testing.assert_allclose(axes @ axes.T, vt[:rank].T @ vt[:rank], atol=1e-3)
        # Leading axis first.
        energy = ((centred @ axes) ** 2).sum(axis=0)
        np.testing.assert_allclose(energy, singular_values(features, view)[:rank] ** 2, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("rank", [1, 4, 11])
def test_energy_kept_equals_numpys_singular_values(rank):
    features = unit_features(seed=1)
    kept = fit_basis(features, rank).energy_kept
    assert kept.shape == (5,)
    for view in range(5):
        energy = singular_values(features, view) ** 2
        np.testing.assert_allclose(kept[view], energy[:rank].sum() / energy.sum(), rtol=1e-5)
    assert np.all(kept < 1) and len(set(kept.tolist())) == 5


def test_more_rank_keeps_more_energy():
    features = unit_features(seed=2)
    kept = np.stack([fit_basis(features, rank).energy_kept for rank in range(1, 13)])
    assert np.all(np.diff(kept, axis=0) > 0)
    np.testing.assert_array_equal(kept[-1], 1.0)


@pytest.mark.parametrize("rank", [1, 5, 12, None])
def test_training_coordinates_have_zero_mean_and_unit_variance_overall(rank):
    features = unit_features(seed=3)
    coordinates = project(fit_basis(features, rank), features)
    assert coordinates.dtype == np.float32 and coordinates.shape == (60, 5, rank or 12)
    np.testing.assert_allclose(coordinates.mean(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose((coordinates.astype(np.float64) ** 2).mean(), 1.0, rtol=1e-4)


@pytest.mark.parametrize(("n", "rank"), [(60, None), (60, 12), (60, 100), (8, 8), (8, 10), (8, None)])
def test_a_rank_not_below_min_n_d_keeps_every_dimension_exactly(n, rank):
    features = unit_features(n=n, seed=4)
    basis = fit_basis(features, rank)
    assert basis.axes.shape == (5, 12, 12)
    np.testing.assert_array_equal(basis.energy_kept, 1.0)
    unseen = unit_features(n=9, seed=5)
    for rows in (features, unseen):
        back = np.einsum("nmr,mdr->nmd", project(basis, rows) * basis.scale, basis.axes) + basis.mean
        np.testing.assert_allclose(back, rows, atol=1e-6)


def test_a_rank_below_min_n_d_is_cut_also_with_fewer_frames_than_dimensions():
    features = unit_features(n=8, seed=6)
    basis = fit_basis(features, 7)
    assert basis.axes.shape == (5, 12, 7)
    # Eight centred rows span seven dimensions.
    np.testing.assert_allclose(basis.energy_kept, 1.0, atol=1e-6)
    back = np.einsum("nmr,mdr->nmd", project(basis, features) * basis.scale, basis.axes) + basis.mean
    np.testing.assert_allclose(back, features, atol=1e-5)


@pytest.mark.parametrize("rank", [4, None])
def test_project_is_affine_with_the_mean_at_zero(rank):
    basis = fit_basis(unit_features(seed=7), rank)
    a, b = unit_features(n=20, seed=8), unit_features(n=20, seed=9)
    np.testing.assert_allclose(project(basis, basis.mean[None]), 0.0, atol=1e-6)
    mixed = project(basis, np.float32(0.3) * a + np.float32(0.7) * b)
    np.testing.assert_allclose(mixed, 0.3 * project(basis, a) + 0.7 * project(basis, b), atol=1e-4)
    expected = np.einsum("nmd,mdr->nmr", a.astype(np.float64) - basis.mean, basis.axes) / basis.scale
    np.testing.assert_allclose(project(basis, a), expected, atol=1e-4)


def test_each_view_has_its_own_map():
    features = unit_features(seed=10)
    basis = fit_basis(features, 4)
    for view in range(5):
        alone = fit_basis(features[:, view : view + 1], 4)
        np.testing.assert_allclose(np.abs(alone.axes[0]), np.abs(basis.axes[view]), atol=1e-4)
        np.testing.assert_allclose(alone.energy_kept[0], basis.energy_kept[view], rtol=1e-5)
        changed = features.copy()
        changed[:, view] = changed[::-1, view] * 0.5
        other = fit_basis(changed, 4)
        keep = np.arange(5) != view
        np.testing.assert_array_equal(other.mean[keep], basis.mean[keep])
        np.testing.assert_allclose(np.abs(other.axes[keep]), np.abs(basis.axes[keep]), atol=1e-6)


@pytest.mark.parametrize("rank", [1, 5, 11, None])
def test_error_in_the_basis_is_the_full_error_less_the_energy_left_out(rank):
    train, features = unit_features(seed=11), unit_features(n=30, seed=12)
    basis = fit_basis(train, rank)
    coordinates = project(basis, features).astype(np.float64)
    guess = coordinates + np.random.default_rng(13).normal(size=coordinates.shape)
    axes = basis.axes.astype(np.float64)
    full = features - (np.einsum("nmr,mdr->nmd", guess * basis.scale, axes) + basis.mean)
    centred = features.astype(np.float64) - basis.mean
    left_out = centred - np.einsum("nmd,mdr,mer->nme", centred, axes, axes)
    inside = ((coordinates - guess) * basis.scale) ** 2
    np.testing.assert_allclose(
        inside.sum(axis=(1, 2)), (full**2).sum(axis=(1, 2)) - (left_out**2).sum(axis=(1, 2)), rtol=1e-4, atol=1e-4
    )
    # On the training features the energy left out is the share the basis reports.
    centred = train.astype(np.float64) - basis.mean
    left_out = centred - np.einsum("nmd,mdr,mer->nme", centred, axes, axes)
    share = (left_out**2).sum(axis=(0, 2)) / (centred**2).sum(axis=(0, 2))
    np.testing.assert_allclose(share, 1 - basis.energy_kept, atol=1e-5)


def test_constant_features_do_not_divide_by_zero():
    features = np.broadcast_to(np.float32([0.6, 0.8, 0.0]), (6, 4, 3)).copy()
    for rank in (2, None):
        coordinates = project(fit_basis(features, rank), features)
        assert np.all(np.isfinite(coordinates))
