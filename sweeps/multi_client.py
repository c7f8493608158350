"""Fig. and Table "high congestion": five schedulers on recorded VOI-Control requests of many clients."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_drawing import COLOURS, NAMES, events_of
from ovibjax.control.policy_study import seeds_to_keys
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, Claim, Interval, interval, positive, weakest, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import console
from ovibjax.scheduling.clients import Events, ReplayMetrics, default_trace_params
from ovibjax.scheduling.congestion import LEVELS, PHASE_SPREAD_S, Case, compare
from ovibjax.scheduling.rules import POLICIES, default_params

TITLE = "Whom to serve: schedulers under congestion"
VS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
SPREADS_S = (0.27, 0.54, 1.08, 2.16, 4.32)
LOADS = (10, 20, 30, 45)
PAPER_TOP = {"maxweight": (198.0, 142.4, 0.022, 1.87), "base_dpp": (193.0, 137.7, 0.022, 1.82)}
PAPER_TOP |= {"voi_lyapunov": (88.5, 32.8, 0.012, 1.12)}
PAPER_ALL_EDGE = {"voi_lyapunov": 185.7, "base_dpp": 232.5, "maxweight": 217.8, "fifo": 93.2, "edf": 106.7}
METRICS = ("edge_p95_ms", "e2e_p95_ms", "stale_m", "cost")


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        seeds: scheduler seeds.
        sensitivity_seeds: those of the sensitivity panel.
    """

    seeds: int
    sensitivity_seeds: int


PRESETS = {"smoke": Preset(2, 2), "quick": Preset(16, 8), "full": Preset(64, 32)}


@dataclass(frozen=True)
class Found:
    """Metrics on the host.

    Attributes:
        levels: [levels, seeds, V] by policy.
        varied: [spreads x loads, seeds, 1] by policy, at 4 KB/s.
        requests: requests per client.
    """

    levels: dict[str, ReplayMetrics]
    varied: dict[str, ReplayMetrics]
    requests: int

    def at(self, policy: str, scope: str, metric: str, level: str = "high") -> np.ndarray:
        """[seeds] a metric at the paper's V."""
        group = getattr(self.levels[policy], "top" if scope == "top10" else "every")
        values = np.asarray(getattr(group, metric), np.float64)
        return values[list(LEVELS).index(level), :, VS.index(8.0)]


def run(job: Job) -> None:
    """Run the card: recorded requests, replays, table, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    events = events_of(job)
    seeds = [job.seed + i for i in range(preset.seeds)]
    with console.status("replaying the schedulers"):
        found = replay(events, seeds, preset)
    write_rows(job.out / "table.csv", table_rows(found, seeds))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    job.record(TITLE, caption(found, seeds), seeds, started, phase_spread_s=PHASE_SPREAD_S, requests=found.requests)


def replay(events: Events, seeds: list[int], preset: Preset) -> Found:
    """Replay the paper's congestion levels over V, and the sensitivity cases."""
    params, trace = default_params(), default_trace_params()
    clients, rates = zip(*LEVELS.values(), strict=True)
    keys = seeds_to_keys(seeds)
    levels = compare(
        keys,
        events,
        Case(jnp.array(clients), jnp.array(rates, jnp.float32), jnp.full(len(clients), PHASE_SPREAD_S, jnp.float32)),
        trace,
        params._replace(V=jnp.array(VS, jnp.float32)),
        max(clients),
    )
    places = [(load, spread) for spread in SPREADS_S for load in LOADS]
    cases = Case(
        jnp.array([load for load, _ in places]),
        jnp.full(len(places), LEVELS["high"][1], jnp.float32),
        jnp.array([spread for _, spread in places], jnp.float32),
    )
    rivals = ("voi_lyapunov", "base_dpp", "fifo")
    varied = compare(keys[: preset.sensitivity_seeds], events, cases, trace, params, max(LOADS), rivals)
    return Found(jax.device_get(levels), jax.device_get(varied), int(events.valid.sum()))


def table_rows(found: Found, seeds: list[int]) -> list[dict[str, Any]]:
    """One row per congestion level, policy, seed and scope, at the paper's V."""
    return [
        {
            "congestion": level,
            "policy": policy,
            "seed": seed,
            "scope": scope,
            **{metric: float(found.at(policy, scope, metric, level)[i]) for metric in METRICS},
        }
        for level in LEVELS
        for policy in POLICIES
        for i, seed in enumerate(seeds)
        for scope in ("top10", "all")
    ]


def judge_claims(found: Found) -> list[Claim]:
    """The paper's table, judged on paired seeds at high congestion."""
    claims = []
    for metric, word, paper, unit, digits in (
        ("edge_p95_ms", "edge p95", "32.8 / 137.7 / 142.4 ms", "ms", 1),
        ("e2e_p95_ms", "end-to-end p95", "88.5 / 193.0 / 198.0 ms", "ms", 1),
        ("cost", "weighted cost", "1.12 / 1.82 / 1.87", "", 2),
        ("stale_m", "stale-feedback penalty", "0.012 / 0.022 / 0.022 m", "m", 4),
    ):
        ours = found.at("voi_lyapunov", "top10", metric)
        rivals = {p: found.at(p, "top10", metric) for p in POLICIES if p != "voi_lyapunov"}
        order = ("base_dpp", "maxweight", "edf", "fifo")
        texts = [interval(ours).text(unit, digits), *(interval(rivals[p]).text(unit, digits) for p in order)]
        claims.append(
            Claim(
                f"Top decile at high congestion: VOI-Lyapunov has the lowest {word} of the five",
                paper,
                " / ".join(texts) + " (Base-DPP, MaxWeight, EDF, FIFO)",
                weakest(positive(interval(rival - ours)) for rival in rivals.values()),
                "paired 95 % interval against every other policy above zero",
            )
        )
    voi, base = (found.at(p, "top10", "edge_p95_ms") for p in ("voi_lyapunov", "base_dpp"))
    percent = interval(100.0 * (base - voi) / base)
    claims.append(
        Claim(
            "Top decile at high congestion: VOI-Lyapunov cuts the edge p95 of Base-DPP",
            "76.2 %",
            percent.text("%", 1),
            positive(percent),
            "paired 95 % interval above zero",
        )
    )
    return [*claims, *_all_requests(found)]


def _all_requests(found: Found) -> list[Claim]:
    claims = []
    for fast in ("fifo", "edf"):
        for slow in ("base_dpp", "maxweight"):
            span = interval(found.at(slow, "all", "edge_p95_ms") - found.at(fast, "all", "edge_p95_ms"))
            texts = [interval(found.at(p, "all", "edge_p95_ms")).text("ms", 1) for p in (fast, slow)]
            claims.append(
                Claim(
                    f"All requests at high congestion: {NAMES[fast]} has a lower edge p95 than {NAMES[slow]}",
                    f"{PAPER_ALL_EDGE[fast]} / {PAPER_ALL_EDGE[slow]} ms",
                    f"{' / '.join(texts)}, difference {span.text('ms', 1)}",
                    positive(span),
                    "paired 95 % interval above zero",
                )
            )
    equal = np.array_equal(found.at("fifo", "all", "edge_p95_ms"), found.at("maxweight", "all", "edge_p95_ms"))
    claims.append(
        Claim(
            "MaxWeight differs from FIFO",
            "217.8 / 93.2 ms",
            "the same service order: no client ever has two requests waiting, so every backlog is one and ties go to "
            "the earliest"
            if equal
            else "different orders",
            NOT_HELD if equal else HELD,
            "edge p95 of all requests not equal on every seed",
        )
    )
    return claims


def caption(found: Found, seeds: list[int]) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"Clients replay the {found.requests} VOI-Control requests of a held-out route; {len(seeds)} seeds perturb the "
        f"phase (within {PHASE_SPREAD_S:g} s, set once so that FIFO's edge p95 of all requests at high congestion lies "
        "near the paper's 93 ms), urgency, deadlines and service jitter. (a), (b) High congestion (N = 30, 4 KB/s), "
        "95 % intervals; black ticks: the paper's values. (c) Edge p95 of the top decile by congestion. (d) Reduction "
        "of that p95 by VOI-Lyapunov against Base-DPP as phase spread and number of clients vary."
    )


def draw(path: Path, found: Found) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.2)
        _draw_bars(axes[0], found, "cost", {p: PAPER_TOP[p][3] for p in PAPER_TOP})
        axes[0].set(xlabel="weighted cost, top decile")
        fig.title(axes[0], "a", "cost of the requests that matter")
        _draw_edge(axes[1], found)
        _draw_levels(axes[2], found)
        _draw_sensitivity(axes[3], found)
        fig.save_figure(figure, path)


def _half(span: Interval) -> float:
    return span.half if np.isfinite(span.half) else 0.0


def _draw_bars(ax: Axes, found: Found, metric: str, paper: dict[str, float]) -> None:
    for row, policy in enumerate(NAMES):
        span = interval(found.at(policy, "top10", metric))
        ax.barh(row, span.mean, xerr=_half(span), height=0.62, color=COLOURS[policy], error_kw={"lw": 1, "capsize": 2})
        ax.text(0.03 * span.mean, row, f"{span.mean:.2f}", va="center", color="white", fontsize=6.5, weight="bold")
        if policy in paper:
            ax.plot(paper[policy], row, "|", ms=12, mew=1.6, color="black", label="paper" if row == 0 else None)
    ax.set_yticks(range(len(NAMES)), list(NAMES.values()))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="upper right")


def _draw_edge(ax: Axes, found: Found) -> None:
    for row, policy in enumerate(NAMES):
        for scope, offset, alpha in (("top10", -0.19, 1.0), ("all", 0.19, 0.45)):
            span = interval(found.at(policy, scope, "edge_p95_ms"))
            place = row + offset
            look: dict[str, Any] = {"color": COLOURS[policy], "alpha": alpha, "error_kw": {"lw": 1, "capsize": 2}}
            ax.barh(place, span.mean, xerr=_half(span), height=0.36, **look)
            paper = PAPER_TOP[policy][1] if scope == "top10" and policy in PAPER_TOP else None
            paper = PAPER_ALL_EDGE[policy] if scope == "all" else paper
            if paper is not None:
                ax.plot(paper, place, "|", ms=7, mew=1.6, color="black")
            ax.text(span.mean + _half(span), place, f" {span.mean:.0f}", va="center", fontsize=6)
    ax.set_yticks(range(len(NAMES)), list(NAMES.values()))
    ax.invert_yaxis()
    ax.set(xlabel="edge p95 (ms): solid top decile, pale all requests")
    ax.grid(visible=False, axis="y")
    fig.title(ax, "b", "edge latency")


def _draw_levels(ax: Axes, found: Found) -> None:
    x = np.arange(len(LEVELS))
    for policy in NAMES:
        spans = [interval(found.at(policy, "top10", "edge_p95_ms", level)) for level in LEVELS]
        width = {"base_dpp": 4.5, "maxweight": 2.6}.get(policy, 1.2)  # these may lie under FIFO
        ax.errorbar(
            x,
            [s.mean for s in spans],
            [_half(s) for s in spans],
            fmt="o-",
            lw=width,
            ms=3.5,
            color=COLOURS[policy],
            label=NAMES[policy],
            capsize=2,
        )
    ax.set_xticks(x, [f"{name}\nN = {n}, {rate:g} KB/s" for name, (n, rate) in LEVELS.items()])
    ax.set(ylabel="edge p95, top decile (ms)")
    ax.set_ylim(bottom=0)
    ax.legend(loc="upper left")
    fig.title(ax, "c", "congestion separates the rules")


def _draw_sensitivity(ax: Axes, found: Found) -> None:
    voi, base = (np.asarray(found.varied[p].top.edge_p95_ms, np.float64)[..., 0] for p in ("voi_lyapunov", "base_dpp"))
    reduction = (100.0 * (base - voi) / base).reshape(len(SPREADS_S), len(LOADS), -1)
    for i, load in enumerate(LOADS):
        curve = reduction[:, i].T
        colour = (fig.SKY, fig.GREEN, fig.BLUE, fig.RED)[i]
        mean, half = fig.mean_and_half(curve)
        ax.fill_between(SPREADS_S, mean - half, mean + half, color=colour, alpha=0.18, lw=0)
        ax.plot(SPREADS_S, mean, "o-", ms=3, color=colour, label=f"N = {load}")
    ax.axhline(0, color="black", lw=0.8)
    ax.axvline(PHASE_SPREAD_S, color="black", lw=0.8, ls=":")
    ax.set(xlabel="phase spread (s)", ylabel="reduction of edge p95 (%)", xscale="log")
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper right", ncols=2)
    fig.title(ax, "d", "VOI-Lyapunov against Base-DPP")
