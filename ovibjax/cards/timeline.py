"""One replay along its route as a picture: local risk with requests, error, link and edge."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ovibjax.control.actions import ActionSet
from ovibjax.control.environment import SLOT_S
from ovibjax.control.route_replay import RouteResult
from ovibjax.report import figures as fig
from ovibjax.report import panels

MODE_MARKERS = {"F": "v", "FS": "o", "H4": "s", "A5": "D"}
CONTEXT_COLOURS = {"corridor": "#DDE8F0", "intersection": "#FBE7C6", "repetitive": "#F3D3DF", "unknown": "#EEEEEE"}


def time_s(slots: int) -> np.ndarray:
    """[T] start of each slot."""
    return np.arange(slots) * SLOT_S


def shade(ax: Axes, context: np.ndarray, names: tuple[str, ...]) -> None:
    """Route context as background.

    Args:
        ax: the panel, time in seconds along x.
        context: [T] codes.
        names: what they mean.
    """
    start_s = time_s(len(context))
    edges = np.flatnonzero(np.diff(context, prepend=-9, append=-9))
    for a, b in itertools.pairwise(edges):
        ax.axvspan(start_s[a], start_s[b - 1] + SLOT_S, color=CONTEXT_COLOURS[names[context[a]]], lw=0)
    ax.set(xlim=(0, start_s[-1] + SLOT_S))
    ax.grid(visible=False, axis="x")


def draw_requests(ax: Axes, run: RouteResult, actions: ActionSet, colour: str = fig.BLUE) -> None:
    """Local risk with a marker per request, by view mode; the legend explains modes and contexts.

    Args:
        ax: the panel.
        run: one replay, fields [T].
        actions: what action numbers mean.
        colour: of the line.
    """
    start_s = time_s(len(run.sent))
    ax.plot(start_s, run.risk_before_m, color=colour, lw=1.1)
    modes = np.array(actions.modes)[np.asarray(run.action) // len(actions.prefixes)]
    for mode in actions.modes:
        at = np.asarray(run.sent) & (modes == mode)
        if at.any():
            marker = MODE_MARKERS[mode]
            ax.plot(start_s[at], run.risk_before_m[at], marker, ms=4.5, color="black", mfc="white", label=mode)
    ax.set(ylabel="local risk (m)")
    ax.set_ylim(0, 1.35 * max(float(run.risk_before_m.max()), 1e-3))


def legend(ax: Axes, names: tuple[str, ...]) -> None:
    """Legend of view modes and contexts on one line."""
    handles, labels = ax.get_legend_handles_labels()
    handles += [Patch(color=CONTEXT_COLOURS[name]) for name in names]
    look = {
        "columnspacing": 0.6,
        "handlelength": 0.9,
        "handletextpad": 0.3,
        "frameon": True,
        "framealpha": 0.85,
        "edgecolor": "none",
    }
    size = 5.5 if len(handles) > 6 else None  # on one line
    ax.legend(handles, [*labels, *names], loc="upper center", ncols=len(handles), fontsize=size, **look)


def draw_timeline(
    path: Path, run: RouteResult, context: np.ndarray, names: tuple[str, ...], actions: ActionSet, policy: str
) -> None:
    """Three panels over time: risk and requests, route error, throughput and edge delay.

    Args:
        path: the PNG to write.
        run: one replay, fields [T].
        context: [T] route context.
        names: what its codes mean.
        actions: what action numbers mean.
        policy: the policy as it is written in the legend.
    """
    with panels.sheet(path, 1, 3, height_in=1.45) as (requests, error, link):
        draw_requests(requests, run, actions)
        legend(requests, names)
        sent, kb = int(np.sum(run.sent)), run.payload_bytes.sum() / 1024
        fig.title(requests, "a", f"requests of {policy}: {sent}, {kb:.2f} KB")
        error.plot(time_s(len(run.sent)), run.error_m, color=fig.RED, lw=1.1)
        error.set(ylabel="route error (m)")
        error.set_ylim(bottom=0)
        fig.title(error, "b", f"error: mean {run.error_m.mean():.2f} m, p95 {np.percentile(run.error_m, 95):.2f} m")
        for ax in (requests, error):
            shade(ax, context, names)
            ax.tick_params(labelbottom=False)
        _draw_link(link, run)
        fig.title(link, "c", "link and edge")


def _draw_link(ax: Axes, run: RouteResult) -> None:
    """Throughput, and on a second axis the predicted edge delay."""
    start_s = time_s(len(run.sent))
    ax.plot(start_s, run.rate_bps / 8192.0, color=fig.GREEN, lw=0.9, label="throughput (KB/s)")
    ax.set(xlabel="time (s)", ylabel="throughput (KB/s)", xlim=(0, start_s[-1] + SLOT_S))
    ax.set_ylim(0, 1.45 * max(float(run.rate_bps.max()) / 8192.0, 1e-3))
    delay = ax.twinx()
    delay.plot(start_s, 1000.0 * run.delay_s, color=fig.PURPLE, lw=0.9, label="predicted edge delay (ms)")
    delay.set_ylabel("edge delay (ms)")
    delay.set_ylim(0, 1.45 * float(1000.0 * run.delay_s.max()))
    delay.grid(visible=False)
    delay.spines["right"].set_visible(True)
    lines = [*ax.get_lines(), *delay.get_lines()]
    ax.legend(lines, [str(line.get_label()) for line in lines], loc="upper center", ncols=2)
