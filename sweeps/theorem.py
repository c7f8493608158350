"""The scheduler's theorem under its own assumptions (not in the paper): utility gap, backlog, capacity region."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from ovibjax.cards.job import Job
from ovibjax.cards.theorem_drawing import draw_backlog, draw_gap, draw_growth
from ovibjax.cards.theorem_study import (
    BUSY,
    CLIENTS,
    LIGHT,
    LOAD_V,
    LOADS,
    PENDING_BUSY,
    PENDING_LIGHT,
    PROOF_BUSY,
    PROOF_LIGHT,
    SETTINGS,
    SHIFTED_LIGHT,
    WARM_UP,
    TheoremRuns,
    TheoremSize,
    measure,
)
from ovibjax.report import panels
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.slotted_replay import Horizon
from ovibjax.scheduling.theorem import Setting

TITLE = "Theorem of the slotted scheduler"
A_THEOREM = "a theorem"

PRESETS = {
    "smoke": TheoremSize(3, 32, (1.0, 8.0, 64.0), Horizon(100, 20)),
    "quick": TheoremSize(5, 128, tuple(2.0**i for i in range(8)), Horizon(100, 500)),
    "full": TheoremSize(10, 128, tuple(2.0**i for i in range(9)), Horizon(200, 1000)),
}


def run(job: Job) -> None:
    """Run the card: benchmarks by linear programming, one sweep, tables, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.seeds)]
    found = measure(job, preset, seeds)
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "stability.csv", growth_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        panels.draw_panels(job.out / "figure.png", found, PANELS, 3, height_in=2.6)
    job.record(
        *(TITLE, caption(preset), seeds, started),
        slots=preset.horizon.blocks * preset.horizon.slots,
        members_of_an_earlier_run=found.resumed,
    )


def table_rows(found: TheoremRuns) -> list[dict[str, Any]]:
    """One tidy row per setting, V and seed."""
    rows: list[dict[str, Any]] = []
    for setting in SETTINGS:
        for v in found.runs.V.values:
            for seed in found.runs.seed.values:
                part = found.runs.sel(setting=setting.name, V=v, seed=seed)
                known = {"reading": setting.reading, "load": setting.load, "V": float(v), "seed": int(seed)}
                names = map(str, part.data_vars)
                values = {name if "backlog" in name else f"{name}_m": float(part[name]) for name in names}
                rows.append(known | values)
    return rows


def growth_rows(found: TheoremRuns) -> list[dict[str, Any]]:
    """Backlog over slots by load and length, with its interval, and the least of any policy."""
    rows: list[dict[str, Any]] = []
    for load in found.growth["load"].values:
        least = float(found.growth.least.sel(load=load).mean())
        for slots in found.growth.slots.values:
            span = interval(found.growth.measured.sel(load=load, slots=slots).values)
            row = {"load": float(load), "slots": int(slots), "backlog_per_slot": span.mean, "half_width": span.half}
            rows.append(row | {"least_of_any_policy": least})
    return rows


def judge_claims(found: TheoremRuns) -> list[Claim]:
    """The theorem's statements, judged by what a bound implies: being below it, with the constants of the proof."""
    proof, pending = (PROOF_BUSY, PROOF_LIGHT), (PENDING_BUSY, PENDING_LIGHT)
    gap, backlog = "utility gap at most C_0 / V", "average backlog O(V)"
    return [
        _bound_claim(found, "gap", proof, f"In the proof's setting: {gap}", A_THEOREM),
        _bound_claim(found, "backlog", proof, f"In the proof's setting: {backlog}", A_THEOREM),
        _bound_claim(found, "gap", (PENDING_BUSY,), f"Serving pending requests only, busy: {gap}", A_THEOREM),
        _bound_claim(found, "gap", (PENDING_LIGHT,), f"Serving pending requests only, light load: {gap}", A_THEOREM),
        _bound_claim(found, "backlog", pending, f"Serving pending requests only: {backlog}", A_THEOREM),
        _bound_claim(
            found, "gap", (SHIFTED_LIGHT,), f"The same with ν less its maximum, light load: {gap}", "-"
        ).as_own(),
        _bound_claim(found, "backlog", (SHIFTED_LIGHT,), f"The same with ν less its maximum: {backlog}", "-").as_own(),
        *_growth_claims(found),
    ]


def _bound_claim(found: TheoremRuns, metric: str, settings: Sequence[Setting], statement: str, paper: str) -> Claim:
    v = found.runs.V.values
    unit, digits = ("m per slot", 4) if metric == "gap" else ("requests", 1)
    texts = []
    for setting in settings:
        first, last = (interval(found.at(setting, metric)[:, i]) for i in (0, -1))
        share = max(interval(share).mean for share in found.used(setting, metric))
        texts.append(
            f"load {setting.load:g}: {first.text(digits=digits)} at V = {v[0]:g}, {last.text(unit, digits)} at "
            f"V = {v[-1]:g}"
            + (f", of at best {interval(found.at(setting, 'best')[:, 0]).text('m')}" if metric == "gap" else "")
            + f"; slope {found.slope(setting, metric).text()}; up to {share:.2f} times the bound"
        )
    shares = (share for setting in settings for share in found.used(setting, metric))
    rule = f"interval of {metric} / bound at most 1 at every V; O() is an upper bound and implies no slope"
    return Claim.at_most(statement, paper, "; ".join(texts), 1.0, *shares, rule=rule)


def _growth_claims(found: TheoremRuns) -> list[Claim]:
    """Mean-rate stability of eq. voi_scheduler inside the capacity region, and growth outside."""
    before, after = found.growth.slots.values[-2:]
    early, late = (found.growth.measured.sel(slots=slots) for slots in (before, after))
    at = {load: f"{interval(late.sel(load=load).values).text(digits=4)} at load {load:g}" for load in LOADS}
    inside, outside = [load for load in LOADS if load < 1], [load for load in LOADS if load > 1]
    falls = [late.sel(load=x).values / np.maximum(early.sel(load=x).values, 1 / before) for x in inside]
    shares = [late.sel(load=x).values / found.growth.least.sel(load=x).values for x in outside]
    return [
        Claim.at_most(
            "Queues mean-rate stable inside the capacity region",
            A_THEOREM,
            f"Q(T) / T at T = {after}: {', '.join(at[load] for load in inside)} requests per slot; at most "
            f"{max(interval(fall).mean for fall in falls):.2f} of that at T = {before}",
            0.5,
            *falls,
            rule="ten times the slots at least halve Q(T) / T at every load below 1 (stable: a tenth; growing: no "
            "change)",
        ),
        Claim.at_least(
            "Outside it the backlog grows in proportion to time, as it must under any policy",
            "-",
            f"Q(T) / T at T = {after}: {', '.join(at[load] for load in outside)} requests per slot; at most "
            f"{max(interval(share).mean for share in shares):.2f} times the least possible",
            0.9,
            *shares,
            rule="at least 0.9 of the least growth of any policy (a linear program) at every load above 1",
        ).as_own(),
    ]


def caption(preset: TheoremSize) -> str:
    """What the reader of the figure needs to know."""
    slots = preset.horizon.blocks * preset.horizon.slots
    return (
        "Not in the paper: its theorem on the exact slotted optimizer, simulated under the theorem's own assumptions. "
        f"{CLIENTS} clients; payload, service time and value are one of {preset.states} equally likely joint states, "
        f"redrawn every slot; {slots:,} slots; bands and slopes are 95 % intervals over {preset.seeds} random systems. "
        "(a) Utility Σ x ν below that of the best stationary randomized policy (a linear program, whose prices also "
        f"serve as control variate), and (b) total backlog, both after the first {WARM_UP:.0%}. Two readings. In the "
        "proof's setting (blue) the optimizer, like the policies that the proof compares it with, may also choose "
        "clients without requests, x ν counts even then, and the best policy serves each client at least at its "
        "arrival rate. In eq. (voi_scheduler) as written only clients with pending requests are eligible (set R_t), "
        "and the best policy serves each client exactly at its arrival rate, the most that any stabilizing policy can "
        f"have. At load {BUSY:g} (share of capacity) queues are rarely empty and both readings agree. At {LIGHT:g} "
        "they do not: every value is positive, so the optimizer serves each request at once and never waits for a slot "
        "in which it is worth more, whatever V is. Lowering each client's values by their maximum makes it wait, and "
        "restores the bound: C_0 / V, where C_0 is half the expected Σ A² + x² with as many served as fit. (c) Backlog "
        f"left, divided by the slots so far, from empty queues; pending requests only, V = {LOAD_V:g}."
    )


PANELS = {
    "1/V gap, if queues stay busy": draw_gap,
    "at the price of backlog ∝ V": draw_backlog,
    "stable up to capacity": draw_growth,
}
