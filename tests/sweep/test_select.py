"""Picking members out of batched trees and datasets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.errors import InputError


def fn(key, point, shared):
    weight = point["a"] * jnp.arange(3.0) + jax.random.normal(key, (3,))
    return {"params": {"layer": {"kernel": weight, "bias": point["a"]}}, "loss": (point["a"] - 2.0) ** 2 + shared}


@pytest.fixture(scope="module")
def dataset():
    return sweep.run(fn, {"a": [1.0, 2.0, 4.0], "seed": range(2)}, jnp.float32(0.5))


def test_take_is_indexing_of_every_leaf():
    tree = {"w": np.arange(24.0).reshape(2, 3, 4), "b": np.arange(6).reshape(2, 3)}
    one = sweep.take(tree, (1, 2))
    np.testing.assert_array_equal(one["w"], tree["w"][1, 2])
    assert one["b"] == 5
    np.testing.assert_array_equal(sweep.take(tree, 0)["w"], tree["w"][0])


def test_best_finds_lowest_and_highest_and_passes_over_what_diverged():
    tree = {"w": np.arange(6.0).reshape(2, 3)}
    metric = np.array([[3.0, np.nan, 2.0], [np.inf, 1.5, 9.0]])
    assert sweep.best(tree, metric) == ((1, 1), {"w": 4.0})
    assert sweep.best(tree, metric, minimise=False) == ((1, 2), {"w": 5.0})
    with pytest.raises(InputError, match="no member has a finite metric"):
        sweep.best(tree, np.full((2, 3), np.nan))


def test_parameters_come_back_as_the_tree_they_were(dataset):
    tree = sweep.tree_of(dataset, "params")
    assert tree["layer"]["kernel"].shape == (3, 2, 3) and tree["layer"]["bias"].shape == (3, 2)
    index, params = sweep.best(tree, dataset.loss)
    assert index[0] == 1 and params["layer"]["bias"] == 2.0
    alone = sweep.tree_of(dataset, "params", {"a": 4.0, "seed": 1})
    expected = fn(jax.random.key(1), {"a": jnp.float32(4.0)}, 0.5)["params"]
    np.testing.assert_allclose(alone["layer"]["kernel"], expected["layer"]["kernel"], rtol=1e-6)


def test_an_absent_output_is_named(dataset):
    with pytest.raises(InputError, match="no output 'weights'"):
        sweep.tree_of(dataset, "weights")
