"""The panels of the retrieval figure: latency, recall, the pruned share, errors, coded queries, larger databases."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.raw_images import PAPER_UPLOAD_S, upload_s
from ovibjax.cards.retrieval_benchmark import RAW, Point
from ovibjax.cards.retrieval_claims import PAPER, PAPER_M
from ovibjax.cards.retrieval_study import PREFIXES, PRUNED, RECALL, SCENES, TILE_COUNTS, TILES, RetrievalStudy
from ovibjax.report import figures as fig
from ovibjax.report.claims import Interval, interval
from ovibjax.report.panels import Bar, bars, columns, headroom, sheet

_PAPER_STAR: dict[str, Any] = {"marker": "*", "ls": "", "color": "black", "ms": 6, "mfc": "white", "mew": 0.8}


def draw(path: Path, found: RetrievalStudy) -> None:
    """Draw the six panels."""
    with sheet(path, 3, 2, height_in=2.25) as (latency, recall, grid, errors, prefixes, growth):
        _draw_latency(latency, found)
        _draw_recall(recall, found)
        _draw_grid(grid, found)
        _draw_errors(errors, found)
        _draw_prefixes(prefixes, found)
        _draw_growth(growth, found)


def _draw_latency(ax: Axes, found: RetrievalStudy) -> None:
    raw = [("Image upload", 1e3 * float(upload_s(found.raw_bytes).mean()), fig.GREY)] if len(found.raw_bytes) else []
    times = (
        ("Image upload\n(paper)", 1e3 * PAPER_UPLOAD_S, fig.GREY),
        *raw,
        ("Brute force\n(paper)", PAPER["brute_ms"], fig.SKY),
        ("Coarse-to-fine\n(paper)", PAPER["fine_ms"], fig.YELLOW),
        ("Brute force", found.median_ms("brute_1"), fig.BLUE),
        ("Coarse-to-fine", found.median_ms("fine_1"), fig.ORANGE),
    )
    rows = [
        Bar(label, Interval(ms, 0.0), colour, text=f"{ms:,.3g}" if ms < 1000 else f"{ms:,.0f}")
        for label, ms, colour in times
    ]
    bars(ax, rows)
    ax.set(xlabel="Latency of one query (ms)", xscale="log", xlim=(min(ms for _, ms, _ in times) / 3, 5e4))
    fig.title(ax, "a", "Latency")


def _draw_recall(ax: Axes, found: RetrievalStudy) -> None:
    part = found.grid[found.paper.tile_m]
    scene_hit = 100 * np.asarray(part.scene_hit)[:, :, 0]
    fig.band(ax, np.arange(1, found.n_scenes + 1), scene_hit, fig.GREY, "Scene, top n", "--", "s")
    hits = np.asarray(part.tile_hit)
    kept = dict.fromkeys([min(SCENES, found.n_scenes), found.n_scenes])
    for scenes, colour in zip(kept, (fig.BLUE, fig.ORANGE), strict=False):
        label = f"Tile, top n of {scenes} scene{'s' * (scenes > 1)}"
        fig.band(ax, np.array(TILE_COUNTS), 100 * hits[:, scenes - 1], colour, label, "-", "o")
    ax.plot(SCENES, 100 * PAPER["scene"], label="Paper", **_PAPER_STAR)
    ax.plot(TILES, 100 * PAPER["tile"], **_PAPER_STAR)
    ax.set_xscale("log")
    fig.plain_log_ticks(ax.xaxis)
    ax.set_xlabel("Prototypes kept, n")
    ax.set_ylabel("Recall (%)")
    ax.set_ylim(0, 104)
    ax.legend(loc="lower right")
    fig.title(ax, "b", f"Recall, tiles of {found.paper.tile_m:g} m")


def _draw_grid(ax: Axes, found: RetrievalStudy) -> None:
    colours = (fig.BLUE, fig.SKY, fig.GREEN, fig.PURPLE, fig.ORANGE)
    shown = sorted({1, min(SCENES, found.n_scenes), -(-found.n_scenes // 2), found.n_scenes})
    for scenes, colour in zip(shown, colours, strict=False):
        points = [Point(scenes, tiles, edge) for edge in found.grid for tiles in TILE_COUNTS]
        x, y = ([100 * found.at(point, name).mean() for point in points] for name in ("tile_hit", "pruned"))
        ax.plot(x, y, "o", ms=2.6, color=colour, label=f"{scenes} scene{'s' * (scenes > 1)}", alpha=0.8, mew=0)
    for point, label in ((found.paper, "2, 12"), (found.chosen, "selected")):
        x, y = (100 * found.at(point, name).mean() for name in ("tile_hit", "pruned"))
        ax.plot(x, y, "o", ms=7, mfc="none", mec="black", mew=0.9)
        ax.annotate(label, (x, y), (-4, -11), textcoords="offset points", ha="right", fontsize=6.5)
    ax.plot(100 * PAPER["tile"], 100 * PAPER["pruned"], label="Paper", **_PAPER_STAR)
    ax.axvline(100 * RECALL, color=fig.GREY, lw=0.8, ls="--")
    ax.axhline(100 * PRUNED, color=fig.GREY, lw=0.8, ls="--")
    ax.set_ylim(80, 100.8)
    ax.set_xlabel("Tile recall (%)")
    ax.set_ylabel("Descriptors pruned (%)")
    boxed = {"frameon": True, "framealpha": 0.9, "edgecolor": "w"}
    ax.legend(loc="lower left", handletextpad=0.2, **boxed)
    fig.title(ax, "c", "Pruned share")


def _draw_errors(ax: Axes, found: RetrievalStudy) -> None:
    groups = {"tile kept\n2, 12": (found.paper, "_hit_m"), "all\n2, 12": (found.paper, "_m")}
    groups |= {"tile kept\nselected": (found.chosen, "_hit_m"), "all\nselected": (found.chosen, "_m")}

    def spans(method: str) -> list[Interval]:
        return [interval(found.at(point, method + suffix)) for point, suffix in groups.values()]

    series = [("Brute force", fig.BLUE, spans("brute")), ("Coarse-to-fine", fig.ORANGE, spans("error"))]
    brute_x, fine_x = columns(ax, list(groups), series)
    ax.plot(brute_x, [PAPER_M["brute"]] * len(groups), label="Paper", **_PAPER_STAR)
    ax.plot(fine_x, [PAPER_M["hit"], PAPER_M["fine"]] * 2, **_PAPER_STAR)
    ax.tick_params(axis="x", labelsize=6)
    ax.set_yscale("log")
    fig.plain_log_ticks(ax.yaxis)
    ax.set_ylabel("Mean error (m)")
    headroom(ax, 4.0)
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8, handlelength=1.2, handletextpad=0.4)
    fig.title(ax, "d", "Error")


def _draw_prefixes(ax: Axes, found: RetrievalStudy) -> None:
    for name, label, offset, colour in (
        ("brute_m", "Brute force", -0.12, fig.BLUE),
        ("error_m", "Coarse-to-fine", 0.12, fig.ORANGE),
    ):
        spans = [interval(np.asarray(getattr(found.by_prefix[k], name))) for k in PREFIXES]
        means, caps = [span.mean for span in spans], [span.cap for span in spans]
        x = np.arange(len(PREFIXES)) + offset
        ax.errorbar(x, means, caps, color=colour, fmt="o", ms=3.5, capsize=2, elinewidth=1, label=label)
    floor = float(np.mean(found.by_prefix[RAW].floor_m))
    ax.axhline(floor, color=fig.GREY, lw=0.9, ls="--")
    ax.text(len(PREFIXES) - 0.55, 0.95 * floor, "nearest reference", fontsize=6, color=fig.GREY, va="top", ha="right")
    ax.set_xticks(range(len(PREFIXES)), ["uncoded" if k == RAW else f"{k}" for k in PREFIXES])
    ax.set_xlabel("Prefix of the query's code, k")
    ax.set_xlim(-0.5, len(PREFIXES) - 0.5)
    ax.grid(visible=False, axis="x")
    ax.set_ylim(bottom=0)
    headroom(ax, 1.3)
    ax.set_ylabel("Mean error (m)")
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8, handletextpad=0.2)
    fig.title(ax, "e", "Coded queries")


def _draw_growth(ax: Axes, found: RetrievalStudy) -> None:
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
    headroom(ax, 12.0)
    ax.legend(loc="upper left")
    fig.title(ax, "f", "Cost of larger databases")
