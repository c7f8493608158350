"""Coding prefixes: exact arithmetic coding in Python's integers against the range coder of `constriction` (Rust).

python tests/benchmarks/codes.py              (extra [bench]; a quiet machine; about ten seconds)

Codes of 128 coordinates whose deviations fall from 6 to 0.2, steps of 0.5, tables fitted on 3,500 of them; one core. A
code is coded and decoded by itself, as a robot and an edge do. `constriction` is given what it is fastest with: all
coordinates in one call, a Gaussian each. Its streams are whole words of four bytes; ours end where they may. Mean
bytes, the same on any machine:

    k                     8      16      35     128
    ideal by our table   4.30    7.36   13.11   29.36
    ovibjax              4.60    7.68   13.41   29.68
    constriction         7.58    8.43   15.89   32.02
    zlib of int8        16.01   24.50   38.33   68.10

Microseconds for coding and decoding, one core of a Xeon with AMX, best of 10 (goal: below 200):

    ovibjax               22      29      45     156
    constriction         3.7     5.1     8.9    25.8

`constriction` is faster five times over; at 8 coordinates its words cost three bytes of eight, which is why it is not
what robots send. At 128 coordinates ours is close to the goal: in the `full` run of the figure of real bytes, on the
same busy processor, the median was 452.
"""

import argparse
import sys
import time
import zlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import constriction
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import numbers_of
from ovibjax.link.codes.tables import fit_table

STEP = 0.5
PREFIXES, K, TRAINING, FRAMES = (8, 16, 35, 128), 128, 3500, 500
queue = constriction.stream.queue


def made_codes(n: int, seed: int) -> np.ndarray:
    """[n, K] codes as a nested encoder makes them."""
    return (np.random.default_rng(seed).normal(size=(n, K)) * 6 * np.arange(1, K + 1) ** -0.7).astype(np.float32)


def peer(numbers: np.ndarray, mean: np.ndarray, width: np.ndarray, model: object) -> tuple[list[np.ndarray], Callable]:
    """Streams of `constriction` and what decodes one."""

    def coded(row: np.ndarray) -> np.ndarray:
        encoder = queue.RangeEncoder()
        encoder.encode(row, model, mean, width)
        return encoder.get_compressed()

    return [coded(row) for row in numbers], lambda words: queue.RangeDecoder(words).decode(model, mean, width)


def seconds(work: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def compare(k: int, repeats: int) -> float:
    """Print sizes and times at one prefix length; returns how many times as long `constriction` takes."""
    training, frames = made_codes(TRAINING, 0), made_codes(FRAMES, 1)[:, :k]
    coder = Coder("entropy", fit_table("entropy", training, STEP))
    assert coder.table is not None
    numbers = numbers_of(coder.table.grid, frames).astype(np.int32)
    seen = numbers_of(coder.table.grid, training)[:, :k]
    mean, width = seen.mean(axis=0), np.sqrt(seen.var(axis=0) + 1 / 12)
    model = constriction.stream.model.QuantizedGaussian(int(seen.min()) - 50, int(seen.max()) + 50)
    streams = [coder.encode(frame) for frame in frames]
    words, read = peer(numbers, mean, width, model)
    assert all((read(w) == row).all() for w, row in zip(words, numbers, strict=True))
    work = {
        "ovibjax encode": lambda: [coder.encode(frame) for frame in frames],
        "ovibjax decode": lambda: [coder.decode(data, k) for data in streams],
        "constriction encode": lambda: peer(numbers, mean, width, model),
        "constriction decode": lambda: [read(w) for w in words],
    }
    best = dict.fromkeys(work, float("inf"))
    for _ in range(repeats):
        for name, call in work.items():
            best[name] = min(best[name], seconds(call) / FRAMES * 1e6)
    sizes = {
        "ideal": np.mean([coder.ideal_bits(frame) for frame in frames]) / 8,
        "ovibjax": np.mean([len(data) for data in streams]),
        "constriction": np.mean([4 * len(w) for w in words]),
        "zlib of bytes": np.mean([len(zlib.compress(row.astype(np.int8).tobytes(), 9)) for row in numbers]),
    }
    print(f"k = {k:3d}   bytes: {', '.join(f'{name} {size:.2f}' for name, size in sizes.items())}")
    print(f"          microseconds: {', '.join(f'{name} {time_us:.1f}' for name, time_us in best.items())}")
    ours, theirs = (sum(t for name, t in best.items() if name.startswith(who)) for who in ("ovibjax", "constriction"))
    print(f"          coding and decoding: {ours:.1f} us (goal: below 200)")
    return theirs / ours


def main() -> None:
    """Compare at every prefix length; the ratio is that of the paper's 35 coordinates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10, help="calls of each by turns, the best counts (default 10)")
    repeats = parser.parse_args().repeats
    print(f"step {STEP}, constriction {version('constriction')}, numpy {np.__version__}")
    ratios = {k: compare(k, repeats) for k in PREFIXES}
    print("  ".join(f"ratio_{k}: {ratio:.2f}" for k, ratio in ratios.items()))
    print(f"ratio: {ratios[35]:.2f}")


if __name__ == "__main__":
    main()
