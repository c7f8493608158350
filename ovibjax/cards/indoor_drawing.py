"""The panels of the indoor figure: the rooms, errors by view mode, their distribution, size, early stopping."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.indoor_paper import PAPER
from ovibjax.cards.indoor_study import RECALL_M, PlatformResults, repetitions, room_config
from ovibjax.encoder.recipe import PAPER_PREFIXES
from ovibjax.link.payload import representation_bytes
from ovibjax.report import figures as fig
from ovibjax.report.claims import interval
from ovibjax.report.panels import distribution, headroom, sheet
from ovibjax.views import MODES
from ovibjax.world.rooms.picture import draw_plan
from ovibjax.world.rooms.room import make_room

COLOURS = {"UAV": fig.BLUE, "UGV": fig.ORANGE}
MARKERS = {"UAV": "o", "UGV": "s"}


def draw(path: Path, found: Sequence[PlatformResults], steps: int, embedded: bool) -> None:
    """Draw the six panels, five if there is only one platform.

    Args:
        path: the PNG.
        found: results of each platform.
        steps: training steps.
        embedded: whether the rooms are the embedded ones, beside which the paper's numbers stand.
    """
    with sheet(path, 3, 2, height_in=2.45) as axes:
        for ax, platform in zip(axes, found, strict=False):
            _draw_positions(ax, platform, embedded)
        if len(found) == 1:
            axes[1].remove()
        _draw_modes(axes[2], found, embedded)
        _draw_distribution(axes[3], found)
        _draw_size(axes[4], found, embedded)
        _draw_training(axes[5], found, steps)


def _draw_positions(ax: Axes, platform: PlatformResults, embedded: bool) -> None:
    name, (references, queries) = platform.name, platform.scenes[0]
    if embedded:
        draw_plan(ax, make_room(room_config(name, platform.rooms[0])))
    look: dict[str, Any] = {"marker": MARKERS[name], "color": COLOURS[name], "ls": "", "zorder": 3}
    ax.plot(*references.positions_m[:, :2].T, mfc="white", ms=3.2, mew=0.8, label="reference", **look)
    ax.plot(*queries.positions_m[:, :2].T, ms=2.8, mec="none", label="query", **look)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.24), ncols=2, handletextpad=0.2)
    fig.title(ax, "a", f"{name}: {len(references.features)} references, {len(queries.features)} queries")


def _draw_modes(ax: Axes, found: Sequence[PlatformResults], embedded: bool) -> None:
    names = [mode for mode in MODES if any(mode in platform.data.mode.to_numpy() for platform in found)]
    width = 0.8 / len(found)
    for i, platform in enumerate(found):
        modes = platform.data.mode.to_numpy().tolist()
        x = np.array([names.index(mode) for mode in modes]) + (i - (len(found) - 1) / 2) * width
        spans = [interval(platform.mean_m("raw", mode=mode)) for mode in modes]
        means, caps = [span.mean for span in spans], [span.cap for span in spans]
        colour = COLOURS[platform.name]
        ax.bar(x, means, 0.9 * width, yerr=caps, color=colour, alpha=0.55, capsize=2, label=platform.name)
        coded = [interval(platform.mean_m("ovib", 32, mode)).mean for mode in modes]
        ax.plot(x, coded, "D", ms=4, color=colour, mec="black", mew=0.6, zorder=4)
        ax.axhline(platform.mean_m("floor").mean(), color=colour, ls=":", lw=1)
        if embedded:
            paper_m = PAPER[platform.name].mode_m
            marks = [(at, paper_m[mode]) for at, mode in zip(x, modes, strict=True) if mode in paper_m]
            ax.plot(*zip(*marks, strict=True), "_", ms=11, mew=1.5, color="black", zorder=5)
    ax.plot([], [], "D", ms=4, color="white", mec="black", mew=0.6, label="O-VIB, k = 32")
    if embedded:
        ax.plot([], [], "_", ms=9, mew=1.5, color="black", label="paper, retrieval")
    ax.set_xticks(range(len(names)), [{"FS": "F+S"}.get(name, name) for name in names])
    ax.set(xlabel="view mode", ylabel="mean error (m)")
    headroom(ax, 1.4)
    ax.grid(visible=False, axis="x")
    ax.legend(loc="upper right", ncols=2, columnspacing=0.8)
    fig.title(ax, "b", "more views, less error")


def _draw_distribution(ax: Axes, found: Sequence[PlatformResults]) -> None:
    x = np.linspace(0, 1.2, 121)

    def shares(errors_m: np.ndarray) -> np.ndarray:
        return repetitions(errors_m[..., None] <= x)

    for platform in found:
        name, colour = platform.name, COLOURS[platform.name]
        distribution(ax, x, shares(platform.errors_m("ovib", 32)), colour, f"{name} O-VIB-32")
        distribution(ax, x, shares(platform.errors_m("raw")), colour, f"{name} retrieval", "--")
        ax.plot(x, shares(platform.errors_m("floor")).mean(axis=0), ":", color=colour, lw=1)
    ax.axvline(RECALL_M, color=fig.GREY, lw=0.7)
    ax.set(xlabel="query error (m)", ylabel="share of queries", xlim=(0, 1.2), ylim=(0, 1.01))
    ax.legend(loc="lower right")
    fig.title(ax, "c", "error distribution")


def _draw_size(ax: Axes, found: Sequence[PlatformResults], embedded: bool) -> None:
    kib = np.array([representation_bytes(k) for k in PAPER_PREFIXES]) / 1024
    for platform in found:
        name, colour, marker = platform.name, COLOURS[platform.name], MARKERS[platform.name]
        curves = np.stack([platform.mean_m("ovib", k) for k in PAPER_PREFIXES], axis=1)
        fig.band(ax, kib, curves, colour, f"{name} O-VIB", marker=marker)
        raw, at = interval(platform.mean_m("raw")), platform.payload_bytes("raw", 0, platform.whole) / 1024
        ax.errorbar(at, raw.mean, raw.cap, fmt="X", ms=6, color=colour, capsize=2, lw=1, label=f"{name} raw features")
        ax.axhline(platform.mean_m("floor").mean(), color=colour, ls=":", lw=1)
        if embedded:
            paper_kb, paper_m, *_ = zip(*PAPER[name].table.values(), strict=True)
            ax.plot(paper_kb, paper_m, marker, ms=4, mfc="none", mew=0.9, color=colour)
    if embedded:
        ax.plot([], [], "o", ms=4, mfc="none", mew=0.9, color=fig.GREY, label="paper")
    ax.plot([], [], ":", color=fig.GREY, label="nearest reference")
    ax.set(xlabel="representation (KB)", ylabel="mean error (m)", xscale="log")
    ax.set_ylim(bottom=0)
    headroom(ax, 1.6)
    fig.plain_log_ticks(ax.xaxis, subs=(1.0, 3.0))
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8)
    fig.title(ax, "d", "size and error")


def _draw_training(ax: Axes, found: Sequence[PlatformResults], steps: int) -> None:
    for platform in found:
        colour = COLOURS[platform.name]
        scores = platform.data.score.transpose("room", "seed", "checkpoint").to_numpy()
        checkpoints = scores.shape[-1]
        step = np.arange(1, checkpoints + 1) * steps / checkpoints
        fig.band(ax, step, scores.reshape(-1, checkpoints), colour, platform.name)
        best = platform.data.best.to_numpy().ravel()
        ax.plot(step[best], scores.reshape(-1, checkpoints).min(axis=1), ".", ms=4, color=colour)
    ax.plot([], [], ".", color=fig.GREY, label="checkpoint kept")
    ax.set(xlabel="training step", ylabel="validation error (m)")
    headroom(ax, 1.25)
    ax.legend(loc="upper right", ncols=2, columnspacing=0.8)
    fig.title(ax, "e", "early stopping")
