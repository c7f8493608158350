"""Press Ctrl-C at random moments of a command, many times, and count the presses that were lost.

    python tests/benchmarks/interrupts.py --presses 200

Every process runs `ovibjax sweep run` on a small file that compiles, computes and writes for as long as it is let; most
presses fall into the seconds of loading and the first compilations, where jax collects garbage most often.
"""

import argparse
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.ctrl_c import press

FILE = """
import jax

axes = {"x": [0.1 * i for i in range(40)], "seed": range(100)}


def member(key, point, shared):
    def step(total, _):
        return total + point["x"] * jax.random.normal(key, (30,)).sum(), None

    return {"total": jax.lax.scan(step, 0.0, length=2_000_000)[0]}
"""


def main() -> int:
    """Press, and print what came of it; 1 where a press was lost."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--presses", type=int, default=200)
    options.add_argument("--within-s", type=float, default=6.0, help="latest press after the start, seconds")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    draw, counts, slow = random.Random(given.seed), Counter[str](), 0.0
    for number in range(given.presses):
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "mine.py").write_text(FILE)
            env = {
                "PYTHONPATH": str(Path(__file__).parents[2]),
                "JAX_COMPILATION_CACHE_DIR": "",
                "PYTHONFAULTHANDLER": "1",
            }
            after_s = draw.uniform(0, given.within_s)
            arguments = ["sweep", "run", "mine.py", "--out", "a.zarr"]
            came = press(arguments, after_s, Path(folder), env, limit_s=120)
        word = "lost" if came.lost() else "clean" if came.clean() else "ended otherwise"
        counts[word] += 1
        slow = max(slow, came.took_s)
        if word != "clean":
            print(f"press {number} after {after_s:.2f} s: {word}, code {came.code}: {came.said[-1500:]}", flush=True)
        if number % 20 == 19:
            print(f"{number + 1} presses: {dict(counts)}, slowest end {slow:.1f} s", flush=True)
    print(
        f"{given.presses} presses within {given.within_s} s: {dict(counts)}; slowest end {slow:.1f} s after the press"
    )
    return int(counts["lost"] > 0)


if __name__ == "__main__":
    sys.exit(main())
