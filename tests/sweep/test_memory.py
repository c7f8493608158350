"""The estimate of live memory, and that a sweep needs that of its batches, whatever its grid."""

import jax
import jax.numpy as jnp
import pytest

from ovibjax.sweep.memory import live_bytes
from tests.sweep.members import finish, start

X = jnp.zeros(1000)


def live(function, *args):
    return live_bytes(jax.make_jaxpr(function)(*args))


def test_chain_holds_two_links():
    assert live(lambda x: jnp.sin(x), X) == 4000
    assert live(lambda x: jnp.exp(jnp.cos(jnp.sin(x))), X) == 8000


def test_inputs_are_left_out():
    assert live(lambda x, y: jnp.sin(x), X, jnp.zeros(10**6)) == 4000
    assert live(lambda x: x, X) == 0


def test_dead_values_are_freed():
    assert live(lambda x: jnp.cos(x) * jnp.sin(x).sum(), X) == 2 * 4000 + 4

    def sums(x):
        return [jnp.sin(x).sum(), jnp.cos(x).sum(), jnp.tan(x).sum()]

    assert live(sums, X) == 4000 + 3 * 4


def test_values_that_are_needed_later_stay():
    def late(x):
        a, b, c = jnp.sin(x), jnp.cos(x), jnp.tan(x)
        return a + b * c

    assert live(late, X) == 4 * 4000


def test_dtypes_count():
    assert live(lambda x: jnp.sin(x.astype(jnp.float16)), X) == 2 * 2000
    assert live(lambda x: x > 0.5, X) == 1000


def test_widening_is_seen():
    assert live(lambda x: (x[:, None] * x[None, :]).sum(), X) >= 4_000_000


def scanned(steps, stack=False):
    def body(carry, _):
        return jnp.cos(jnp.sin(carry)), carry if stack else None

    return lambda x: jax.lax.scan(body, x, length=steps)


def test_scan_carries_once():
    # The carry comes out of the scan, and of its body with one value between.
    assert live(scanned(10), X) == 4000 + 8000


def test_scan_does_not_grow_with_its_steps():
    assert live(scanned(10), X) == live(scanned(10_000), X)


def test_stacked_outputs_grow_with_steps():
    assert live(scanned(1010, True), X) - live(scanned(10, True), X) == 1000 * 4000


def test_loops_and_branches_count_their_bodies():
    def loop(x):
        return jax.lax.while_loop(lambda x: x[0] < 1, lambda x: jnp.cos(jnp.sin(jnp.exp(x))), x)

    def branch(x):
        return jax.lax.cond(x[0] > 0, lambda x: jnp.outer(x, x).sum(), lambda x: x.sum(), x)

    assert live(loop, X) == 4000 + 8000
    assert live(branch, X) >= 4_000_000
    assert live(jax.jit(lambda x: jnp.exp(jnp.cos(jnp.sin(x)))), X) == 4000 + 8000


@pytest.mark.parametrize("function", [scanned(10), lambda x: jnp.exp(jnp.cos(jnp.sin(x))), lambda x: jnp.sin(x).sum()])
def test_proportional_to_batch(function):
    one, many = (live(jax.vmap(function), jnp.zeros((n, 1000))) for n in (10, 70))
    assert many == 7 * one


def test_keys_count():
    assert live(lambda: jax.random.split(jax.random.key(0), 1000)) >= 1000 * 8


BIG = """
import re
import jax, jax.numpy as jnp
from ovibjax.sweep.engine import run

def big(key, point, shared):
    x = jnp.full(5_000_000, point["rate"])  # 20 MB
    return {"y": jax.lax.fori_loop(0, 2, lambda i, x: point["rate"] + x[::-1] * x[i], x).sum()}

def peak():
    # ru_maxrss begins at what the parent had
    return int(re.search("VmHWM:.* ([0-9]+) kB", open("/proc/self/status").read())[1]) / 1024

def go(n):
    run(big, {"rate": [i / n for i in range(n)], "seed": [1]})
    return peak()

jnp.zeros(5).block_until_ready()
before = peak()
print(before, go(8), go(64))
"""


@pytest.mark.slow
def test_peak_memory_follows_the_batch_not_the_grid():
    before, few, many = map(float, finish(start(BIG)).split())
    assert few > before + 40, "the members do need their memory"
    assert many - few < 100, f"{before:.0f}, {few:.0f}, {many:.0f} MB"
