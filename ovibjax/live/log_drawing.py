"""The figure of a log: latencies of the edge, its stages, what robots waited for, and their route error."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ovibjax.control.environment import SLOT_S
from ovibjax.live.log_report import STAGES, Run, edge_ms, route_errors_m
from ovibjax.report import figures as fig
from ovibjax.report import panels

_COLOURS = (fig.BLUE, fig.ORANGE, fig.GREEN, fig.RED, fig.PURPLE, fig.SKY)
_SHARES = np.linspace(0.0, 1.0, 201)
_MOST = len(_COLOURS)


def draw_log(path: Path, edges: Sequence[Run], robots: Sequence[Run]) -> None:
    """Draw what the logs hold; of more than six runs of a side the last six.

    Args:
        path: the PNG to write.
        edges: runs of edges that answered something.
        robots: runs of robots.
    """
    drawn: list[Callable[[Axes], None]] = []
    if shown := [run for run in edges if run.ended["ok"]][-_MOST:]:
        drawn += [lambda ax: _latencies(ax, shown), lambda ax: _stages(ax, shown)]
    if asked := [run for run in robots if run.ended["ok"]][-_MOST:]:
        drawn.append(lambda ax: _answers(ax, asked))
    if driven := [run for run in robots if run.tracks][-_MOST:]:
        drawn.append(lambda ax: _errors(ax, driven))
    with panels.sheet(path, min(2, len(drawn)), -(-len(drawn) // 2)) as axes:
        for ax, draw in zip(axes, drawn, strict=False):
            draw(ax)
        for ax in axes[len(drawn) :]:
            ax.set_axis_off()


def _latencies(ax: Axes, runs: Sequence[Run]) -> None:
    for run, colour in zip(runs, _COLOURS, strict=False):
        ax.plot(np.quantile(edge_ms(run), _SHARES), _SHARES, color=colour, label=run.name)
    ax.set(xscale="log", xlabel="waiting and service at the edge (ms)", ylabel="share of requests", ylim=(0, 1))
    fig.plain_log_ticks(ax.xaxis)
    ax.legend()


def _stages(ax: Axes, runs: Sequence[Run]) -> None:
    places = np.arange(len(STAGES))
    for number, (run, colour) in enumerate(zip(runs, _COLOURS, strict=False)):
        times_ms = [run.column(f"{stage}_ms") for stage in STAGES]
        medians = [float(np.median(t)) if t.size else 0.0 for t in times_ms]
        ax.bar(places + 0.8 * (number + 0.5) / len(runs) - 0.4, medians, 0.8 / len(runs), color=colour)
    ax.set_xticks(places, STAGES)
    ax.set(ylabel="median time (ms)")
    ax.grid(visible=False, axis="x")


def _answers(ax: Axes, runs: Sequence[Run]) -> None:
    for run, colour in zip(runs, _COLOURS, strict=False):
        ax.plot(np.quantile(run.column("e2e_ms"), _SHARES), _SHARES, color=colour, label=f"{run.name}, answer")
        ax.plot(np.quantile(run.column("uplink_ms"), _SHARES), _SHARES, ":", color=colour, label="uplink alone")
    ax.set(xscale="log", xlabel="from decision to answer (ms)", ylabel="share of questions", ylim=(0, 1))
    fig.plain_log_ticks(ax.xaxis)
    ax.legend()


def _errors(ax: Axes, runs: Sequence[Run]) -> None:
    for run, colour in zip(runs, _COLOURS, strict=False):
        errors_m = route_errors_m(run)
        mean_m = np.nanmean(errors_m, axis=0)
        ax.plot(SLOT_S * np.arange(len(mean_m)), mean_m, color=colour, label=f"{run.name}, mean of {len(errors_m)}")
    ax.set(xlabel="time on the route (s)", ylabel="route error (m)", ylim=(0, None))
    ax.legend()
