"""The retrieval study: a grid of scenes, tiles and tile edges judged on draws of queries, an operating point, times."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from ovibjax.cards.job import Job
from ovibjax.cards.raw_images import raw_payload_bytes
from ovibjax.cards.retrieval_benchmark import RAW, TILE_M, Benchmark, Point, five_towns, judge_draw, make_benchmark
from ovibjax.cards.retrieval_timing import time_growth, time_search
from ovibjax.edge.pruning import Pruning
from ovibjax.errors import InputError
from ovibjax.features.frames import FeatureSet
from ovibjax.report.claims import interval
from ovibjax.runtime.progress import console, progress_bar

SCENES, TILES = 2, 12
"""The paper's numbers of scenes and tiles kept."""
TILE_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
PREFIX = 35
PREFIXES = (16, 35, 128, RAW)
PRUNED, RECALL = 0.90, 0.98
"""What is asked of an operating point: share of descriptors pruned, and recall of the right tile."""
RAW_FRAMES = 2  # frames of each town that are stored as image files
COLUMNS = ("pruned", "scene_hit", "tile_hit", "error_m", "brute_m", "error_hit_m", "brute_hit_m", "wrong_scene", "same")
MIN_SCENE_FRAMES = 20


@dataclass(frozen=True)
class StudySize:
    """How much is run.

    Attributes:
        towns: embedded towns.
        frames: frames of all of them.
        queries: queries of a draw.
        tuning: draws that choose the operating point, seeds 0, 1, ...
        draws: held-out draws.
        steps: training steps of the code.
        edges: tile edges swept, m; `TILE_M` among them.
        sizes: database sizes timed.
        repeats: measurements of a time.
    """

    towns: int
    frames: int
    queries: int
    tuning: int
    draws: int
    steps: int
    edges: tuple[float, ...]
    sizes: tuple[int, ...]
    repeats: int


@dataclass(frozen=True)
class RetrievalStudy:
    """Results.

    Attributes:
        seeds: held-out draws.
        n_scenes: scenes of the data.
        grid: per tile edge, outcomes [draw, scenes, tiles] on the held-out draws, at the headline prefix.
        paper: the paper's numbers of scenes and tiles, and tiles of the size that these imply.
        chosen: the operating point that tuning chose.
        by_prefix: outcomes [draw] at the chosen point per prefix length.
        times: milliseconds per query on this machine at the chosen point.
        growth: one row per database size.
        raw_bytes: bytes of frames as image files; none of data without images.
    """

    seeds: list[int]
    n_scenes: int
    grid: dict[float, Pruning]
    paper: Point
    chosen: Point
    by_prefix: dict[int, Pruning]
    times: dict[str, list[float]]
    growth: list[dict[str, float]]
    raw_bytes: np.ndarray

    def at(self, point: Point, name: str) -> np.ndarray:
        """[draws] a measure at a grid point."""
        scenes, tiles, edge = point
        return np.asarray(getattr(self.grid[edge], name))[:, scenes - 1, TILE_COUNTS.index(tiles)]

    def median_ms(self, name: str) -> float:
        """Median of a time."""
        return float(np.median(self.times[name]))

    def slope(self, name: str) -> float:
        """Exponent of the database's size in a time."""
        n = np.log([row["n"] for row in self.growth])
        return float(np.polyfit(n, np.log([row[name] for row in self.growth]), 1)[0])


def measure(job: Job, size: StudySize) -> RetrievalStudy:
    """Tuning draws choose the operating point, held-out draws judge the grid, the search is timed.

    Args:
        job: the data and the first held-out seed.
        size: how much is run.

    Returns:
        The study.

    Raises:
        InputError: a scene of somebody's data has fewer than 20 frames.
    """
    features, n_scenes = _scenes(job, size)
    paper = Point(min(SCENES, n_scenes), TILES, TILE_M)
    queries = min(size.queries, len(features.features) // 10)
    with job.stage("train"), console.status("training the code"):
        benchmark = make_benchmark(features, PREFIXES, job.rank, size.steps)
    tuning, seeds = list(range(size.tuning)), [job.seed + i for i in range(size.draws)]
    with job.stage("judge"):
        tuned, grid = _judge_grid(benchmark, queries, n_scenes, size.edges, (tuning, seeds))
        chosen = choose(tuned, range(1, n_scenes + 1), TILE_COUNTS)
        by_prefix = {k: _at_prefix(benchmark, seeds, queries, k, chosen) for k in PREFIXES}
    with job.stage("time"), console.status("timing the search"):
        times = time_search(benchmark, seeds[0], queries, PREFIX, chosen, 20 * size.repeats)
    with job.stage("time"), progress_bar("timing larger databases", len(size.sizes)) as update:
        batch = min(64, queries)
        growth = time_growth(benchmark, size.sizes, batch, TILES, TILE_M, size.repeats, update)
    with job.stage("render"):
        raw = raw_payload_bytes(size.towns if job.own_features is None else 0, RAW_FRAMES)
    return RetrievalStudy(seeds, n_scenes, grid, paper, chosen, by_prefix, times, growth, raw)


def _scenes(job: Job, size: StudySize) -> tuple[FeatureSet, int]:
    """Somebody's scenes or the embedded towns, and how many there are."""
    features = job.own_features
    if features is None:
        bar = progress_bar(f"rendering {size.frames} frames of {size.towns} towns", size.frames)
        with job.stage("render"), bar as update:
            features = five_towns(size.frames, size.towns, update)
    counts = np.unique(features.scene_id, return_counts=True)[1]
    if counts.min() < MIN_SCENE_FRAMES:
        raise InputError(f"{job.source}: a scene has {counts.min()} frames; give every scene_id {MIN_SCENE_FRAMES}")
    return features, len(counts)


def _judge_grid(
    benchmark: Benchmark, queries: int, n_scenes: int, edges: Sequence[float], parts: Sequence[Sequence[int]]
) -> list[dict[float, Pruning]]:
    """Per part of the seeds, outcomes [draw, scenes, tiles] by tile edge, at the headline prefix."""
    draws = [(part, edge, seed) for part, seeds in enumerate(parts) for edge in edges for seed in seeds]
    found: list[dict[float, list[Pruning]]] = [{edge: [] for edge in edges} for _ in parts]
    with progress_bar("draws of queries", len(draws)) as update:
        for done, (part, edge, seed) in enumerate(draws, start=1):
            scenes = range(1, n_scenes + 1)
            found[part][edge].append(judge_draw(benchmark, seed, queries, PREFIX, edge, scenes, TILE_COUNTS))
            update(done)
    return [{edge: jax.tree.map(lambda *rows: np.stack(rows), *of) for edge, of in part.items()} for part in found]


def choose(tuned: dict[float, Pruning], scenes: Sequence[int], tiles: Sequence[int]) -> Point:
    """Of the points that reach the recall on tuning draws, the one that prunes most; else the one with most recall.

    Args:
        tuned: outcomes [draw, scenes, tiles] by tile edge.
        scenes: scenes kept, to choose from.
        tiles: tiles kept, to choose from.

    Returns:
        The operating point.
    """
    points = [Point(s, t, edge) for edge in tuned for s in scenes for t in tiles]

    def mean(point: Point, name: str) -> float:
        values = np.asarray(getattr(tuned[point.tile_m], name))
        return float(values[:, point.scenes - 1, TILE_COUNTS.index(point.tiles)].mean())

    enough = [point for point in points if mean(point, "tile_hit") >= RECALL]
    if enough:
        return max(enough, key=lambda point: mean(point, "pruned"))
    return max(points, key=lambda point: mean(point, "tile_hit"))


def _at_prefix(benchmark: Benchmark, seeds: Sequence[int], queries: int, k: int, at: Point) -> Pruning:
    rows = [judge_draw(benchmark, seed, queries, k, at.tile_m, [at.scenes], [at.tiles]) for seed in seeds]
    return jax.tree.map(lambda *draws: np.stack(draws)[:, 0, 0], *rows)


def table_rows(found: RetrievalStudy) -> list[dict[str, Any]]:
    """One row per grid point: means over the held-out draws, and half-widths of their 95 % intervals."""
    rows: list[dict[str, Any]] = []
    for edge in found.grid:
        for scenes in range(1, found.n_scenes + 1):
            for tiles in TILE_COUNTS:
                row: dict[str, Any] = {"tile_m": edge, "scenes": scenes, "tiles": tiles, "k": PREFIX}
                for name in COLUMNS:
                    span = interval(found.at(Point(scenes, tiles, edge), name))
                    row |= {name: span.mean, f"{name}_half": span.half}
                rows.append(row)
    return rows
