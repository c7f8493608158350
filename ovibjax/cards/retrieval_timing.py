"""How long a search takes: one query or a batch at the benchmark's size, and as the database grows."""

import time
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.cards.retrieval_benchmark import Benchmark, Point
from ovibjax.cards.synthetic_database import recombine
from ovibjax.edge.index import build_index
from ovibjax.edge.retrieval import brute_force, coarse_to_fine

_brute_force = jax.jit(brute_force)


def time_search(
    benchmark: Benchmark, seed: int, queries: int, k: int, point: Point, repeats: int
) -> dict[str, list[float]]:
    """Milliseconds per query on this machine, one query at a time and all in one batch, after warming up.

    Args:
        benchmark: the frames.
        seed: the draw.
        queries: how many.
        k: prefix length of the coded queries.
        point: scenes kept, tiles kept, tile edge.
        repeats: measurements, by turns.

    Returns:
        Measurements of "brute_1", "fine_1", "brute_all", "fine_all".
    """
    asked, kept = benchmark.draw(seed, queries)
    scenes, tiles, tile_m = point
    reference = jnp.asarray(benchmark.descriptor[kept])
    index = build_index(benchmark.descriptor[kept], benchmark.position_m[kept], benchmark.scene[kept], tile_m)
    batch = benchmark.coded[k][asked]
    brute = partial(_brute_force, db=reference)
    fine = partial(coarse_to_fine, index=index, scenes=scenes, tiles=tiles)
    work = {"brute_1": (brute, batch[:1]), "fine_1": (fine, batch[:1]), "brute_all": (brute, batch)}
    return _by_turns({**work, "fine_all": (fine, batch)}, repeats)


def time_growth(
    benchmark: Benchmark,
    sizes: Sequence[int],
    queries: int,
    tiles: int,
    tile_m: float,
    repeats: int,
    on_sizes: Callable[[int, int], None],
) -> list[dict[str, float]]:
    """Milliseconds per query as the database grows, on recombined drives.

    Args:
        benchmark: the frames; at least two scenes, or one that is cut in two.
        sizes: descriptors.
        queries: queries in a batch.
        tiles: tile prototypes kept.
        tile_m: edge of a tile.
        repeats: measurements; the least counts.
        on_sizes: called with (done, total) as sizes are timed.

    Returns:
        One row per size: "brute", "fine_2" with two scenes kept, "fine_all" with all, and "recall", the share of
        queries for which the latter finds the exhaustive answer.
    """
    drives = benchmark.views
    places = [benchmark.position_m[benchmark.scene == s] for s in range(len(drives))]
    rows = []
    for done, n in enumerate(sizes, start=1):
        data = recombine(0, drives, places, n, queries)
        reference = jnp.asarray(data.reference)
        index = build_index(data.reference, data.position_m, data.scene, tile_m)
        every = index.scene_prototype.shape[0]
        brute = partial(_brute_force, db=reference)
        two, full = (partial(coarse_to_fine, index=index, scenes=scenes, tiles=tiles) for scenes in (2, every))
        times = _by_turns(
            {"brute": (brute, data.query), "fine_2": (two, data.query), "fine_all": (full, data.query)}, repeats
        )
        row = {name: min(values) for name, values in times.items()}
        recall = float(np.mean(np.asarray(full(jnp.asarray(data.query))) == np.asarray(brute(data.query))))
        rows.append({"n": float(n), **row, "recall": recall})
        on_sizes(done, len(sizes))
    return rows


def _by_turns(work: dict[str, tuple[Callable[..., jax.Array], np.ndarray]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds per query of each contender, by turns, so that a busy moment falls on all."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for turn in range(repeats + 1):
        for name, (run, batch) in work.items():
            start = time.perf_counter()
            jax.block_until_ready(run(batch))
            if turn:
                times[name].append(1e3 * (time.perf_counter() - start) / len(batch))
    return times
