"""Live edges and robots as pictures, beside the replay of the same requests and routes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.live_claims import TOLERANCE
from ovibjax.cards.live_runs import MODELS, PARTS
from ovibjax.cards.live_study import LOADS, LiveStudy
from ovibjax.cards.scheduling_drawing import COLOURS, NAMES
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import interval

_SHARES = np.linspace(0.0, 1.0, 201)
_PALE = 0.45
_MARKERS = {"planned": "^", "service": "s", "kept": "o"}


def draw_edge(ax: Axes, found: LiveStudy) -> None:
    """Distribution of waiting plus service, live and replayed, by rule and load."""
    _distributions(ax, found, end_to_end=False)
    ax.set(xlabel="edge latency, waiting and service (ms)")
    ax.plot([], [], color="black", label=f"live, {_percent('high')} load")
    ax.plot([], [], color="black", alpha=_PALE, label=f"live, {_percent('low')} load")
    ax.plot([], [], ":", color="black", label="replay")
    ax.legend(loc="lower right")


def draw_end_to_end(ax: Axes, found: LiveStudy) -> None:
    """Distribution of the time from observation to answer, live and replayed, by rule and load."""
    _distributions(ax, found, end_to_end=True)
    ax.set(xlabel="end-to-end latency, observation to answer (ms)")
    for rule in _rules(found):
        ax.plot([], [], color=COLOURS[rule], label=NAMES[rule])
    ax.legend(loc="lower right")


def _distributions(ax: Axes, found: LiveStudy, end_to_end: bool) -> None:
    for (load, rule), runs in found.runs.items():
        for source, line in (("live", "-"), ("kept", ":")):
            each = [run.end_to_end_ms(source) if end_to_end else run.latency_ms(source) for run in runs]
            alpha = 1.0 if load == "high" else _PALE
            x = np.quantile(np.concatenate(each), _SHARES)
            ax.plot(x, _SHARES, line, color=COLOURS[rule], alpha=alpha, lw=1.2)
    ax.set(xscale="log", ylabel="share of requests", ylim=(0, 1))
    fig.plain_log_ticks(ax.xaxis)


def draw_top(ax: Axes, found: LiveStudy) -> None:
    """Edge p95 of the top decile by rule at high load, live beside replay."""
    for row, rule in enumerate(_rules(found)):
        for source, place, alpha in (("live", row - 0.19, 1.0), ("kept", row + 0.19, _PALE)):
            span = interval(found.p95_ms("high", rule, source, "top10"))
            look: dict[str, Any] = {"color": COLOURS[rule], "alpha": alpha, "error_kw": {"lw": 1, "capsize": 2}}
            ax.barh(place, span.mean, xerr=span.cap or None, height=0.36, **look)
            ax.text(span.mean + span.cap, place, f" {span.mean:.0f}", va="center", fontsize=6.5)
    panels.category_axis(ax, [NAMES[rule] for rule in _rules(found)])
    ax.set(xlabel="edge p95, top decile (ms): solid live, pale replay")


def draw_off(ax: Axes, found: LiveStudy) -> None:
    """By how much replays miss the live p95 of all requests, by rule and by what they are given."""
    rules = _rules(found)
    ax.axvspan(-100 * TOLERANCE, 100 * TOLERANCE, color=fig.GREEN, alpha=0.12, lw=0)
    ax.axvline(0.0, color="black", lw=0.8)
    for row, rule in enumerate(rules):
        for place, model in zip((-0.24, 0.0, 0.24), MODELS, strict=True):
            for load, filled in (("low", "white"), ("high", COLOURS[rule])):
                span = interval(100.0 * found.off(load, rule, model))
                look: dict[str, Any] = {"color": COLOURS[rule], "marker": _MARKERS[model], "mfc": filled}
                ax.errorbar(span.mean, row + place, xerr=span.cap, ms=4, capsize=2, lw=1, **look)
    panels.category_axis(ax, [NAMES[rule] for rule in rules])
    ax.set(xlabel="p95 of the replay against live (%)")
    for model, words in MODELS.items():
        ax.plot([], [], _MARKERS[model], ms=4, color=fig.GREY, label=words)
    ax.plot([], [], "o", ms=4, color=fig.GREY, mfc="white", label=f"{_percent('low')} load")
    ax.legend(loc="upper center", bbox_to_anchor=(0.45, -0.2), ncols=2, columnspacing=0.8, handletextpad=0.1)


def draw_routes(ax: Axes, found: LiveStudy) -> None:
    """Route error over time, driven with a live edge and replayed with the same draws."""
    routes, live_m = found.routes, found.routes.live_m
    _, half_m = fig.mean_and_half(live_m - routes.given.error_m)
    mean_m = live_m.mean(axis=0)
    ax.fill_between(routes.time_s, mean_m - half_m, mean_m + half_m, color=fig.BLUE, alpha=0.18, lw=0)
    ax.plot(routes.time_s, mean_m, color=fig.BLUE, label=f"live, {len(live_m)} robots")
    for replayed, colour, line, words in (
        (routes.given, fig.RED, "--", "replay, the live edge's wait"),
        (routes.assumed, fig.GREY, ":", f"replay, wait assumed ({routes.assumed.wait_ms:.0f} ms)"),
    ):
        ax.plot(routes.time_s, replayed.error_m.mean(axis=0), line, color=colour, lw=1.2, label=words)
    ax.set(xlabel="time on the route (s)", ylabel="route error (m)")
    ax.set_ylim(bottom=0)
    ax.legend(loc="upper left")


def draw_parts(ax: Axes, found: LiveStudy) -> None:
    """Median time of each part of the edge's work on a request, by rule and load."""
    rules = _rules(found)
    shifts = np.linspace(-0.25, 0.25, len(rules)) if len(rules) > 1 else [0.0]
    for shift, rule in zip(shifts, rules, strict=True):
        for load, filled in (("low", "white"), ("high", COLOURS[rule])):
            for row, part in enumerate(PARTS):
                times_ms = np.concatenate([run.parts[part] for run in found.runs[load, rule]])
                ax.plot(max(float(np.median(times_ms)), 1e-3), row + shift, "o", ms=3, color=COLOURS[rule], mfc=filled)
    panels.category_axis(ax, ["of it dispatch" if part == "dispatch" else part for part in PARTS])
    words = f"open {_percent('low')}, full {_percent('high')} load"
    ax.set(xscale="log", xlabel=f"median per request (ms): {words}")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))


def _percent(load: str) -> str:
    return f"{100 * LOADS[load]:.0f} %"


def _rules(found: LiveStudy) -> list[str]:
    return [rule for rule in NAMES if rule in found.size.rules]
