"""What a correction is worth: its claimed risk against its error, what a client makes of it, and other routes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_drawing import COLOURS, MODE_COLOURS, NAMES
from ovibjax.cards.control_study import CODED, FUSED, GATED, PAPER, TAKEN, TRANSFER, ControlStudy, Point
from ovibjax.control.environment import Route
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Interval, interval

USES = {PAPER: "replace", TAKEN: "replace always", FUSED: "fuse (Kalman)", GATED: "replace, gate"}
"""What a client does with a correction: settings and words."""

COMPARED = ("oracle_action", "voi", "uncertainty", "budgeted_periodic")


def calibration_rows(found: ControlStudy) -> list[dict[str, Any]]:
    """Claimed and realised root mean square of the edge's error by routes and action, m, and what lies behind it."""
    scene = found.scene
    groups = {"training": scene.training} | {f"held-out {i + 1}": [route] for i, route in enumerate(scene.held_out)}
    return [
        {
            "routes": name,
            "action": action,
            "claimed_rms_m": round(float(np.sqrt(np.mean(claimed[:, a] ** 2))), 3),
            "realised_rms_m": round(float(np.sqrt(np.mean(length[:, a] ** 2))), 3),
            "median_m": round(float(np.median(length[:, a])), 3),
            "median_claimed_m": round(float(np.median(claimed[:, a])), 3),
        }
        for name, routes in groups.items()
        for claimed, length in (claims_and_errors(routes),)
        for a, action in enumerate(scene.actions.names)
    ]


def claims_and_errors(routes: list[Route]) -> tuple[np.ndarray, np.ndarray]:
    """[N, A] risks that come with the answers along some routes, and their errors, m."""
    claimed = np.concatenate([np.asarray(route.risk_m, np.float64) for route in routes])
    return claimed, np.concatenate([np.linalg.norm(np.asarray(r.residual_m, np.float64), axis=-1) for r in routes])


def draw_calibration(ax: Axes, found: ControlStudy) -> None:
    """Realised root mean square over held-out routes of answers that claim the same risk; compact actions."""
    claimed, length = claims_and_errors(found.scene.held_out)
    actions, ends = found.scene.actions, []
    for m, mode in enumerate(actions.modes):
        a = m * len(actions.prefixes)
        levels = np.unique(claimed[:, a])
        told = [length[claimed[:, a] == level, a] for level in levels]
        realised = np.array([np.sqrt(np.mean(part**2)) for part in told])
        size = 6.0 + 60.0 * np.array([len(part) for part in told]) / len(length)
        ax.scatter(levels, realised, s=size, color=MODE_COLOURS[mode], alpha=0.75, lw=0, label=f"{mode}, compact")
        ends += [levels.min(), levels.max(), realised.min(), realised.max()]
    low, high = 0.8 * min(ends), 1.25 * max(ends)
    ax.plot([low, high], [low, high], color="black", lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
    ax.set(xlabel="claimed risk (m)", ylabel="realised RMS (m)")
    for axis in (ax.xaxis, ax.yaxis):
        fig.plain_log_ticks(axis)
    ax.legend(loc="upper left", handletextpad=0.1)


def draw_uses(ax: Axes, found: ControlStudy) -> None:
    """Mean error by what a client does with a correction, and by how the edge's references are kept."""
    for row, (point, coded) in enumerate(zip(USES, CODED, strict=True)):
        for shift, policy in enumerate(COMPARED):
            for place, filled, offset in ((point, True, -0.05), (coded, False, 0.05)):
                span = interval(found.of(policy, "mean_m", place))
                look: dict[str, Any] = {"ms": 3.5, "capsize": 1.5, "lw": 0.8, "color": COLOURS[policy]}
                look |= {"mfc": COLOURS[policy] if filled else "white"}
                cap = [[min(span.cap, 0.7 * span.mean)], [span.cap]]
                ax.errorbar(span.mean, row + 0.2 * (shift - 1.5) + offset, xerr=cap, fmt="o", **look)
    for policy in COMPARED:
        ax.plot([], [], "o", ms=3.5, color=COLOURS[policy], label=NAMES[policy])
    ax.plot([], [], "o", ms=3.5, color=fig.GREY, mfc="white", label="references coded")
    panels.category_axis(ax, list(USES.values()))
    ax.set(xlabel="mean route error (m)", xscale="log")
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper center", bbox_to_anchor=(0.35, -0.2), ncols=3, columnspacing=0.6, handletextpad=0.1)


def route_ratios(found: ControlStudy, point: Point) -> tuple[list[Interval], Interval]:
    """VOI-Control's mean error over budgeted periodic's, as logarithms: by route over its seeds, and over routes."""
    routes = len(found.scene.held_out)
    log = np.log(found.of("voi", "mean_m", point) / found.of("budgeted_periodic", "mean_m", point))
    each = [interval(log[route::routes]) for route in range(routes)]
    return each, interval([span.mean for span in each])


def draw_routes(ax: Axes, found: ControlStudy) -> None:
    """VOI-Control's mean error relative to budgeted periodic's on routes that prices were not tuned on."""
    markers = "osv^Dp"
    for row, point in enumerate(TRANSFER):
        each, over = route_ratios(found, point)
        rows = [
            *((span, markers[i % 6], fig.BLUE, 0.14 * (i - 1)) for i, span in enumerate(each)),
            (over, "*", fig.RED, 0.3),
        ]
        for span, marker, colour, offset in rows:
            mean, ends = np.exp(span.mean), np.exp([span.mean - span.cap, span.mean + span.cap])
            look: dict[str, Any] = {"color": colour, "capsize": 2, "lw": 0.9, "ms": 7 if marker == "*" else 3.5}
            ax.errorbar(mean, row + offset, xerr=np.abs(ends - mean)[:, None], fmt=marker, **look)
    for i in range(len(found.scene.held_out)):
        ax.plot([], [], markers[i % 6], ms=3.5, color=fig.BLUE, label=f"route {i + 1}")
    ax.plot([], [], "*", ms=7, color=fig.RED, label="over routes")
    ax.axvline(1.0, color="black", lw=0.6)
    panels.category_axis(ax, [USES[point._replace(protocol="paper")] for point in TRANSFER])
    ax.set(xlabel="mean error, VOI-Control / periodic", xscale="log", ylim=(len(TRANSFER) - 0.4, -0.4))
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper center", bbox_to_anchor=(0.4, -0.2), ncols=4, columnspacing=0.8, handletextpad=0.1)
