"""Product quantisation: groups that share the variance, centroids that are means, and scikit-learn's k-means."""

import jax
import jax.numpy as jnp
import numpy as np
from sklearn.cluster import KMeans

from ovibjax.encoder.pca import fit_pca
from ovibjax.encoder.product_quantiser import fit_product_quantiser, quantised, shared_out


def features(n=900, seed=0):
    rng = np.random.default_rng(seed)
    made = np.tanh(rng.normal(size=(n, 5)) @ rng.normal(size=(5, 40))) + 0.1 * rng.normal(size=(n, 40))
    return (made - made.mean(axis=0)).astype(np.float32)


def test_groups_are_equal_and_share_the_variance():
    variance = 100 * np.arange(1, 33.0) ** -1.5
    groups = shared_out(variance, 4)
    assert groups.shape == (4, 8) and sorted(groups.ravel()) == list(range(32))
    assert sorted(shared_out(variance[:31], 4).ravel()) == list(range(28))
    products = np.log(variance)[groups].sum(axis=1)
    assert np.ptp(products) < 0.1 * np.ptp(np.log(variance).reshape(4, 8).sum(axis=1))


def test_every_frame_becomes_its_nearest_centroids_and_those_are_means():
    x = features()
    fitted = fit_product_quantiser(jax.random.key(0), jnp.asarray(x), 4, 16)
    received = np.asarray(quantised(fitted, jnp.asarray(x)))
    expected = np.zeros_like(received)
    for axes, centroids in zip(np.asarray(fitted.axes), np.asarray(fitted.centroids), strict=True):
        part = x @ axes
        nearest = np.argmin(((part[:, None] - centroids[None]) ** 2).sum(axis=-1), axis=1)
        expected += centroids[nearest] @ axes.T
    np.testing.assert_allclose(received, expected, atol=1e-4)


def test_it_is_about_as_good_as_the_k_means_of_scikit_learn():
    x = features()
    fitted = fit_product_quantiser(jax.random.key(0), jnp.asarray(x), 2, 8)
    lost = np.mean((np.asarray(quantised(fitted, jnp.asarray(x))) - x) ** 2)
    principal = x @ np.asarray(fit_pca(jnp.asarray(x), 8).components)
    beyond = (x**2).sum() - (principal**2).sum()
    theirs = 0.0
    for axes in np.asarray(fitted.axes):
        theirs += KMeans(256, n_init=1, random_state=0).fit(x @ axes).inertia_
    assert lost < 1.1 * (theirs + beyond) / x.size


def test_more_bytes_lose_less_and_few_frames_are_enough():
    x = jnp.asarray(features(100))
    lost = [
        float(jnp.mean((quantised(fit_product_quantiser(jax.random.key(0), x[:60], m, 16), x[60:]) - x[60:]) ** 2))
        for m in (1, 4, 16)
    ]
    assert lost[0] > lost[1] > lost[2]
