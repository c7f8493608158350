"""Training a grid of encoders: one `sweep.run` against a PyTorch loop over members, in the same run.

    python -m tests.benchmarks.train_sweep            (extra [bench]; a quiet machine; about five minutes)

Same model, objective, optimizer, batch, steps and sampling; both may use every core. The PyTorch loop multiplies
masked views densely, as its users do, and is timed in float32 and under bfloat16 autocast.

2 virtual cores with AVX-512 and AMX (Sapphire Rapids class), Python 3.11, jax 0.10.2, torch 2.13.0, best of three. The
host is shared: the large-product peak moved between 142 and 300 GFLOP/s within hours, and times with it; ratios less.

    float32 product peak 201 GFLOP/s before, 236 after
    small (64 coordinates per view, batch 128), 8 members x 162 steps
      ovibjax float32      259.8 member-steps/s   3.85 ms   57 % of peak useful  loss 0.854 ± 0.092
      PyTorch float32      143.6 member-steps/s   6.96 ms   32 %                 loss 0.845 ± 0.086
      ovibjax bfloat16     432.8 member-steps/s   2.31 ms   95 %                 loss 0.853 ± 0.092
      PyTorch bfloat16     144.7 member-steps/s   6.91 ms   32 %                 loss 0.845 ± 0.086
    large (512 coordinates per view, batch 512), 8 members x 24 steps
      ovibjax float32       24.0 member-steps/s  41.59 ms   77 % of peak useful  loss 3.706 ± 0.120
      PyTorch float32       13.4 member-steps/s  74.60 ms   43 %                 loss 3.671 ± 0.105
      ovibjax bfloat16      43.5 member-steps/s  23.00 ms  139 %                 loss 3.704 ± 0.121
      PyTorch bfloat16      21.2 member-steps/s  47.20 ms   68 %                 loss 3.668 ± 0.106
    against PyTorch float32: small 1.81 (float32), 3.01 (bfloat16); large 1.79 (float32), 3.24 (bfloat16)
    ratio: 1.79  (large, both in float32: the same work; short of the goal of 2.5. bfloat16 is short of the goal of 4)

What was tried for speed, small / large, milliseconds per member-step with two programs at a time on a quiet hour:

    expected                                        measured
    plain fit, optax, iid view modes                3.6 / 54    where this began
    one fused AdamW instead of optax: less traffic  3.5 / -     XLA fuses optax as well; optax stayed
    no optimizer at all (bound)                     3.6 / -     float32 products hide it
    float32, rows of masked views skipped, kernels
      sliced out of one matrix                      4.4 / 41    gradients of slices are padded: 5 ms at the large size
    float32, the same with one kernel per view      4.2 / 37    kept: 35 % of the outer layers' arithmetic saved
    bfloat16 operands, plain gradient products      -           products over dimension 0 leave the fast kernels:
                                                                89 GFLOP/s instead of 600
    the same with the transpose done in blocks      2.2 / 21    three to five times faster products
    with one kernel per view                        2.4 / 15    kept
    no optimizer at all (bound)                     1.6 / -     memory traffic of AdamW is what is left
    wider vectors, other schedulers, single-threaded
      products (XLA flags)                          within noise
    two members vmapped                             no gain; they share no weights, and lose the cache
    two virtual devices instead of two threads      7 to 25 % slower
"""

import argparse
import os
import time
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import torch

from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import TrainConfig, TrainData, fit, view_rows
from ovibjax.sweep.engine import run
from ovibjax.sweep.work import Along
from tests.benchmarks.torch_peer import train_member

AXES = {"beta": [1e-4, 1e-3], "gamma": [0.0, 0.1], "seed": [0, 1]}
FRAMES = 3495
SIZES = {"large": (512, 512), "small": (64, 128)}
"""Coordinates per view and batch: the full dimension, and the per-view basis."""


@dataclass(frozen=True)
class Fit:
    """Member function: train, return the losses of the last epoch."""

    static: TrainConfig

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], data: TrainData) -> dict[str, jax.Array]:
        hypers = make_hypers()._replace(beta=point["beta"], gamma=point["gamma"])
        _, metrics = fit(key, hypers, data, self.static)
        return {name: values[-1] for name, values in metrics.items()}


def synthetic(view_dim: int, seed: int) -> TrainData:
    """Features that are smooth functions of a position, as unit-variance coordinates."""
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(FRAMES, 3))
    waves = np.cos(position @ rng.normal(size=(3, 5 * view_dim)) + rng.uniform(0, 2 * np.pi, 5 * view_dim))
    x = np.sqrt(2) * waves.reshape(FRAMES, 5, view_dim) + 0.1 * rng.normal(size=(FRAMES, 5, view_dim))
    return TrainData(jnp.asarray(x, jnp.float32), jnp.asarray(position, jnp.float32))


def matmul_peak() -> float:
    """FLOP/s of one large float32 product on all cores, the best of several."""
    a = jnp.ones((4096, 4096), jnp.float32)
    product = jax.jit(lambda a: a @ a)
    jax.block_until_ready(product(a))
    seconds = []
    for _ in range(6):
        start = time.perf_counter()
        jax.block_until_ready(product(a))
        seconds.append(time.perf_counter() - start)
    return 2 * 4096**3 / min(seconds)


def useful_flop(static: TrainConfig) -> float:
    """Multiplications and additions of one step that the result needs: masked views and the input's gradient are not.

    A layer costs two operations per weight and row forward, as many for each of its two gradients.
    """
    arch, size = static.arch, static.batch
    shared = size * arch.view_dim * sum(view_rows(static, size)[1]) / size
    first = 2 * 2 * shared * arch.hidden
    views = 3 * 2 * shared * (arch.hidden + arch.head)
    inner = arch.last_hidden * (2 * arch.hidden + 3 * arch.latent)
    return first + views + 3 * 2 * size * (inner + 3 * arch.head)


def members() -> list[tuple[float, float, int]]:
    """Every (beta, gamma, seed)."""
    return [(b, g, s) for s in AXES["seed"] for b in AXES["beta"] for g in AXES["gamma"]]


def compare(name: str, epochs: int, repeats: int, peak: float) -> dict[str, float]:
    """Time all contenders by turns; the best of the repeats counts.

    Compiling is left out: each contender runs once before, and our clock starts when tracing and lowering are done.
    """
    view_dim, batch = SIZES[name]
    steps = FRAMES // batch * epochs
    base = TrainConfig(arch=Architecture(view_dim=view_dim), steps=steps, batch=batch)
    data = [synthetic(view_dim, seed) for seed in AXES["seed"]]
    losses: dict[str, np.ndarray] = {}
    compile_s: dict[str, float] = {}

    def ours(precision: str) -> float:
        reported: list[float] = []
        dataset = run(
            Fit(replace(base, precision=precision)),
            AXES,
            Along("seed", data),
            on_progress=lambda done, total: reported.append(time.perf_counter()),
        )
        losses[f"ovibjax {precision}"] = dataset.loss.values.ravel()
        return reported[-1] - reported[0]

    def theirs(precision: str) -> float:
        found, start = [], time.perf_counter()
        for beta, gamma, seed in members():
            x, y = (np.asarray(array) for array in data[AXES["seed"].index(seed)])
            hypers = {"alpha": 1.0, "beta": beta, "gamma": gamma, "lr": 2e-3, "weight_decay": 1e-4}
            found.append(train_member(seed, hypers, x, y, base, bfloat16=precision == "bfloat16")["loss"])
        losses[f"PyTorch {precision}"] = np.array(found)
        return time.perf_counter() - start

    contenders = {
        f"{who} {precision}": (lambda work=work, precision=precision: work(precision))
        for precision in ("float32", "bfloat16")
        for who, work in (("ovibjax", ours), ("PyTorch", theirs))
    }
    for label, work in contenders.items():
        start = time.perf_counter()
        work()
        compile_s[label] = time.perf_counter() - start
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(repeats):
        for label, work in contenders.items():
            best[label] = min(best[label], work())
    count = len(members()) * steps
    print(f"\n{name}: {view_dim} coordinates per view, batch {batch}, {len(members())} members x {steps} steps")
    for label, seconds in best.items():
        share = count * useful_flop(base) / seconds / peak
        loss = losses[label]
        extra = f"first run {compile_s[label]:5.1f} s" if label.startswith("ovibjax") else ""
        print(
            f"  {label:18s} {count / seconds:7.1f} member-steps/s  {1e3 * seconds / count:6.2f} ms  "
            f"{100 * share:3.0f} % of peak useful  loss {loss.mean():.4f} ± {loss.std(ddof=1):.4f}  {extra}"
        )
    return best


def main() -> None:
    """Run both sizes and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=6, help="epochs per member (default 6)")
    parser.add_argument("--repeats", type=int, default=3, help="repetitions, the best counts (default 3)")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of PyTorch (default: cores)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    peak = matmul_peak()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    print(f"{jax.devices()[0].device_kind}, {os.cpu_count()} cores, load {load:.1f}, jax {jax.__version__}, ", end="")
    print(f"torch {torch.__version__}, float32 product peak {peak / 1e9:.0f} GFLOP/s")
    found = {
        "small": compare("small", options.epochs, options.repeats, peak),
        "large": compare("large", max(1, options.epochs - 2), options.repeats, peak),
    }
    peak_after = matmul_peak()
    print(f"\nfloat32 product peak afterwards {peak_after / 1e9:.0f} GFLOP/s")
    for name, best in found.items():
        for precision in ("float32", "bfloat16"):
            against = best[f"PyTorch {precision}"] / best[f"ovibjax {precision}"]
            loop = best["PyTorch float32"] / best[f"ovibjax {precision}"]
            print(f"{name} {precision}: {against:.2f} against PyTorch {precision}, {loop:.2f} against PyTorch float32")
    print(f"ratio: {found['large']['PyTorch float32'] / found['large']['ovibjax float32']:.2f}")


if __name__ == "__main__":
    main()
