"""Fig. "Budget-constrained request-control dynamics": held-out errors, an error curve, and when requests are sent."""

import time
from pathlib import Path

import jax
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_drawing import COLOURS, NAMES, policy_rows, representative, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.job import Job
from ovibjax.cards.timeline import draw_requests, legend, shade, time_s
from ovibjax.control.policies import POLICIES
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, below, interval, positive, weakest, write_claims
from ovibjax.report.rows import write_rows

TITLE = "Request-control dynamics under the 2.1 KB budget"
PAPER = {"voi": (4.13, 6.71), "fixed_front": (5.64, 8.41), "random": (6.43, 13.43)}
PAPER |= {"uncertainty": (4.21, 7.01), "budgeted_periodic": (5.49, 9.73)}


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    write_rows(job.out / "table.csv", policy_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    job.record(TITLE, caption(found), found.seeds, started, representative_seed=found.seeds[representative(found)])


def judge_claims(found: ControlStudy) -> list[Claim]:
    """What the paper says of the dynamics."""
    claims = []
    for rival in ("fixed_front", "random"):
        spans = [interval(found.of(rival, m) - found.of("voi", m)) for m in ("mean_m", "p95_m")]
        ours = " / ".join(interval(found.of(rival, m)).text("m") for m in ("mean_m", "p95_m"))
        claims.append(
            Claim(
                f"VOI-Control has a lower mean and p95 error than {NAMES[rival]} under the same budget",
                f"{PAPER[rival][0]} / {PAPER[rival][1]} m against {PAPER['voi'][0]} / {PAPER['voi'][1]} m",
                f"{NAMES[rival]} {ours}; differences {spans[0].text('m')} / {spans[1].text('m')}",
                weakest(positive(span) for span in spans),
                "whole 95 % intervals of both paired differences above zero",
            )
        )
    voi = found.runs["voi"]
    at_request = [float(voi.risk_before_m[i][voi.sent[i]].mean()) for i in range(len(found.seeds)) if voi.sent[i].any()]
    overall = [float(voi.risk_before_m[i].mean()) for i in range(len(found.seeds)) if voi.sent[i].any()]
    growth = interval(np.array(at_request) - np.array(overall))
    requests, kb = interval(found.of("voi", "requests")), interval(found.of("voi", "kb"))
    claims += [
        Claim(
            "VOI-Control sends its requests when uncertainty has grown",
            "concentrates uploads around uncertainty growth",
            f"local risk at a request minus its mean over all slots: {growth.text('m')}",
            positive(growth),
            "whole 95 % interval above zero",
        ),
        Claim(
            "VOI-Control stays within 2.1 KB per route",
            "22 requests, 2.07 KB",
            f"{requests.text(digits=1)} requests, {kb.text('KB')}",
            below(kb, 2.1),
            "whole 95 % interval below 2.1 KB; no single replay may exceed it (see the prediction figure)",
        ),
    ]
    return claims


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"(a), (b) Mean and 95th percentile of the route error over {len(found.seeds)} held-out seeds, 95 % intervals; "
        "black ticks: the paper's values on its own route. Oracle action is a bound, no causal policy. (c) Error along "
        f"the held-out route of seed {found.seeds[representative(found)]}, the median one: VOI-Control and budgeted "
        "periodic on the same drift and channel. (d) The same seed: local risk, and VOI-Control's requests by view "
        "mode; background: route context."
    )


def draw(path: Path, found: ControlStudy) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.2)
        order = sorted(POLICIES, key=lambda policy: float(found.of(policy, "mean_m").mean()))
        _draw_bars(axes[0], found, order, "mean_m", 0)
        fig.title(axes[0], "a", "mean error")
        _draw_bars(axes[1], found, order, "p95_m", 1)
        fig.title(axes[1], "b", "95th percentile")
        _draw_curve(axes[2], found)
        _draw_requests(axes[3], found)
        fig.save_figure(figure, path)


def _draw_bars(ax: Axes, found: ControlStudy, order: list[str], metric: str, paper: int) -> None:
    for row, policy in enumerate(order):
        span = interval(found.of(policy, metric))
        half = span.half if np.isfinite(span.half) else 0.0
        ax.barh(row, span.mean, xerr=half, height=0.65, color=COLOURS[policy], error_kw={"lw": 1, "capsize": 2})
        text_colour = "black" if policy == "periodic" else "white"
        ax.text(0.02 * span.mean, row, f" {span.mean:.2f}", va="center", color=text_colour, fontsize=6.5, weight="bold")
        if policy in PAPER:
            ax.plot(PAPER[policy][paper], row, "|", ms=11, mew=1.6, color="black")
    ax.plot([], [], "|", ms=8, mew=1.6, color="black", label="paper")
    ax.set_yticks(range(len(order)), [NAMES[policy] for policy in order])
    ax.set(xlabel="route error (m)")
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="upper right")


def _draw_curve(ax: Axes, found: ControlStudy) -> None:
    seed = representative(found)
    for policy in ("budgeted_periodic", "voi"):
        run = found.runs[policy]
        label = f"{NAMES[policy]}: {run.error_m[seed].mean():.1f} m"
        ax.plot(time_s(run.error_m.shape[1]), run.error_m[seed], color=COLOURS[policy], lw=1.1, label=label)
    shade(ax, found.routes.context[seed], found.scene.contexts)
    ax.set(xlabel="time (s)", ylabel="route error (m)")
    ax.set_ylim(0, 1.45 * max(float(found.runs[policy].error_m[seed].max()) for policy in ("budgeted_periodic", "voi")))
    ax.legend(loc="upper right", frameon=True, framealpha=0.85, edgecolor="none")
    fig.title(ax, "c", "one held-out route")


def _draw_requests(ax: Axes, found: ControlStudy) -> None:
    seed = representative(found)
    draw_requests(ax, jax.tree.map(lambda field: field[seed], found.runs["voi"]), found.scene.actions)
    shade(ax, found.routes.context[seed], found.scene.contexts)
    legend(ax, found.scene.contexts)
    ax.set(xlabel="time (s)")
    fig.title(ax, "d", "requests of VOI-Control")
