"""The six weights of VOI-Lyapunov and the V of Base-DPP, searched: what is left on the table beside the paper's."""

import itertools
import time
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.cards.scheduling_study import PAIRED, PAPER_V, SCOPES, VS, events_of, metric_columns, metric_of
from ovibjax.cards.weight_search import SETTINGS, WeightSearch, search_weights
from ovibjax.report import figures as fig
from ovibjax.report import panels
from ovibjax.report.claims import Claim, Interval, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.rules import Weights

TITLE = "Scheduler weights, searched"
NAMES = {"paper": "paper's weights", "tuned_top10": "tuned: top decile", "tuned_all": "tuned: all requests"}
COLOURS = {"paper": fig.BLUE, "tuned_top10": fig.RED, "tuned_all": fig.GREEN}


@dataclass(frozen=True)
class Preset:
    """Size of the search.

    Attributes:
        candidates: weight vectors tried, the paper's among them.
        tuning_seeds: seeds 0, 1, ... they are tried on.
        held_out_seeds: seeds they are judged on.
    """

    candidates: int
    tuning_seeds: int
    held_out_seeds: int


PRESETS = {"smoke": Preset(32, 2, 2), "quick": Preset(1024, 4, 16), "full": Preset(4096, 8, 64)}


def run(job: Job) -> None:
    """Run the card: search, held-out comparison, tables, claims, figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    tuning_seeds = list(range(preset.tuning_seeds))
    seeds = [job.seed + i for i in range(preset.held_out_seeds)]
    events = events_of(job)
    with job.stage("replay"):
        found = search_weights(events, preset.candidates, tuning_seeds, seeds)
    write_rows(job.out / "table.csv", table_rows(found, seeds))
    write_rows(job.out / "weights.csv", weight_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 3, height_in=2.4)
    tuning = f"0 to {preset.tuning_seeds - 1}"
    job.record(TITLE, caption(preset, seeds), seeds, started, tuning_seeds=tuning, candidates=preset.candidates)


def table_rows(found: WeightSearch, seeds: list[int]) -> list[dict[str, Any]]:
    """One row per setting, held-out seed and scope."""
    return [
        {"setting": setting, "seed": seed, "scope": scope} | metric_columns(found.held_out, scope, (0, i, column))
        for column, setting in enumerate(SETTINGS)
        for i, seed in enumerate(seeds)
        for scope in SCOPES
    ]


def weight_rows(found: WeightSearch) -> list[dict[str, Any]]:
    """The weights of each setting."""
    return [
        {"setting": setting, **{n: float(w) for n, w in zip(Weights._fields, found.tried[c], strict=True)}}
        for setting, c in zip(SETTINGS, found.chosen, strict=True)
    ]


def judge_claims(found: WeightSearch) -> list[Claim]:
    """What tuning gains on held-out seeds (no claim of the paper)."""
    change = interval(found.of("tuned_top10", "all", "edge_p95_ms") - found.of("paper", "all", "edge_p95_ms"))
    claims = [
        _gain(found, "tuned_top10", "top10", "the top decile"),
        _gain(found, "tuned_all", "all", "all requests"),
        Claim.reported(
            "What tuning for the top decile does to all requests: change of their edge p95",
            "-",
            change.text("ms", 1),
            "tuned minus paper's, paired",
        ),
        _gain_of_v(found),
    ]
    return [claim.as_own() for claim in claims]


def _gain(found: WeightSearch, setting: str, scope: str, word: str) -> Claim:
    paper, tuned = found.of("paper", scope, "cost"), found.of(setting, scope, "cost")
    percent = interval(100.0 * (paper - tuned) / paper.mean())
    return Claim.less(
        f"Weights tuned for the cost of {word} beat the paper's on held-out seeds",
        "fixed before testing",
        f"cost {interval(tuned).text()} against {interval(paper).text()}, {percent.text('%', 1)} lower",
        *(tuned, paper),
        rule=PAIRED,
    )


def _gain_of_v(found: WeightSearch) -> Claim:
    cost = metric_of(found.base_dpp, "top10", "cost")[0]
    gain = cost[:, PAPER_V] - cost[:, found.best_v]
    statement = f"Base-DPP gains from another V than 8 (tuned: {VS[found.best_v]:g})"
    ours = f"top-decile cost lower by {interval(gain).text()}"
    if found.best_v == PAPER_V:
        return Claim.reported(statement, "V = 8", ours, PAIRED)
    return Claim.above_zero(statement, "V = 8", ours, gain, rule=PAIRED)


def caption(preset: Preset, seeds: list[int]) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"High congestion (30 clients, 4 KB/s). (a) {preset.candidates} weight vectors of VOI-Lyapunov on "
        f"{preset.tuning_seeds} tuning seeds; stars: the paper's, and the best for either cost. (b) Cost on "
        f"{len(seeds)} held-out seeds, 95 % intervals. (c) The weights: value per service, value, laxity, age, "
        "overrun, service."
    )


def _draw_search(ax: Axes, found: WeightSearch) -> None:
    top, every = found.tuning[:, 0], found.tuning[:, 2]
    ax.plot(top, every, ".", ms=1.5, color=fig.SKY, alpha=0.6)
    for setting, c in zip(SETTINGS, found.chosen, strict=True):
        panels.star(ax, top[c], every[c], NAMES[setting], COLOURS[setting])
    ax.set(xlabel="cost, top decile", ylabel="cost, all requests")
    ax.legend(loc="upper right", frameon=True, framealpha=0.85, edgecolor="none")


def _draw_held_out(ax: Axes, found: WeightSearch) -> None:
    costs = {setting: [interval(found.of(setting, scope, "cost")) for scope in SCOPES] for setting in SETTINGS}
    series = [(NAMES[setting], COLOURS[setting], spans) for setting, spans in costs.items()]
    places = panels.columns(ax, ["top decile", "all requests"], series)
    for x, span in zip(places.ravel(), itertools.chain(*costs.values()), strict=True):
        ax.text(x, 0.03, f"{span.mean:.2f}", ha="center", color="white", fontsize=6, rotation=90, va="bottom")
    ax.set(ylabel="weighted cost")


def _draw_weights(ax: Axes, found: WeightSearch) -> None:
    picked = zip(SETTINGS, found.tried[list(found.chosen)], strict=True)
    series = [(NAMES[setting], COLOURS[setting], [Interval(w, 0.0) for w in weights]) for setting, weights in picked]
    panels.columns(ax, ["v/G", "v", "laxity", "age", "overr.", "G"], series)
    ax.set(ylabel="weight", yscale="log")
    fig.plain_log_ticks(ax.yaxis, subs=(1.0, 3.0))


PANELS = {"tuning seeds": _draw_search, "held-out seeds": _draw_held_out, "the weights": _draw_weights}
