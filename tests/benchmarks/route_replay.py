"""Route replay of VOI-Control: one compiled call against two Numba loops and a plain Python loop, results equal.

    python -m tests.benchmarks.route_replay            (extra [bench]; a quiet machine; half a minute)
    python -m tests.benchmarks.route_replay --times 4  (four times the replays; --slots 2372 for as many slots)

4,096 replays (16 seeds x 256 candidates) x 593 slots x 8 actions. Ours is one program over one virtual device per core,
each with its share of the seeds and, as `ovibjax edge` sets it (NPROC=1), one thread. Numba runs scalar float32 code,
replays dealt to the same cores; it looks at the actions only in slots where a request is possible (rested, nothing
under way). `hoisted` is the same loop with all that no client changes computed before it, as ours has it. Python is the
tests' NumPy oracle.

`ratio_today` and the last line are against the first Numba loop, `ratio_hoisted` against the second, `processor_ratio`
against the first by processor time, for machines on which other things run.

What was tried for speed, nanoseconds of processor per slot-decision, 2,048 lanes in a process of one core with AVX-512
(EPYC), by turns beside other work, so good to a tenth; one thread of the first Numba loop took 5.4 there:

    a step of `client_step` per slot, D(s) by a power, actions by net value   26
    D(s) as a product, actions by the risk above which they are worth it      13.8  kept
    what no client changes in a table before the scan; beliefs of four
      numbers; sums of the slot before, from what is stored anyway             6.7  kept
    the chosen action's numbers by the bits of its number                      6.2  kept
    transmission times in the table, not divisions in each slot                5.3  kept
    no comparisons with an energy or an availability that all lanes lack       4.4  kept; a real branch for all lanes
    none with a payload budget either                                          3.8  kept, for searches
    slots of the table read where they are used; energy in that branch         4.1  kept
    vectors of 512 bits (xla_cpu_prefer_vector_width)                          3.3  not kept: an option of the compiler
    state as rows of few arrays, lanes last                                    8.3  rows picked from what is fused are
                                                                                    not vectorized; a loop costs 50 ns
    decision in two loops, fewer constants in each                             4.5  no gain

2 virtual cores (AMD EPYC with AVX-512), quiet, Python 3.11, jax 0.10.2, numba 0.68.1,
best of 10 by turns, two threads a device (NPROC=2):

    ovibjax     210 million slot-decisions/s     11.6 ms,   9.6 ns of processor each   compiling 3.6 s
    Numba       347 million slot-decisions/s      7.0 ms,   4.5 ns of processor each   compiling 1.5 s
    hoisted     436 million slot-decisions/s      5.6 ms,   3.9 ns of processor each   compiling 1.0 s
    Python    0.050 million slot-decisions/s
    processor_ratio: 0.47
    ratio_hoisted: 0.48
    ratio: 0.61

A third of the time is the decision, the rest some sixteen loops over one array each, which read and write what a scalar
loop keeps in registers. XLA deals the loops of a slot to the threads of its pool: with two threads the same program
takes 9.2 ns of processor on one device (NPROC=1 in the environment: 4.1), and 5 to 8 on two devices, less the more
lanes there are. On two cores of a busy Xeon with AMX one thread a device had ratios from 0.54 to 0.88, two threads from
0.57 to 0.85. The goal of three times the first Numba loop is not reached.
"""

import argparse
import math
import os
import time
from collections.abc import Callable
from functools import partial

os.environ.setdefault("NPROC", "1")  # a thread per device, see below; before jax starts

import jax
import jax.numpy as jnp
import numba
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ovibjax.control.actions import ACTIONS
from ovibjax.control.client_state import ControlParams
from ovibjax.control.controller import Controller, make_controller
from ovibjax.control.environment import Draws, Environment, Route, draw, make_environment
from ovibjax.control.route_summary import Summary, score
from ovibjax.control.voi import Prices
from tests.benchmarks.numba_replays import for_numba, hoisted, numba_hoisted, numba_replays
from tests.control.cases import for_oracle
from tests.oracles import control as oracle

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
SEEDS, CANDIDATES, SLOTS = 16, 256, 593
MEDIANS_M = (8.0, 7.0, 3.0, 2.5, 2.8, 2.3, 2.6, 2.2)
"""Predicted residual of each action."""


def make_inputs(seeds: int, candidates: int, slots: int = SLOTS) -> tuple[Draws, Route, Environment, Controller]:
    """A synthetic route with lognormal residuals, draws per seed, and random candidates."""
    rng = np.random.default_rng(0)
    context = np.repeat(rng.integers(0, 3, slots), 10)[:slots].astype(np.int32)
    predicted = np.tile(np.float32(MEDIANS_M), (slots, 1))
    angle = rng.uniform(0, 2 * np.pi, predicted.shape)
    size = predicted * rng.lognormal(0.0, 0.5, predicted.shape)
    residual = np.stack([size * np.cos(angle), size * np.sin(angle)], -1)
    yaw = rng.uniform(0, 2 * np.pi, slots)
    route = Route(context, *(jnp.asarray(x, jnp.float32) for x in (yaw, predicted, residual, predicted)))
    env = make_environment()
    keys = jax.random.split(jax.random.key(0), seeds)
    draws = jax.jit(jax.vmap(lambda key: draw(key, route, env, ACTIONS)))(keys)

    def candidate(key: jax.Array) -> Controller:
        u = jax.random.uniform(key, (4,))
        prices = Prices(5.0 * u[0], jnp.float32(0.0), 5.0 * u[1])
        return make_controller(ACTIONS)._replace(prices=prices, threshold_m=6.0 * u[2], min_gap_s=8.0 * u[3])

    return draws, route, env, jax.vmap(candidate)(jax.random.split(jax.random.key(1), candidates))


def on_one_device(draws: Draws, route: Route, env: Environment, tried: Controller, per_scan: int) -> Summary:
    """Fields [seeds, candidates]; `per_scan` seeds go through one scan, the others after them."""

    def of_seed(draws: Draws) -> Summary:
        return jax.vmap(lambda control: score(draws, route, "voi_gap", ControlParams(env, control)))(tried)

    return jax.lax.map(of_seed, draws, batch_size=per_scan)


def ours(inputs: tuple, devices: int, per_scan: int):
    """Compiled call, its arguments in place, and the seconds that compiling took."""
    mesh = Mesh(np.array(jax.devices()[:devices]), ("seed",))
    split, whole = PartitionSpec("seed"), PartitionSpec()
    body = partial(on_one_device, per_scan=per_scan)
    mapped = jax.shard_map(body, mesh=mesh, in_specs=(split, whole, whole, whole), out_specs=split, check_vma=False)
    placed = (
        jax.device_put(inputs[0], NamedSharding(mesh, split)),
        *(jax.device_put(x, NamedSharding(mesh, whole)) for x in inputs[1:]),
    )
    start = time.perf_counter()
    compiled = jax.jit(mapped).lower(*placed).compile()
    return compiled, placed, time.perf_counter() - start


def plain_python(inputs: tuple, lanes: list[tuple[int, int]]) -> tuple[np.ndarray, float]:
    """Mean error and bytes of a few (seed, candidate) in the oracle's loop, and seconds per slot."""
    draws, route, env, tried = inputs
    found, seconds = [], 0.0
    for s, c in lanes:
        one, control = (jax.tree.map(lambda leaf, i=i: leaf[i], tree) for tree, i in ((draws, s), (tried, c)))
        arguments = for_oracle(one, route, ControlParams(env, control))
        start = time.perf_counter()
        result = oracle.replay("voi_gap", *arguments)
        seconds += time.perf_counter() - start
        found.append((result["error"].mean(), result["payload"].sum()))
    return np.array(found), seconds / (len(lanes) * draws.rate_bps.shape[1])


def best_of(work, repeats: int, best: tuple[float, float] = (math.inf, math.inf)) -> tuple[float, float]:
    """Least wall-clock and processor seconds of several calls."""
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        work()
        best = min(best[0], time.perf_counter() - start), min(best[1], time.process_time() - used)
    return best


def check(name: str, mean_m: np.ndarray, sent_bytes: np.ndarray, want: np.ndarray) -> None:
    """Mean error and bytes per replay; rounding may tip a decision on a threshold in a few of thousands."""
    same = np.isclose(mean_m, want[:, 0], rtol=1e-3, atol=1e-3) & (sent_bytes == want[:, 1])
    print(f"  {name}: {same.mean():.2%} of replays equal; mean error {mean_m.mean():.4f} / {want[:, 0].mean():.4f} m")
    if same.mean() < 0.995:
        raise SystemExit(f"{name}: results differ in {np.sum(~same)} replays")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10, help="calls of each by turns, the best counts (default 10)")
    parser.add_argument("--devices", type=int, default=CORES, help="virtual devices (default: cores)")
    parser.add_argument("--per-scan", type=int, default=0, help="seeds per scan and device (default: all)")
    parser.add_argument("--times", type=int, default=1, help="so many times the replays (default 1)")
    parser.add_argument("--slots", type=int, default=SLOTS, help=f"slots of the route (default {SLOTS})")
    return parser.parse_args()


def by_turns(work: dict[str, Callable[[], object]], repeats: int) -> dict[str, tuple[float, float]]:
    """Least wall-clock and processor seconds of each."""
    times = dict.fromkeys(work, (math.inf, math.inf))
    for _ in range(repeats):
        for name, call in work.items():
            times[name] = best_of(call, 1, times[name])
    return times


def main() -> None:
    """Run all and print the ratios."""
    options = arguments()
    jax.config.update("jax_num_cpu_devices", CORES)  # before the first array: each device has its own thread
    devices = math.gcd(options.devices, SEEDS)
    candidates = CANDIDATES * options.times
    inputs = make_inputs(SEEDS, candidates, options.slots)
    count = SEEDS * candidates * options.slots
    print(f"{SEEDS * candidates} replays x {options.slots} slots x {len(ACTIONS)} actions, {CORES} cores, ", end="")
    print(f"load {os.getloadavg()[0]:.1f}, jax {jax.__version__}, numba {numba.__version__}")

    compiled, placed, compile_s = ours(inputs, devices, options.per_scan or SEEDS // devices)
    numba.set_num_threads(min(CORES, numba.config.NUMBA_NUM_THREADS))
    arrays = for_numba(inputs)
    before = hoisted(inputs, arrays)
    work = {
        "ovibjax": lambda: jax.block_until_ready(compiled(*placed)),
        "Numba": lambda: numba_replays(*arrays),
        "hoisted": lambda: numba_hoisted(*before),
    }
    first = {"ovibjax": compile_s}
    for name, call in work.items():
        start = time.perf_counter()
        call()
        first.setdefault(name, time.perf_counter() - start)
    times = by_turns(work, options.repeats)
    result = jax.device_get(compiled(*placed))
    lanes = [(s, c) for s in (0, SEEDS - 1) for c in (0, candidates // 2)]
    slow, python_s = plain_python(inputs, lanes)

    for name, (wall, used) in times.items():
        print(
            f"  {name:8s} {count / wall / 1e6:8.2f} million slot-decisions/s   {wall * 1e3:7.1f} ms, "
            f"{used / count * 1e9:5.1f} ns of processor each   compiling {first[name]:.1f} s"
        )
    print(f"  {'Python':8s} {1e-6 / python_s:8.4f} million slot-decisions/s   from {len(lanes)} replays")
    print(f"  temporary memory {compiled.memory_analysis().temp_size_in_bytes / 1e6:.1f} MB a device")
    mean_m, sent_bytes = result.mean_m.ravel(), result.kb.ravel() * 1024
    check("ovibjax and Numba", mean_m, sent_bytes, arrays[-1][:, [0, 3]])
    check("ovibjax and Numba, hoisted", mean_m, sent_bytes, before[-1][:, [0, 3]])
    rows = [s * candidates + c for s, c in lanes]
    check("ovibjax and Python", mean_m[rows], sent_bytes[rows], slow)
    for name, peer in (("processor_ratio", 1), ("ratio_hoisted", 0), ("ratio_today", 0)):
        other = "hoisted" if name == "ratio_hoisted" else "Numba"
        print(f"{name}: {times[other][peer] / times['ovibjax'][peer]:.2f}")
    print(f"ratio: {times['Numba'][0] / times['ovibjax'][0]:.2f}")


if __name__ == "__main__":
    main()
