"""Fig. "Coarse-to-fine retrieval on the sampled multi-scene benchmark": what prototypes prune, and what that costs."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.cards.retrieval_study import (
    FRAMES,
    QUERIES,
    RAW,
    World,
    five_towns,
    judge_draw,
    make_world,
    time_growth,
    time_search,
)
from ovibjax.edge.pruning import Pruning
from ovibjax.errors import InputError
from ovibjax.report import figures as fig
from ovibjax.report.claims import REPORTED, Claim, Interval, above, below, interval, positive, weakest, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import console, progress_bar

TITLE = "Coarse-to-fine retrieval on the sampled multi-scene benchmark"
SCENES, TILES = 2, 12
TILE_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
PREFIX = 35
PREFIXES = (16, 35, 128, RAW)
PRUNED, RECALL = 0.90, 0.98
SAME_M = 0.1
GROWTH_TILE_M = 30.0
COLUMNS = ("pruned", "scene_hit", "tile_hit", "error_m", "brute_m", "error_hit_m", "brute_hit_m", "wrong_scene", "same")
MIN_SCENE_FRAMES = 20
# The paper's numbers, paper-values.toml [retrieval].
PAPER = {"raw_ms": 3590.0, "brute_ms": 5.75, "fine_ms": 4.21, "pruned": 0.933, "scene": 0.985, "tile": 0.985}
PAPER_M = {"brute": 2.60, "fine": 6.52, "hit": 2.60}


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        towns: embedded towns.
        frames: frames of all of them.
        queries: queries of a draw.
        tuning: draws that choose the operating point, seeds 0, 1, ...
        draws: held-out draws.
        steps: training steps of the code.
        edges: tile edges swept, m.
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


PRESETS = {
    "smoke": Preset(2, 240, 24, 1, 2, 60, (10.0, 30.0), (1_000, 2_000), 1),
    "quick": Preset(5, FRAMES, QUERIES, 2, 5, 2000, (5.0, 10.0, 20.0, 30.0), (5_000, 20_000, 100_000), 3),
    "full": Preset(
        5, FRAMES, QUERIES, 5, 20, 4000, (5.0, 7.5, 10.0, 15.0, 20.0, 30.0), (5_000, 30_000, 200_000, 1_000_000), 3
    ),
}

Point = tuple[int, int, float]
"""Scenes kept, tiles kept, tile edge."""


@dataclass(frozen=True)
class Found:
    """Results.

    Attributes:
        seeds: held-out draws.
        n_scenes: scenes of the data.
        grid: per tile edge, outcomes [draw, scenes, tiles] on the held-out draws, at the headline prefix.
        paper: the paper's numbers of scenes and tiles at the edge that tuning chose for them.
        chosen: the operating point that tuning chose.
        by_prefix: outcomes [draw] at the chosen point per prefix length.
        times: milliseconds per query on this machine at the chosen point.
        growth: one row per database size.
    """

    seeds: list[int]
    n_scenes: int
    grid: dict[float, Pruning]
    paper: Point
    chosen: Point
    by_prefix: dict[int, Pruning]
    times: dict[str, list[float]]
    growth: list[dict[str, float]]

    def at(self, point: Point, name: str) -> np.ndarray:
        """[draws] a measure at a grid point."""
        scenes, tiles, edge = point
        return np.asarray(getattr(self.grid[edge], name))[:, scenes - 1, TILE_COUNTS.index(tiles)]

    def slope(self, name: str) -> float:
        """Exponent of the database's size in a time."""
        n = np.log([row["n"] for row in self.growth])
        return float(np.polyfit(n, np.log([row[name] for row in self.growth]), 1)[0])


def run(job: Job) -> None:
    """Run the card: render, train, sweep, time, tables, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    found = measure(job, preset)
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "growth.csv", found.growth)
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    job.record(TITLE, caption(found), found.seeds, started, chosen=list(found.chosen), scenes=found.n_scenes)


def measure(job: Job, preset: Preset) -> Found:
    """Tuning draws choose the operating point, held-out draws judge the grid, the search is timed."""
    features = job.own_features
    if features is None:
        with progress_bar(f"rendering {preset.frames} frames of {preset.towns} towns", preset.frames) as update:
            features = five_towns(preset.frames, preset.towns, update)
    counts = np.unique(features.scene_id, return_counts=True)[1]
    if counts.min() < MIN_SCENE_FRAMES:
        raise InputError(f"{job.source}: a scene has {counts.min()} frames; give every scene_id {MIN_SCENE_FRAMES}")
    queries = min(preset.queries, len(features.features) // 10)
    with console.status("training the code"):
        world = make_world(features, PREFIXES, job.rank, preset.steps)
    n_scenes = len(counts)
    tuning, seeds = list(range(preset.tuning)), [job.seed + i for i in range(preset.draws)]
    with progress_bar("draws of queries", len(preset.edges) * (len(tuning) + len(seeds))) as update:
        done = 0

        def over(seeds: Sequence[int], edge: float) -> Pruning:
            nonlocal done
            rows = []
            for seed in seeds:
                rows.append(judge_draw(world, seed, queries, PREFIX, edge, range(1, n_scenes + 1), TILE_COUNTS))
                done += 1
                update(done, len(preset.edges) * (preset.tuning + preset.draws))
            return jax.tree.map(lambda *draws: np.stack(draws), *rows)

        tuned = {edge: over(tuning, edge) for edge in preset.edges}
        grid = {edge: over(seeds, edge) for edge in preset.edges}
    paper = choose(tuned, [min(SCENES, n_scenes)], [TILES])
    chosen = choose(tuned, range(1, n_scenes + 1), TILE_COUNTS)
    by_prefix = {k: _at_prefix(world, seeds, queries, k, chosen) for k in PREFIXES}
    with console.status("timing the search"):
        times = time_search(world, seeds[0], queries, PREFIX, chosen, 20 * preset.repeats)
    with progress_bar("timing larger databases", len(preset.sizes)) as update:
        ticks = iter(range(1, len(preset.sizes) + 1))
        growth = time_growth(
            *(world, preset.sizes, min(64, queries), TILES, GROWTH_TILE_M, preset.repeats),
            lambda: update(next(ticks), len(preset.sizes)),
        )
    return Found(seeds, n_scenes, grid, paper, chosen, by_prefix, times, growth)


def choose(tuned: dict[float, Pruning], scenes: Sequence[int], tiles: Sequence[int]) -> Point:
    """Of the points that reach the recall on tuning draws, the one that prunes most; else the one with most recall."""
    points = [(s, t, edge) for edge in tuned for s in scenes for t in tiles]

    def mean(point: Point, name: str) -> float:
        values = np.asarray(getattr(tuned[point[2]], name))
        return float(values[:, point[0] - 1, TILE_COUNTS.index(point[1])].mean())

    enough = [point for point in points if mean(point, "tile_hit") >= RECALL]
    if enough:
        return max(enough, key=lambda point: mean(point, "pruned"))
    return max(points, key=lambda point: mean(point, "tile_hit"))


def _at_prefix(world: World, seeds: Sequence[int], queries: int, k: int, point: Point) -> Pruning:
    rows = [judge_draw(world, seed, queries, k, point[2], [point[0]], [point[1]]) for seed in seeds]
    return jax.tree.map(lambda *draws: np.stack(draws)[:, 0, 0], *rows)


def table_rows(found: Found) -> list[dict[str, Any]]:
    """One row per grid point: means over the held-out draws, and half-widths of their 95 % intervals."""
    rows: list[dict[str, Any]] = []
    for edge in found.grid:
        for scenes in range(1, found.n_scenes + 1):
            for tiles in TILE_COUNTS:
                row: dict[str, Any] = {"tile_m": edge, "scenes": scenes, "tiles": tiles, "k": PREFIX}
                for name in COLUMNS:
                    span = interval(found.at((scenes, tiles, edge), name))
                    row |= {name: span.mean, f"{name}_half": span.half}
                rows.append(row)
    return rows


def _text(point: Point) -> str:
    return f"{point[0]} scenes, {point[1]} tiles of {point[2]:g} m"


def judge_claims(found: Found) -> list[Claim]:
    """The paper's statements at its own numbers of scenes and tiles, and at the point that tuning chose."""
    claims = []
    for name, point in (("the paper's", found.paper), ("the selected", found.chosen)):
        pruned, hit, scene = (interval(found.at(point, m)) for m in ("pruned", "tile_hit", "scene_hit"))
        claims += [
            Claim(
                f"At {name} numbers of scenes and tiles, at least 90 % is pruned at 98 % tile recall",
                "93.3 % pruned, tile top-12 recall 98.5 %",
                f"{_text(point)}: {_percent(pruned)} pruned, tile recall {_percent(hit)}, scene kept {_percent(scene)}",
                weakest([above(pruned, PRUNED), above(hit, RECALL)]),
                "intervals of the pruned share above 90 % and of the tile recall above 98 %",
            ),
            _equal_claim(found, name, point),
            _excess_claim(found, name, point),
        ]
    scene = interval(found.at((min(SCENES, found.n_scenes), TILES, found.paper[2]), "scene_hit"))
    claims.append(
        Claim(
            "The scene is among the top two scene prototypes",
            "98.5 %",
            _percent(scene),
            above(scene, RECALL),
            "interval above 98 %",
        )
    )
    times = {name: float(np.median(values)) for name, values in found.times.items()}
    claims.append(
        Claim(
            "Coarse-to-fine retrieval takes less time than brute force",
            "4.21 ms against 5.75 ms (Jetson Orin NX)",
            f"{times['fine_1']:.2f} ms against {times['brute_1']:.2f} ms for one query, {times['fine_all']:.3f} and "
            f"{times['brute_all']:.3f} ms per query in one batch, median",
            REPORTED,
            "times of one machine",
        )
    )
    first, last = found.growth[0], found.growth[-1]
    claims.append(
        Claim(
            "Fine search costs O(N_tile) instead of O(N)",
            "-",
            f"time grows as N^{found.slope('brute'):.2f} (brute force), N^{found.slope('fine_2'):.2f} (2 scenes kept), "
            f"N^{found.slope('fine_all'):.2f} (all scenes) from N = {first['n']:,.0f} to {last['n']:,.0f}; there "
            f"{last['brute']:.3g}, {last['fine_2']:.3g} and {last['fine_all']:.3g} ms per query",
            REPORTED,
            "slopes of a log-log fit",
        )
    )
    return claims


def _equal_claim(found: Found, name: str, point: Point) -> Claim:
    ours, brute = (found.at(point, m) for m in ("error_hit_m", "brute_hit_m"))
    difference = interval(ours - brute)
    return Claim(
        f"At {name} numbers, both methods have the same error given the right tile",
        "2.60 m and 2.60 m",
        f"{interval(ours).text('m')} and {interval(brute).text('m')}, difference {difference.text('m', 3)}",
        weakest([below(difference, SAME_M), above(difference, -SAME_M)]),
        f"interval of the paired difference within {SAME_M:g} m of zero",
    )


def _excess_claim(found: Found, name: str, point: Point) -> Claim:
    ours, brute, kept = (found.at(point, m) for m in ("error_m", "brute_m", "kept_excess_m"))
    excess, rest = interval(ours - brute), interval(kept)
    return Claim(
        f"At {name} numbers, the all-query error is above brute force by the coarse misses and no more",
        "6.52 m against 2.60 m, six misses of 400",
        f"{interval(ours).text('m')} against {interval(brute).text('m')}: {excess.text('m', 3)} more, of which queries "
        f"with the right tile kept contribute {rest.text('m', 3)}; another scene is answered to "
        f"{_percent(interval(found.at(point, 'wrong_scene')))}",
        weakest([positive(excess), below(rest, SAME_M), above(rest, -SAME_M)]),
        f"interval of the excess above zero, that of the part without misses within {SAME_M:g} m of zero",
    )


def _percent(share: Interval) -> str:
    return Interval(100 * share.mean, 100 * share.half).text("%", 1)


def caption(found: Found) -> str:
    """What the reader of the figure needs to know."""
    part = found.grid[found.chosen[2]]
    floor = interval(np.asarray(part.floor_m)[:, 0, 0])
    return (
        f"Queries pass through a label-free code (k = {PREFIX} unless said), the database is uncompressed; queries "
        f"are drawn from a pool that the code was not trained on, {floor.text('m')} from the nearest reference. Mean "
        f"and 95 % interval over {len(found.seeds)} draws. Paper's point: {_text(found.paper)}; selected on tuning "
        f"draws: {_text(found.chosen)}. (a) Latency after warming up, one query at a time; paper: Jetson, and raw "
        "images over 2 Mbps. (b) Recall of scenes, and of the right tile, which holds the nearest reference. (c) Every "
        "point of the grid of scenes, tiles and tile edges. (d) Error, conditional on the right tile and over all "
        "queries; across scenes it is the distance in their overlapping coordinates, as in the paper. (e) By prefix of "
        "the code. (f) Databases recombined from the drives' views, 12 tiles kept: cost only, "
        "batches of queries; C2f: coarse-to-fine."
    )


def draw(path: Path, found: Found) -> None:
    """Draw the six panels."""
    figure, axes = fig.panels(3, 2, height_in=2.25)
    with mpl.rc_context(fig.style()):
        _draw_latency(axes[0], found)
        _draw_recall(axes[1], found)
        _draw_grid(axes[2], found)
        _draw_errors(axes[3], found)
        _draw_prefixes(axes[4], found)
        _draw_growth(axes[5], found)
    fig.save_figure(figure, path)


def _draw_latency(ax: Axes, found: Found) -> None:
    times = {name: float(np.median(values)) for name, values in found.times.items()}
    bars = [
        ("Raw images\n(paper)", PAPER["raw_ms"], fig.GREY),
        ("Brute force\n(paper)", PAPER["brute_ms"], fig.SKY),
        ("Coarse-to-fine\n(paper)", PAPER["fine_ms"], fig.YELLOW),
        ("Brute force", times["brute_1"], fig.BLUE),
        ("Coarse-to-fine", times["fine_1"], fig.ORANGE),
    ]
    for row, (_, value, colour) in enumerate(bars):
        ax.barh(row, value, color=colour, height=0.65)
        ax.text(value * 1.15, row, f"{value:,.3g}" if value < 1000 else f"{value:,.0f}", va="center", fontsize=6.5)
    ax.set_yticks(range(len(bars)), [label for label, _, _ in bars])
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.set_xlim(min(value for _, value, _ in bars) / 3, 5e4)
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("Latency of one query (ms)")
    fig.title(ax, "a", "Latency")


def _draw_recall(ax: Axes, found: Found) -> None:
    part = found.grid[found.chosen[2]]
    fig.band(
        *(ax, np.arange(1, found.n_scenes + 1), 100 * np.asarray(part.scene_hit)[:, :, 0]),
        *(fig.GREY, "Scene, top n", "--", "s"),
    )
    hits = np.asarray(part.tile_hit)
    kept = dict.fromkeys([min(SCENES, found.n_scenes), found.n_scenes])
    for scenes, colour in zip(kept, (fig.BLUE, fig.ORANGE), strict=False):
        label = f"Tile, top n of {scenes} scene{'s' * (scenes > 1)}"
        fig.band(ax, np.array(TILE_COUNTS), 100 * hits[:, scenes - 1], colour, label, "-", "o")
    ax.plot(SCENES, 100 * PAPER["scene"], "k*", ms=6, mfc="white", mew=0.8, label="Paper")
    ax.plot(TILES, 100 * PAPER["tile"], "k*", ms=6, mfc="white", mew=0.8)
    ax.set_xscale("log")
    fig.plain_log_ticks(ax.xaxis)
    ax.set_xlabel("Prototypes kept, n")
    ax.set_ylabel("Recall (%)")
    ax.set_ylim(0, 104)
    ax.legend(loc="lower right")
    fig.title(ax, "b", f"Recall, tiles of {found.chosen[2]:g} m")


def _draw_grid(ax: Axes, found: Found) -> None:
    colours = (fig.BLUE, fig.SKY, fig.GREEN, fig.PURPLE, fig.ORANGE)
    shown = sorted({1, min(SCENES, found.n_scenes), -(-found.n_scenes // 2), found.n_scenes})
    for scenes, colour in zip(shown, colours, strict=False):
        points = [(scenes, tiles, edge) for edge in found.grid for tiles in TILE_COUNTS]
        x, y = ([100 * found.at(point, name).mean() for point in points] for name in ("tile_hit", "pruned"))
        ax.plot(x, y, "o", ms=2.6, color=colour, label=f"{scenes} scene{'s' * (scenes > 1)}", alpha=0.8, mew=0)
    for point, label in ((found.paper, "2, 12"), (found.chosen, "selected")):
        x, y = (100 * found.at(point, name).mean() for name in ("tile_hit", "pruned"))
        ax.plot(x, y, "o", ms=7, mfc="none", mec="black", mew=0.9)
        ax.annotate(label, (x, y), (-4, -11), textcoords="offset points", ha="right", fontsize=6.5)
    ax.plot(100 * PAPER["tile"], 100 * PAPER["pruned"], "k*", ms=6, mfc="white", mew=0.8, label="Paper")
    ax.axvline(100 * RECALL, color=fig.GREY, lw=0.8, ls="--")
    ax.axhline(100 * PRUNED, color=fig.GREY, lw=0.8, ls="--")
    ax.set_ylim(80, 100.8)
    ax.set_xlabel("Tile recall (%)")
    ax.set_ylabel("Descriptors pruned (%)")
    boxed = {"frameon": True, "framealpha": 0.9, "edgecolor": "w"}
    ax.legend(loc="lower left", ncols=2, columnspacing=0.8, handletextpad=0.2, **boxed)
    fig.title(ax, "c", "Pruned share")


def _draw_errors(ax: Axes, found: Found) -> None:
    groups = [("tile kept\n2, 12", found.paper, "_hit_m"), ("all\n2, 12", found.paper, "_m")]
    groups += [("tile kept\nselected", found.chosen, "_hit_m"), ("all\nselected", found.chosen, "_m")]
    for i, (_, point, suffix) in enumerate(groups):
        for name, offset, colour in (("brute", -0.18, fig.BLUE), ("error", 0.18, fig.ORANGE)):
            span = interval(found.at(point, name + suffix))
            label = {"brute": "Brute force", "error": "Coarse-to-fine"}[name] if i == 0 else None
            half = span.half if np.isfinite(span.half) else 0.0
            ax.bar(
                i + offset, span.mean, 0.34, yerr=half, color=colour, label=label, error_kw={"lw": 0.8, "capsize": 1.5}
            )
    for i, (brute, fine) in enumerate([("brute", "hit"), ("brute", "fine")] * 2):
        for name, offset in ((brute, -0.18), (fine, 0.18)):
            ax.plot(
                i + offset,
                PAPER_M[name],
                "k*",
                ms=5,
                mfc="white",
                mew=0.7,
                label="Paper" if i + offset < -0.1 else None,
            )
    ax.set_yscale("log")
    fig.plain_log_ticks(ax.yaxis)
    ax.set_xticks(range(len(groups)), [label for label, _, _ in groups], fontsize=6)
    ax.grid(visible=False, axis="x")
    ax.set_ylabel("Mean error (m)")
    low, high = ax.get_ylim()
    ax.set_ylim(low, 4 * high)
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8, handlelength=1.2, handletextpad=0.4)
    fig.title(ax, "d", "Error")


def _draw_prefixes(ax: Axes, found: Found) -> None:
    for i, k in enumerate(PREFIXES):
        for name, offset, colour in (("brute_m", -0.12, fig.BLUE), ("error_m", 0.12, fig.ORANGE)):
            span = interval(np.asarray(getattr(found.by_prefix[k], name)))
            half = span.half if np.isfinite(span.half) else 0.0
            label = {"brute_m": "Brute force", "error_m": "Coarse-to-fine"}[name] if i == 0 else None
            ax.errorbar(
                i + offset, span.mean, half, color=colour, fmt="o", ms=3.5, capsize=2, elinewidth=1, label=label
            )
    floor = float(np.mean(found.by_prefix[RAW].floor_m))
    ax.axhline(floor, color=fig.GREY, lw=0.9, ls="--")
    ax.text(len(PREFIXES) - 0.55, 0.95 * floor, "nearest reference", fontsize=6, color=fig.GREY, va="top", ha="right")
    ax.set_xticks(range(len(PREFIXES)), ["uncoded" if k == RAW else f"{k}" for k in PREFIXES])
    ax.set_xlabel("Prefix of the query's code, k")
    ax.set_xlim(-0.5, len(PREFIXES) - 0.5)
    ax.grid(visible=False, axis="x")
    ax.set_ylim(0, 1.3 * ax.get_ylim()[1])
    ax.set_ylabel("Mean error (m)")
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8, handletextpad=0.2)
    fig.title(ax, "e", "Coded queries")


def _draw_growth(ax: Axes, found: Found) -> None:
    n = np.array([row["n"] for row in found.growth])
    lines = (
        ("brute", "Brute force", fig.BLUE, "o"),
        ("fine_all", "C2f, all scenes", fig.ORANGE, "s"),
        ("fine_2", "C2f, 2 scenes", fig.GREEN, "^"),
    )
    for name, label, colour, marker in lines:
        values = [row[name] for row in found.growth]
        ax.loglog(n, values, marker + "-", ms=3.5, color=colour, label=f"{label} ($N^{{{found.slope(name):.2f}}}$)")
    ax.set_xlabel("Descriptors in the database, N")
    ax.set_ylabel("Time per query (ms)")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * 12)
    ax.legend(loc="upper left")
    fig.title(ax, "f", "Cost of larger databases")
