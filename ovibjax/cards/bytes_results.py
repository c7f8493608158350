"""What bytes buy: claims and panels of the study of real bytes."""

import itertools
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.bytes_choice import Chosen, best_within, one_price
from ovibjax.cards.bytes_study import KS, BytesRuns, Row
from ovibjax.encoder.loss import BETA
from ovibjax.report import figures as fig
from ovibjax.report.claims import Claim, interval

BUDGETS = (4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40)
"""Bytes of code at which methods are compared."""

GOALS_M = {5: 8.0, 8: 5.0, 16: 3.5, 32: 2.8}
"""What training for bits was expected to reach, by bytes of code."""

NAMES = {
    "bits": "trained for bits",
    "ovib": "O-VIB, entropy-coded",
    "floats": "O-VIB, float32",
    "int8": "O-VIB, int8",
    "pca": "PCA, entropy-coded",
    "pca_completed": "PCA, our decoder",
    "pq": "product quantisation",
}
COLOURS = dict(zip(NAMES, (fig.GREEN, fig.BLUE, fig.SKY, fig.PURPLE, fig.RED, fig.DARK_RED, fig.ORANGE), strict=True))


def chosen(found: BytesRuns, method: str, budget: float, price: float | None = None) -> Chosen | None:
    """What a method of `NAMES` sends within a budget; `bits` at one price, or at the best for the budget."""

    def allowed(row: Row) -> bool:
        if method in ("floats", "int8"):
            return row["method"] == "ovib" and row["code"] == {"floats": "float32", "int8": "int8"}[method]
        of_paper = row["method"] != "ovib" or row["setting"] == BETA
        return row["method"] == method and of_paper and (price is None or row["setting"] == price)

    return best_within(found.rows, budget, allowed)


def bytes_claims(found: BytesRuns, coding_us: dict[str, float], embedded: bool) -> list[Claim]:
    """Claims on real bytes, all of them ours.

    Args:
        found: what was found.
        coding_us: time to code and decode one code of 35 coordinates, and of all, in microseconds.
        embedded: whether the data are the embedded town, for which the goals in metres are stated.

    Returns:
        The claims, judged.
    """
    price = one_price(found.rows, BUDGETS)
    claims = [
        *([_goal(found, budget, goal_m) for budget, goal_m in GOALS_M.items()] if embedded else []),
        _against_pca(found, None, "the best price of a bit for each budget"),
        _against_pca(found, price, f"one price for all, {price:g}"),
        _codes_alike(found),
        Claim.true(
            "Streams are as short as their tables allow: none more than 2 bytes above 1.02 times its ideal length",
            "-",
            f"at most {found.excess_bytes:.2f} bytes above it",
            found.excess_bytes <= 2,
            "every stream of every method, prefix and test frame",
        ),
        Claim.true(
            "Coding and decoding a code takes less than 0.2 ms",
            "-",
            ", ".join(f"{name}: {time_us:.0f} us" for name, time_us in coding_us.items()),
            max(coding_us.values()) < 200,
            "processor time of one core here, median over test frames",
        ),
        *_surrogate(found),
    ]
    return [claim.as_own() for claim in claims]


def _goal(found: BytesRuns, budget: int, goal_m: float) -> Claim:
    best = chosen(found, "bits", budget)
    error_m = np.array([]) if best is None else best.error_m
    return Claim.at_most(
        f"Trained for bits, {budget} bytes of code localize to {goal_m:g} m",
        "-",
        f"{interval(error_m).text('m')} ({best.name if best else 'nothing is so small'})",
        goal_m,
        error_m,
        rule=f"interval at most {goal_m:g} m; coding chosen on validation",
    )


def _against_pca(found: BytesRuns, price: float | None, words: str) -> Claim:
    gains = {}
    for budget in BUDGETS:
        ours, theirs = chosen(found, "bits", budget, price), chosen(found, "pca", budget)
        if ours is not None and theirs is not None:
            gains[budget] = theirs.error_m - ours.error_m
    text = "; ".join(f"{budget} bytes: {interval(gain).text('m')}" for budget, gain in gains.items())
    return Claim.at_least(
        f"Trained for bits, a code is at least as good as PCA's best of equal bytes, 4 to 40 bytes, with {words}",
        "-",
        f"PCA's error minus ours at {text}",
        0.0,
        *gains.values(),
        rule="paired interval not below zero at any budget; both codings chosen on validation",
    )


def _codes_alike(found: BytesRuns) -> Claim:
    step = min(row["step"] for row in found.rows if row["code"] == "entropy" and row["method"] == "ovib")
    differences, words = [], []
    for k in (16, 35, 128):
        errors_m = {code: _at(found, code, k, step) for code in ("float32", "int8", "entropy")}
        for code in ("int8", "entropy"):
            differences.append(errors_m[code] - errors_m["float32"])
            words.append(f"{code} at k = {k}: {interval(differences[-1]).text('m')}")
    return Claim.at_most(
        "Rounding costs nothing: float32, int8 and entropy-coded prefixes are within 0.3 m",
        "-",
        "error minus that of float32, " + "; ".join(words),
        0.3,
        *differences,
        *(-difference for difference in differences),
        rule="paired interval of every difference within 0.3 m",
    )


def _at(found: BytesRuns, code: str, k: int, step: float) -> np.ndarray:
    rows = [row for row in found.rows if row["method"] == "ovib" and row["setting"] == BETA and row["k"] == k]
    rows = [row for row in rows if row["code"] == code and (code != "entropy" or row["step"] == step)]
    return np.array([row["mean_m"] for row in sorted(rows, key=lambda row: row["seed"])])


def _surrogate(found: BytesRuns) -> list[Claim]:
    """The paper's rate term beside the bits that codes take."""
    nats = {beta: rate for (name, beta), rate in found.rate.items() if name == "ovib"}
    bits = {beta: float(found.per_coordinate["ovib", beta].sum()) for beta in nats}
    text = "; ".join(
        f"β = {beta:g}: {interval(rate).mean:.0f} nats = {interval(rate).mean / np.log(2):.0f} bits, "
        f"coded {bits[beta]:.0f} bits"
        for beta, rate in nats.items()
    )
    return [
        Claim.reported(
            "What the rate term stands for: its value in training beside the bits of all coordinates, entropy-coded",
            "-",
            text,
            "mean over seeds; coded with the finest step",
        )
    ]


def draw_code_bytes(ax: Axes, found: BytesRuns) -> None:
    """Error within a budget of code bytes, by method."""
    for method, label in NAMES.items():
        budgets, curves = [], []
        for budget in (*BUDGETS, 64, 96, 140, 256, 512):
            best = chosen(found, method, budget)
            if best is not None:
                budgets.append(budget)
                curves.append(best.error_m)
        if budgets:
            fig.band(ax, np.array(budgets), np.stack(curves, axis=1), COLOURS[method], label)
    _metres(ax)
    ax.set_xscale("log")
    fig.plain_log_ticks(ax.xaxis)
    ax.set_xlabel("code at most (bytes)")
    ax.legend(loc="upper right")


def draw_packets(ax: Axes, found: BytesRuns) -> None:
    """Error against whole packets: the paper's, version 2, and with a compact header."""
    shown: list[tuple[str, dict[str, Any], str]] = [
        ("floats", {"method": "ovib", "code": "float32", "setting": BETA}, "packet_bytes"),
        ("ovib", {"method": "bits", "setting": one_price(found.rows, BUDGETS)}, "packet_bytes"),
        ("bits", {"method": "bits", "setting": one_price(found.rows, BUDGETS)}, "compact_bytes"),
    ]
    labels = ("float32, paper's header", "for bits, paper's header", "for bits, compact header")
    for (name, only, size), label in zip(shown, labels, strict=True):
        rows = [row for row in found.rows if all(row[key] == value for key, value in only.items())]
        x = [np.mean([row[size] for row in rows if row["k"] == k]) for k in KS]
        y = [np.mean([row["mean_m"] for row in rows if row["k"] == k]) for k in KS]
        ax.plot(x, y, "o-", ms=3, color=COLOURS[name], label=label)
    _metres(ax)
    ax.set_xscale("log")
    fig.plain_log_ticks(ax.xaxis)
    ax.set_xlabel("whole packet, five views (bytes)")
    ax.legend(loc="upper right")


def draw_coordinates(ax: Axes, found: BytesRuns) -> None:
    """Bits of each coordinate."""
    lines = {"ovib": "-", "bits": "--"}
    shown = [(*named, bits) for named, bits in found.per_coordinate.items() if named[0] in lines]
    colours = itertools.cycle((fig.BLUE, fig.ORANGE, fig.GREEN, fig.PURPLE, fig.SKY))
    for (method, setting, bits), colour in zip(shown, colours, strict=False):
        name = f"{'β' if method == 'ovib' else 'λ'} = {setting:g}"
        ax.plot(np.arange(1, len(bits) + 1), bits, lines[method], lw=1, color=colour, label=name)
    ax.set_xlabel("coordinate")
    ax.set_ylabel("bits")
    ax.legend(ncols=2)


def draw_gains(ax: Axes, found: BytesRuns) -> None:
    """PCA's error minus that of training for bits, paired."""
    for price, colour, label in (
        (None, fig.GREEN, "a price per budget"),
        (one_price(found.rows, BUDGETS), fig.BLUE, "one price"),
    ):
        pairs = [(chosen(found, "bits", b, price), chosen(found, "pca", b)) for b in BUDGETS]
        kept = [(b, q.error_m - p.error_m) for b, (p, q) in zip(BUDGETS, pairs, strict=True) if p and q]
        if kept:
            fig.band(ax, np.array([b for b, _ in kept]), np.stack([gain for _, gain in kept], axis=1), colour, label)
    ax.axhline(0.0, color=fig.GREY, lw=0.8)
    ax.set_yscale("symlog", linthresh=1.0)
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("code at most (bytes)")
    ax.set_ylabel("PCA's error minus ours (m)")
    ax.legend()


def _metres(ax: Axes) -> None:
    ax.set_yscale("log")
    fig.plain_log_ticks(ax.yaxis)
    ax.set_ylabel("mean error (m)")
