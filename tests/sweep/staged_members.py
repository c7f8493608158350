"""Member functions that can be cut, of every kind that may be handed over differently, and what compares them."""

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.sweep.halving import halve
from ovibjax.sweep.staged import Staged

STEPS = 27
DATA = {"a": np.random.default_rng(0).normal(size=(8, 8)).astype(np.float32) / 3}


def momentum():
    """Random keys, whole numbers and numbers of Python in the state."""

    def begin(key, point, shared):
        return {"w": jax.random.normal(key, (16, 8)), "m": jnp.zeros((16, 8)), "count": 0, "key": key, "best": 1e30}

    def go_on(key, point, shared, state, first, last):
        def step(i, s):
            noise = jax.random.normal(jax.random.fold_in(s["key"], i), (16, 8))
            m = 0.9 * s["m"] + jnp.tanh(s["w"] @ shared["a"]) - 0.1 * noise
            w = s["w"] - point["rate"] * m
            return s | {"w": w, "m": m, "count": s["count"] + 1, "best": jnp.minimum(s["best"], jnp.mean(w * w))}

        return jax.lax.fori_loop(first, last, step, state)

    def judge(key, point, shared, state):
        return {"loss": jnp.mean(state["w"] ** 2), "curve": state["w"][0], "n": state["count"], "in": {"w": state["w"]}}

    return Staged(begin, go_on, judge, STEPS)


def same_start():
    """A state that all members of a batch begin with, and parts of it that stay the same for all."""

    def begin(key, point, shared):
        return jnp.ones(64) / 3, jnp.float32(1) / 7

    def go_on(key, point, shared, state, first, last):
        def step(i, s):
            w, gain = s
            return jnp.sin(w * point["rate"] + gain * 1e-3 * i.astype(jnp.float32)) + w * gain, gain

        return jax.lax.fori_loop(first, last, step, state)

    def judge(key, point, shared, state):
        return {"loss": jnp.sum(state[0]) * state[1]}

    return Staged(begin, go_on, judge, STEPS)


def network():
    """Adam on a small network in half precision, by minibatches that the seed draws; cut at multiples of three."""

    def loss(weights, x, y):
        hidden = jnp.tanh(x.astype(jnp.bfloat16) @ weights["in"].astype(jnp.bfloat16))
        return jnp.mean((hidden.astype(jnp.float32) @ weights["out"] - y) ** 2)

    def begin(key, point, shared):
        one, two = jax.random.split(key)
        weights = {"in": jax.random.normal(one, (8, 32)) / 3, "out": jax.random.normal(two, (32, 1)) / 6}
        zeros = jax.tree.map(jnp.zeros_like, weights)
        return weights, zeros, zeros, jnp.bfloat16(1), jnp.bool_(False)

    def go_on(key, point, shared, state, first, last):
        def step(i, s):
            w, m, v, half, flag = s
            x = jax.random.normal(jax.random.fold_in(key, i), (16, 8)) @ shared["a"]
            slope = jax.grad(loss)(w, x, jnp.sin(x.sum(axis=1, keepdims=True)))
            m = jax.tree.map(lambda a, g: 0.9 * a + 0.1 * g, m, slope)
            v = jax.tree.map(lambda a, g: 0.99 * a + 0.01 * g * g, v, slope)
            w = jax.tree.map(lambda w, a, b: w - point["rate"] * a / (jnp.sqrt(b) + 1e-6), w, m, v)
            return w, m, v, half * jnp.bfloat16(0.99), ~flag

        return jax.lax.fori_loop(first, last, step, state)

    def judge(key, point, shared, state):
        x = jax.random.normal(key, (64, 8))
        return {"loss": loss(state[0], x, jnp.sin(x.sum(axis=1, keepdims=True))), "half": state[3].astype(jnp.float32)}

    return Staged(begin, go_on, judge, STEPS, every=3)


def slow(inner):
    """A recursion of so many random numbers a step, about 4 us each."""

    def go_on(key, point, shared, state, first, last):
        def step(i, w):
            drawn = jax.random.normal(jax.random.fold_in(key, i), (64,))
            return 0.9 * w + point["rate"] * jnp.tanh(drawn)

        return jax.lax.fori_loop(first * inner, last * inner, step, state)

    def judge(key, point, shared, state):
        return {"loss": jnp.mean((state - 1) ** 2), "weights": state}

    return Staged(lambda key, point, shared: jnp.zeros(64), go_on, judge, 9)


def slow_sweep(store, inner, **options):
    """36 members on the first rung, 12 on the second, 4 on the third."""
    axes = {"rate": np.linspace(0.1, 1.2, 18).tolist(), "seed": range(2)}
    return halve(slow(inner), axes, score="loss", store=store, lanes=1, **options)


FUNCTIONS = {"momentum": momentum, "same_start": same_start, "network": network}
AXES = {"rate": [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0], "decay": [0.1, 0.2], "seed": range(3)}


def last_of(halved, steps=STEPS):
    """The members of a halving that were trained to the end."""
    dim = halved.steps.dims[0]
    return halved.isel({dim: np.flatnonzero(halved.steps.values == steps)})


def differences(halved, whole, axes=("rate", "decay"), steps=STEPS):
    """Names and points of outputs of which a member that went on has other bits than one trained in one go."""
    end, found = last_of(halved, steps), []
    (dim,) = halved.steps.dims
    assert end.sizes[dim] and bool(end.finished.all())
    for i in range(end.sizes[dim]):
        point = {name: end[name].values[i] for name in axes}
        for name in whole.data_vars:
            one, other = end[name].isel({dim: i}), whole[name].sel(point)
            if one.values.tobytes() != other.values.tobytes():
                found.append((name, point))
    return found


def halved(function="momentum", axes=AXES, **options):
    """A halving of one of the functions."""
    return halve(FUNCTIONS[function](), axes, DATA, **{"score": "loss", **options})
