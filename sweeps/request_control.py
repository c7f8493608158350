"""Fig. "Budget-constrained request-control dynamics": held-out errors, an error curve, and when requests are sent."""

import time
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.control_claims import transfer_claims
from ovibjax.cards.control_drawing import COLOURS, NAMES, PAPER_MEAN_M, PAPER_P95_M, draw_error
from ovibjax.cards.control_results import policy_rows, representative, representative_replay, study
from ovibjax.cards.control_study import ControlStudy
from ovibjax.cards.correction_drawing import calibration_rows, draw_calibration, draw_routes, draw_uses
from ovibjax.cards.job import Job
from ovibjax.cards.timeline import draw_requests, legend, shade, time_s
from ovibjax.control.controller import GATE_SIGMA, PAPER_BUDGET_KB
from ovibjax.report import panels
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows

TITLE = "Request-control dynamics under the 2.1 KB budget"


def run(job: Job) -> None:
    """Run the card: study, table, claims, figure."""
    started = time.perf_counter()
    found = study(job)
    seed = found.seeds[representative(found)]
    write_rows(job.out / "table.csv", policy_rows(found))
    write_rows(job.out / "calibration.csv", calibration_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 2, height_in=2.2)
    job.record(TITLE, caption(found), found.seeds, started, representative_seed=seed)


def judge_claims(found: ControlStudy) -> list[Claim]:
    """What the paper says of the dynamics."""
    grown = {policy: drift_when_asking(found, policy) for policy in ("voi", "budgeted_periodic")}
    both = np.isfinite(list(grown.values())).all(axis=0)
    grown = {policy: rate[both] for policy, rate in grown.items()}
    free_kb = found.free_kb()
    return [
        _lower(found, "fixed_front"),
        _lower(found, "random"),
        Claim.less(
            "VOI-Control sends its requests where uncertainty grows faster than at as many evenly spaced ones",
            "concentrates uploads around uncertainty growth",
            " / ".join(f"{NAMES[policy]} {interval(rate).text('m/s')}" for policy, rate in grown.items())
            + " of drift at a request",
            *(grown["budgeted_periodic"], grown["voi"]),
            rule="whole 95 % interval of the paired difference above zero",
        ),
        Claim.at_most(
            f"VOI-Control stays within {PAPER_BUDGET_KB} KB per route by its prices, without the cap",
            "22 requests, 2.07 KB",
            f"{interval(free_kb).text('KB')}; under the cap {interval(found.of('voi', 'requests')).text(digits=1)} "
            f"requests, {interval(found.of('voi', 'kb')).text('KB')}",
            PAPER_BUDGET_KB,
            free_kb,
            rule=f"whole 95 % interval of the payload without a cap below {PAPER_BUDGET_KB} KB",
        ),
        _calibrated(found).as_own(),
        *transfer_claims(found),
    ]


def _calibrated(found: ControlStudy) -> Claim:
    rows = [row for row in calibration_rows(found) if row["action"] == "FS-C"]
    texts = [f"{row['claimed_rms_m']:.1f} / {row['realised_rms_m']:.1f} m ({row['routes']})" for row in rows]
    return Claim.reported(
        "Root mean square of the edge's error as its answers claim it, and as it is (front plus sides, compact)",
        "-",
        ", ".join(texts),
        "fitted on training routes, where both are equal; calibration.csv has every action",
    )


def drift_when_asking(found: ControlStudy, policy: str) -> np.ndarray:
    """[seeds] mean drift rate, m/s, in the slots in which a policy asked; NaN where it sent none."""
    sent = found.runs[policy].sent
    rate = np.asarray(found.env.drift.rate_m_per_s)[found.route.context]
    return np.where(sent.any(axis=1), (rate * sent).sum(axis=1) / np.maximum(sent.sum(axis=1), 1), np.nan)


def _lower(found: ControlStudy, rival: str) -> Claim:
    errors = [found.of(rival, metric) for metric in ("mean_m", "p95_m")]
    differences = [found.of(rival, metric) - found.of("voi", metric) for metric in ("mean_m", "p95_m")]
    ours, over = (" / ".join(interval(part).text("m") for part in parts) for parts in (errors, differences))
    return Claim.above_zero(
        f"VOI-Control has a lower mean and p95 error than {NAMES[rival]} under the same budget",
        f"{PAPER_MEAN_M[rival]} / {PAPER_P95_M[rival]} m against {PAPER_MEAN_M['voi']} / {PAPER_P95_M['voi']} m",
        f"{NAMES[rival]} {ours}; differences {over}",
        *differences,
        rule="whole 95 % intervals of both paired differences above zero",
    )


def caption(found: ControlStudy) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"(a), (b) Mean and 95th percentile of the route error over {len(found.seeds)} held-out seeds, 95 % intervals; "
        "black ticks: the paper's values on its own route; diamonds: the same where corrections do not replace the "
        "estimate but are fused with it by their calibrated risk, which the paper does not say. Bars may go on beyond "
        "the panel; their value stands beside the name. Oracle action is a bound, no causal policy, and not held to "
        "the budget. (c) Error along the held-out route, seed "
        f"{found.seeds[representative(found)]}, the median one: VOI-Control and budgeted "
        "periodic on the same drift and channel; where the error jumps, the edge took a look-alike for the place. (d) "
        "The same seed: local risk, and VOI-Control's requests by view mode; background: route context. (e) Held-out "
        "routes: root mean square error of the answers that claim the same risk, sized by their share; on the dashed "
        "line they keep what was fitted on training routes. (f) Mean error by what a client does with a correction "
        f"(gate: those beyond {GATE_SIGMA:g} sigma of what it expects are discarded); open: with references that have "
        "passed through the code of the request. (g) Prices tuned on other routes; blue: the "
        f"{len(found.scene.held_out)} held-out routes with intervals over seeds; red: geometric mean with its interval "
        "over routes."
    )


def _draw_curve(ax: Axes, found: ControlStudy) -> None:
    seed = representative(found)
    for policy in ("budgeted_periodic", "voi"):
        run = found.runs[policy]
        label = f"{NAMES[policy]}: {run.error_m[seed].mean():.1f} m"
        ax.plot(time_s(run.error_m.shape[1]), run.error_m[seed], color=COLOURS[policy], lw=1.1, label=label)
    shade(ax, found.route.context, found.scene.contexts)
    ax.set(xlabel="time (s)", ylabel="route error (m)")
    ax.set_ylim(0, 1.45 * max(float(found.runs[policy].error_m[seed].max()) for policy in ("budgeted_periodic", "voi")))
    ax.legend(loc="upper right", frameon=True, framealpha=0.85, edgecolor="none")


def _draw_requests(ax: Axes, found: ControlStudy) -> None:
    draw_requests(ax, representative_replay(found), found.scene.actions)
    shade(ax, found.route.context, found.scene.contexts)
    legend(ax, found.scene.contexts)
    ax.set(xlabel="time (s)")


PANELS: dict[str, panels.Panel] = {
    "mean error": partial(draw_error, metric="mean_m", paper_m=PAPER_MEAN_M),
    "95th percentile": partial(draw_error, metric="p95_m", paper_m=PAPER_P95_M),
    "one held-out route": _draw_curve,
    "requests of VOI-Control": _draw_requests,
    "risk that comes with an answer": draw_calibration,
    "what a client makes of a correction": draw_uses,
    "on routes that prices were not tuned on": draw_routes,
}
