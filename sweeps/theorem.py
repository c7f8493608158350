"""The scheduler's theorem under its own assumptions (not in the paper): utility gap, backlog, capacity region."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import matplotlib as mpl
import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, Interval, above, below, interval, weakest, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.slotted_replay import Horizon, RunCases
from ovibjax.scheduling.stationary import capacity, draw_system, least_growth
from ovibjax.scheduling.theorem import Setting, empty_case, make_case, stack
from ovibjax.sweep.work import Along

TITLE = "Theorem of the slotted scheduler"
CLIENTS = 6
BUSY, LIGHT = 0.9, 0.5
LOADS = (0.6, 0.8, 0.9, 0.95, 1.05, 1.1, 1.2)
LOAD_V = 8.0
WARM_UP = 0.2
READ_AT = (0.01, 0.1, 1.0)
A_THEOREM = "a theorem"
# A gap may vanish to rounding.
_FLOOR = 1e-6
_MEANS = ("utility", "gap", "backlog")

PROOF_BUSY, PROOF_LIGHT = Setting("proof", BUSY), Setting("proof", LIGHT)
PENDING_BUSY, PENDING_LIGHT = Setting("pending", BUSY), Setting("pending", LIGHT)
SHIFTED_LIGHT = Setting("shifted", LIGHT)
SETTINGS = (PROOF_BUSY, PROOF_LIGHT, PENDING_BUSY, PENDING_LIGHT, SHIFTED_LIGHT)


@dataclass(frozen=True)
class Preset:
    """Size of the experiment.

    Attributes:
        seeds: random systems, each with its own arrivals.
        states: joint states of a system.
        vs: values of V.
        horizon: length of a run, in 100 blocks or a multiple.
    """

    seeds: int
    states: int
    vs: tuple[float, ...]
    horizon: Horizon


PRESETS = {
    "smoke": Preset(3, 32, (1.0, 8.0, 64.0), Horizon(100, 20)),
    "quick": Preset(5, 128, tuple(2.0**i for i in range(8)), Horizon(100, 500)),
    "full": Preset(10, 128, tuple(2.0**i for i in range(9)), Horizon(200, 1000)),
}


@dataclass(frozen=True)
class Found:
    """Results.

    Attributes:
        runs: means after the warm-up, `utility`, `gap` and `backlog`, and `best`, `gap_bound`, `backlog_bound`
            [setting, V, seed].
        growth: backlog over slots, `measured` [load, slots, seed], and the least of any policy, `least` [load, seed].
        resumed: members that an earlier, interrupted run had finished.
    """

    runs: xarray.Dataset
    growth: xarray.Dataset
    resumed: int

    def at(self, setting: Setting, metric: str) -> np.ndarray:
        """[seeds, V] a metric of one setting."""
        return self.runs[metric].sel(setting=setting.name).transpose("seed", "V").values

    def slope(self, setting: Setting, metric: str) -> Interval:
        """Exponent of V, fitted to the curve of each seed."""
        x = np.log(self.runs.V.values)
        return interval([np.polyfit(x, np.log(np.maximum(curve, _FLOOR)), 1)[0] for curve in self.at(setting, metric)])

    def used(self, setting: Setting, metric: str) -> list[Interval]:
        """A metric as a share of its bound, at each V."""
        return [interval(share) for share in (self.at(setting, metric) / self.at(setting, f"{metric}_bound")).T]


def run(job: Job) -> None:
    """Run the card: benchmarks by linear programming, one sweep, tables, claims and figure."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    seeds = [job.seed + i for i in range(preset.seeds)]
    found = measure(job, preset, seeds)
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "stability.csv", growth_rows(found))
    write_claims(job.out / "claims.json", judge_claims(found))
    draw(job.out / "figure.png", found)
    job.record(
        *(TITLE, caption(preset), seeds, started),
        slots=preset.horizon.blocks * preset.horizon.slots,
        members_of_an_earlier_run=found.resumed,
    )


def measure(job: Job, preset: Preset, seeds: Sequence[int]) -> Found:
    """Benchmarks of all systems, and one sweep over settings and V, and over loads at one V."""
    vs = np.array(preset.vs)
    systems = [draw_system(jax.random.fold_in(jax.random.key(seed), 1), preset.states, CLIENTS) for seed in seeds]
    edges = [capacity(system, np.ones(CLIENTS)) * np.ones(CLIENTS) for system in systems]
    made = [[make_case(*system, setting, vs) for setting in SETTINGS] for system in zip(systems, edges, strict=True)]
    cases = [
        stack([*(case for case, _ in row), *(empty_case(load * edge) for load in LOADS)])
        for row, edge in zip(made, edges, strict=True)
    ]
    points = [(setting.name, v) for setting in SETTINGS for v in preset.vs]
    points += [(f"load_{load:g}", LOAD_V) for load in LOADS]
    runs = _sweep(job, preset.horizon, points, seeds, list(zip(systems, cases, strict=True)))

    over_v = runs.isel(point=slice(len(SETTINGS) * len(vs)), slot=slice(int(WARM_UP * preset.horizon.blocks), None))
    shape = (len(SETTINGS), len(vs), len(seeds))
    means = {name: over_v[name].values.astype(np.float64).mean(-1).reshape(shape) for name in _MEANS}
    for name in ("best", "gap_bound", "backlog_bound"):
        values = np.array([[getattr(promise, name) for _, promise in row] for row in made])
        means[name] = values.transpose(1, 2, 0)
    dims = ("setting", "V", "seed")
    coords = {"setting": [setting.name for setting in SETTINGS], "V": vs, "seed": list(seeds)}
    by_v = xarray.Dataset({name: (dims, values) for name, values in means.items()}, coords)

    read = [round(share * preset.horizon.blocks) - 1 for share in READ_AT]
    left = runs.left.isel(point=slice(len(SETTINGS) * len(vs), None), slot=read).transpose("point", "slot", "seed")
    slots = left.slot.values
    least = [[least_growth(system, load * edge) for load in LOADS] for system, edge in zip(systems, edges, strict=True)]
    growth = xarray.Dataset(
        {
            "measured": (("load", "slots", "seed"), left.values.astype(np.float64) / slots[:, None]),
            "least": (("load", "seed"), np.array(least).T),
        },
        {"load": list(LOADS), "slots": slots, "seed": list(seeds)},
    )
    return Found(by_v, growth, int(runs.attrs["resumed"]))


def _sweep(
    job: Job, horizon: Horizon, points: list[tuple[str, float]], seeds: Sequence[int], data: list[Any]
) -> xarray.Dataset:
    """Block means [point, seed, slot]."""
    names, vs = zip(*points, strict=True)
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    dataset = job.sweep(
        "slotted scheduler",
        RunCases(horizon),
        {"case": [number[name] for name in names], "V": vs, "seed": seeds},
        Along("seed", data),
        zipped=[["case", "V"]],
        dims=dict.fromkeys((*_MEANS, "left"), ("slot",)),
        coords={"slot": horizon.slots * np.arange(1, horizon.blocks + 1)},
        units={"utility": "m", "gap": "m"},
        # All points of a seed side by side: they share its random numbers, and a lane is small.
        lanes=len(points),
    )
    return dataset.rename_dims({"case_V": "point"})


def table_rows(found: Found) -> list[dict[str, Any]]:
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


def growth_rows(found: Found) -> list[dict[str, Any]]:
    """Backlog over slots by load and length, with its interval, and the least of any policy."""
    rows: list[dict[str, Any]] = []
    for load in found.growth["load"].values:
        least = float(found.growth.least.sel(load=load).mean())
        for slots in found.growth.slots.values:
            span = interval(found.growth.measured.sel(load=load, slots=slots).values)
            row = {"load": float(load), "slots": int(slots), "backlog_per_slot": span.mean, "half_width": span.half}
            rows.append(row | {"least_of_any_policy": least})
    return rows


def judge_claims(found: Found) -> list[Claim]:
    """The theorem's statements, judged by what a bound implies: being below it, with the constants of the proof."""
    proof, pending = (PROOF_BUSY, PROOF_LIGHT), (PENDING_BUSY, PENDING_LIGHT)
    gap, backlog = "utility gap at most C_0 / V", "average backlog O(V)"
    return [
        _bound_claim(found, "gap", proof, f"In the proof's setting: {gap}", A_THEOREM),
        _bound_claim(found, "backlog", proof, f"In the proof's setting: {backlog}", A_THEOREM),
        _bound_claim(found, "gap", (PENDING_BUSY,), f"Serving pending requests only, busy: {gap}", A_THEOREM),
        _bound_claim(found, "gap", (PENDING_LIGHT,), f"Serving pending requests only, light load: {gap}", A_THEOREM),
        _bound_claim(found, "backlog", pending, f"Serving pending requests only: {backlog}", A_THEOREM),
        _bound_claim(found, "gap", (SHIFTED_LIGHT,), f"The same with ν less its maximum, light load: {gap}", "-"),
        _bound_claim(found, "backlog", (SHIFTED_LIGHT,), f"The same with ν less its maximum: {backlog}", "-"),
        *_growth_claims(found),
    ]


def _bound_claim(found: Found, metric: str, settings: Sequence[Setting], statement: str, paper: str) -> Claim:
    v = found.runs.V.values
    unit, digits = ("m per slot", 4) if metric == "gap" else ("requests", 1)
    texts = []
    for setting in settings:
        first, last = (interval(found.at(setting, metric)[:, i]) for i in (0, -1))
        share = max(share.mean for share in found.used(setting, metric))
        texts.append(
            f"load {setting.load:g}: {first.text(digits=digits)} at V = {v[0]:g}, {last.text(unit, digits)} at "
            f"V = {v[-1]:g}"
            + (f", of at best {interval(found.at(setting, 'best')[:, 0]).text('m')}" if metric == "gap" else "")
            + f"; slope {found.slope(setting, metric).text()}; up to {share:.2f} times the bound"
        )
    verdict = weakest(below(share, 1.0) for setting in settings for share in found.used(setting, metric))
    rule = f"interval of {metric} / bound at most 1 at every V; O() is an upper bound and implies no slope"
    return Claim(statement, paper, "; ".join(texts), verdict, rule)


def _growth_claims(found: Found) -> list[Claim]:
    """Mean-rate stability of eq. voi_scheduler inside the capacity region, and growth outside."""
    before, after = found.growth.slots.values[-2:]
    text, shares, falls = {}, {}, {}
    for load in LOADS:
        part = found.growth.sel(load=load)
        early, late = (part.measured.sel(slots=slots).values for slots in (before, after))
        text[load] = f"{interval(late).text(digits=4)} at load {load:g}"
        if load < 1:
            falls[load] = interval(late / np.maximum(early, 1 / before))
        else:
            shares[load] = interval(late / part.least.values)
    return [
        Claim(
            "Queues mean-rate stable inside the capacity region",
            A_THEOREM,
            f"Q(T) / T at T = {after}: {', '.join(text[load] for load in falls)} requests per slot; at most "
            f"{max(fall.mean for fall in falls.values()):.2f} of that at T = {before}",
            weakest(below(fall, 0.5) for fall in falls.values()),
            "ten times the slots at least halve Q(T) / T at every load below 1 (stable: a tenth; growing: no change)",
        ),
        Claim(
            "Outside it the backlog grows in proportion to time, as it must under any policy",
            "-",
            f"Q(T) / T at T = {after}: {', '.join(text[load] for load in shares)} requests per slot; at most "
            f"{max(share.mean for share in shares.values()):.2f} times the least possible",
            weakest(above(share, 0.9) for share in shares.values()),
            "at least 0.9 of the least growth of any policy (a linear program) at every load above 1",
        ),
    ]


def caption(preset: Preset) -> str:
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


def draw(path: Path, found: Found) -> None:
    """The three panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(3, height_in=2.6)
        for ax, metric, label, place, side in (
            (axes[0], "gap", "utility below the best (m per slot)", (0.05, 0.2), "left"),
            (axes[1], "backlog", "average backlog (requests)", (0.99, 0.45), "right"),
        ):
            _draw_over_v(ax, found, metric)
            slope = f"slope {found.slope(PROOF_BUSY, metric).text()}".replace("-", "−")
            ax.text(*place, slope, transform=ax.transAxes, ha=side, color=fig.BLUE, fontsize=6.5)
            ax.set_ylabel(label)
        light = (0.97, 0.87)
        axes[0].text(*light, "no V helps", transform=axes[0].transAxes, ha="right", color=fig.RED, fontsize=6.5)
        fig.title(axes[0], "a", "1/V gap, if queues stay busy")
        fig.title(axes[1], "b", "at the price of backlog ∝ V")
        _draw_growth(axes[2], found)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=3)
        fig.save_figure(figure, path)


_LOOKS = (
    (PROOF_BUSY, fig.BLUE, "-", "o", "proof's setting, load 0.9"),
    (PENDING_BUSY, fig.SKY, "--", "s", "pending requests only, load 0.9"),
    (PENDING_LIGHT, fig.RED, "-", "^", "pending requests only, load 0.5"),
    (SHIFTED_LIGHT, fig.GREEN, "-.", "v", "the same, with ν less its maximum"),
)


def _draw_over_v(ax: Axes, found: Found, metric: str) -> None:
    v = found.runs.V.values
    for setting, colour, style, marker, label in _LOOKS:
        fig.band(ax, v, found.at(setting, metric), colour, label, style, marker)
    bound = found.at(PROOF_BUSY, f"{metric}_bound").mean(axis=0)
    ax.plot(v, bound, "--", color="black", lw=1, label="the proof's bound, load 0.9")
    ax.set(xscale="log", yscale="log", xlabel="V")
    for axis in (ax.xaxis, ax.yaxis):
        fig.plain_log_ticks(axis, subs=(1.0,))


def _draw_growth(ax: Axes, found: Found) -> None:
    load = found.growth["load"].values
    for slots, colour, marker in zip(found.growth.slots.values, (fig.GREY, fig.ORANGE, fig.PURPLE), "os^", strict=True):
        curves = found.growth.measured.sel(slots=slots).transpose("seed", "load").values
        fig.band(ax, load, curves, colour, f"{slots:,} slots", "-", marker)
    least = found.growth.least.mean("seed").values
    bend = int((load < 1).sum())
    ax.plot(np.insert(load, bend, 1.0), np.insert(least, bend, 0.0), "--", color="black", lw=1, label="least possible")
    ax.axvline(1.0, color=fig.GREY, lw=0.8)
    ax.set(xlabel="load (share of capacity)", ylabel="backlog / slots (requests)")
    ax.legend(loc="upper left")
    fig.title(ax, "c", "stable up to capacity")
