"""What a store costs: beside computing, and when it is opened.

    python -m tests.benchmarks.sweep_store            (a quiet machine; some three minutes on two cores)

1,000 members of about 50 ms in memory and into a store, by turns; then stores of 20,000 members, in 100 files and in
20,000 (as of members that take seconds each), opened and asked for what is missing.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.sweep.arrange import coordinates_of
from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import make_grid
from ovibjax.sweep.layout import Variable, layout_of
from ovibjax.sweep.members import rows_of
from ovibjax.sweep.store import Store

OUTPUTS = 20
"""Numbers that a member gives, as a trained encoder that is judged at a few prefixes."""


def member(key, point, shared):
    """A recursion of so many steps."""
    w = jax.lax.fori_loop(0, shared, lambda i, w: jnp.tanh(point["rate"] * w + 0.1), jnp.ones((64, 8)))
    return {"metrics": w.ravel()[:OUTPUTS], "loss": w.sum()}


def seconds(steps: int, members: int, store: Path | None) -> float:
    """Seconds of one sweep after lowering and compiling."""
    reported: list[float] = []
    axes = {"rate": np.linspace(0.1, 0.9, members // 10).tolist(), "seed": list(range(10))}
    run(
        member,
        axes,
        np.int32(steps),
        store=store,
        lanes=1,
        on_progress=lambda done, total: reported.append(time.perf_counter()),
    )
    return time.perf_counter() - reported[0]


def overhead(members: int, member_s: float, repeats: int) -> None:
    """Compare a sweep in memory with one into a store."""
    steps = 20_000
    seconds(steps, 20, None)
    steps = int(steps * member_s * 20 / (seconds(steps, 20, None) * os.cpu_count()))
    with tempfile.TemporaryDirectory() as folder:
        alone, stored = [], []
        for i in range(repeats):
            alone.append(seconds(steps, members, None))
            stored.append(seconds(steps, members, Path(folder) / f"{i}.zarr"))
        files = len(list((Path(folder) / "0.zarr" / "members").iterdir()))
    each = 1e3 * min(alone) * os.cpu_count() / members
    print(f"{members} members of {each:.0f} ms on {os.cpu_count()} cores: in memory {rounded(alone)} s, ", end="")
    ratio = statistics.median(stored) / statistics.median(alone)
    print(f"into a store {rounded(stored)} s, in {files} files: {100 * (ratio - 1):+.1f} % (medians)", flush=True)


def rounded(values: list[float]) -> str:
    """Values side by side."""
    return " ".join(f"{value:.2f}" for value in values)


OPEN = """
import sys, time
from ovibjax.sweep.store import open_dataset
start = time.perf_counter()
dataset = open_dataset(sys.argv[1])
print(time.perf_counter() - start, int(dataset.finished.sum()))
"""


def opening(members: int, blocks: int) -> None:
    """Make a store of so many members and open it, in a process of its own and here."""
    grid = make_grid({"beta": np.geomspace(1e-5, 1, members // 20).tolist(), "seed": range(20)})
    variables = {f"metric_{i}": Variable((4,), np.dtype("float32"), ("prefix",)) for i in range(OUTPUTS)}
    values = {name: np.random.default_rng(0).normal(size=(members, 4)).astype(np.float32) for name in variables}
    config = {"settings": {}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.zarr"
        layout = layout_of(grid, variables, coordinates_of({"prefix": [8, 16, 35, 128]}))
        for part in np.array_split(np.arange(members), blocks):
            rows = rows_of(grid, part, [bytes(16)] * len(part), {n: v[part] for n, v in values.items()}, part < 0)
            if part[0] == 0:
                Store.open(path, layout, config).close()
            write_unsynced(path, rows)
        said = subprocess.run([sys.executable, "-c", OPEN, path], capture_output=True, text=True, check=True).stdout
        start = time.perf_counter()
        with Store.open(path, layout, config) as store:
            missing = len(store.missing(grid, [bytes(16)] * members))
            store.dataset(grid)
        taken = time.perf_counter() - start
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "ovibjax", "show", path], capture_output=True, check=True)
        shown = time.perf_counter() - start
    first, found = said.split()
    print(f"{members} members in {blocks} files: open_dataset {float(first):.2f} s ({found} found), ", end="")
    print(f"a command that lacks {missing} {taken:.2f} s, `ovibjax show` {shown:.2f} s", flush=True)


def write_unsynced(path: Path, rows: np.ndarray) -> None:
    """A block, without waiting for the disk 20,000 times."""
    from unittest.mock import patch

    from ovibjax.sweep.blocks import write_block

    with patch.object(os, "fsync", lambda descriptor: None):
        write_block(path / "members", rows)


def main() -> None:
    """Run all and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, default=1000, help="members of the overhead's sweeps (default 1000)")
    parser.add_argument("--repeats", type=int, default=3, help="repetitions (default 3)")
    options = parser.parse_args()
    overhead(options.members, 0.05, options.repeats)
    for blocks in (100, 20_000):
        opening(20_000, blocks)


if __name__ == "__main__":
    main()
