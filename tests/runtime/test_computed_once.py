"""`computed_once` changes no value: eager, compiled, mapped, inside a scan, and it leaves its mark in the program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.runtime.computed_once import computed_once


def function(x, tree):
    return {"a": jnp.sin(x) * tree[0], "b": (x > 0, jnp.where(x > 0, 1, 2)), "c": jnp.where(x > 0, 1.0, 2.0)}


def through(x, tree, slot=0):
    return computed_once(jnp.int32(slot) >= 0, function, x, tree)


X, TREE = jnp.linspace(-1.0, 2.0, 7), (jnp.arange(7.0), jnp.int32(3))


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit, jax.vmap, lambda f: jax.jit(jax.vmap(f))])
def test_same_values(wrap):
    tree = (TREE[0], jnp.full(7, TREE[1]))
    found, expected = wrap(through)(X, tree), function(X, tree)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_in_a_mapped_scan_with_the_slot_number_as_condition():
    def scan(start, step):
        def one(x, slot):
            return step(x, slot), None

        return jax.lax.scan(one, start, jnp.arange(5))[0]

    def plain(x, slot):
        return 0.5 * x + jnp.cos(x) * slot.astype(jnp.float32)

    def cut(x, slot):
        return computed_once(slot >= 0, plain, x, slot)

    compiled = jax.jit(jax.vmap(lambda x: scan(x, cut))).lower(X).compile()
    np.testing.assert_allclose(compiled(X), jax.vmap(lambda x: scan(x, plain))(X), rtol=1e-6)
    # vmap has left the branch a branch: a mapped condition would have become a selection, which fuses.
    assert "conditional" in compiled.as_text()
