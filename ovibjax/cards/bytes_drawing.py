"""The panels of real bytes: error by size of code and packet, bits of coordinates, the rate term, gains over PCA."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.bytes_choice import CODE, COMPACT, NAMES, PACKET, chosen, one_price
from ovibjax.cards.bytes_claims import BUDGETS, gains_m, surrogate
from ovibjax.cards.bytes_study import BytesRuns
from ovibjax.cards.codec_frontier import Frontier
from ovibjax.features.images.codecs import STILLS
from ovibjax.report import figures as fig
from ovibjax.report.claims import interval
from ovibjax.report.panels import columns, headroom

COLOURS = {
    "bits": fig.GREEN,
    "ovib": fig.BLUE,
    "floats": fig.SKY,
    "int8": fig.PURPLE,
    "ard": "black",
    "pca": fig.RED,
    "pca_completed": fig.DARK_RED,
    "pq": fig.ORANGE,
}

_LONGER = (48, 64, 96, 140, 200, 256, 400, 512)
_MARKERS = {"jpeg": "s", "webp": "D"}


class Everything(NamedTuple):
    """What the figure shows.

    Attributes:
        runs: the study of real bytes.
        codecs: image codecs on the embedded town; None for other data.
        system: the whole system by code, likewise.
    """

    runs: BytesRuns
    codecs: Frontier | None
    system: xarray.Dataset | None


def draw_code_bytes(ax: Axes, found: Everything) -> None:
    """Error within a budget of code bytes, by method."""
    for method, label in NAMES.items():
        _within(ax, found.runs, method, label, CODE, (*BUDGETS, *_LONGER))
    _metres(ax)
    ax.set_xlabel("code at most (bytes)")
    ax.legend(loc="upper right")


def draw_packets(ax: Axes, found: Everything) -> None:
    """Error within a budget of whole packets, and image codecs."""
    budgets = tuple(budget + 13 for budget in (*BUDGETS, *_LONGER))
    _within(ax, found.runs, "floats", "float32, paper's header", PACKET, budgets)
    _within(ax, found.runs, "bits", "for bits, paper's header", PACKET, budgets, line=":")
    for method in ("bits", "ovib", "int8", "pca_completed", "pq"):
        label = "for bits, compact header" if method == "bits" else ""
        _within(ax, found.runs, method, label, COMPACT, budgets)
    if found.codecs is not None:
        for codec in found.codecs.codecs:
            sizes, errors_m = found.codecs.of(codec)
            spans = [interval(at) for at in errors_m.T]
            means, caps = [span.mean for span in spans], [min(span.cap, 0.9 * span.mean) for span in spans]
            style: dict[str, Any] = {"ms": 3.5, "lw": 0.8, "elinewidth": 0.7, "color": fig.GREY, "mfc": "white"}
            ax.errorbar(sizes.mean(axis=0), means, caps, marker=_MARKERS[codec], label=STILLS[codec], **style)
    _metres(ax)
    fig.plain_log_ticks(ax.xaxis, subs=(1.0, 3.0))
    ax.set_xlabel("whole packet at most, five views (bytes)")
    ax.legend(loc="upper right")


def _within(
    ax: Axes, runs: BytesRuns, method: str, label: str, size: str, budgets: tuple[int, ...], line: str = "-"
) -> None:
    """A method's curve over budgets, where it has something to send."""
    kept = [(budget, chosen(runs.rows, method, budget, size=size)) for budget in budgets]
    at = [(budget, best.error_m) for budget, best in kept if best is not None]
    if at:
        x = np.array([budget for budget, _ in at])
        fig.band(ax, x, np.stack([error for _, error in at], axis=1), COLOURS[method], label, line)


def draw_coordinates(ax: Axes, found: Everything) -> None:
    """Bits of each coordinate."""
    lines = {"ovib": "-", "bits": "--"}
    of_each = found.runs.per_coordinate
    shown = [(*named, of_each[named]) for method in lines for named in sorted(of_each) if named[0] == method]
    colours = itertools.cycle((fig.BLUE, fig.ORANGE, fig.GREEN, fig.PURPLE, fig.SKY))
    for (method, setting, bits), colour in zip(shown, colours, strict=False):
        name = f"{'β' if method == 'ovib' else 'λ'} = {setting:g}"
        ax.plot(np.arange(1, len(bits) + 1), bits, lines[method], lw=1, color=colour, label=name)
    ax.set_xlabel("coordinate")
    ax.set_ylabel("bits")
    ax.legend(ncols=2)


def draw_surrogate(ax: Axes, found: Everything) -> None:
    """What training counts as rate, beside what coding takes."""
    both = [(f"{sign} = {setting:g}", *pair) for method, sign in (("ovib", "β"), ("bits", "λ"))
            for setting, pair in surrogate(found.runs, method).items()]  # fmt: skip
    counted = [interval(rate) for _, rate, _ in both]
    coded = [interval(np.full(1, bits)) for _, _, bits in both]
    series = [("as training counts it", fig.ORANGE, counted), ("coded", fig.BLUE, coded)]
    places = columns(ax, [name.replace(" = ", "\n") for name, _, _ in both], series)
    for x, value in zip(places.ravel(), (*counted, *coded), strict=True):
        ax.annotate(f"{value.mean:.0f}", (x, value.mean + value.cap), (0, 1), textcoords="offset points", ha="center",
                    fontsize=5.5)  # fmt: skip
    ax.set_ylabel("all coordinates (bits)")
    headroom(ax, 1.25)
    ax.legend(loc="upper right")


def draw_gains(ax: Axes, found: Everything) -> None:
    """PCA's error minus that of training for bits, paired."""
    for price, colour, label in (
        (None, fig.GREEN, "a price per budget"),
        (one_price(found.runs.rows, BUDGETS), fig.BLUE, "one price"),
    ):
        gains = gains_m(found.runs, "best_pca", BUDGETS, price)
        if gains:
            curves = np.stack([gain for gain, _ in gains.values()], axis=1)
            fig.band(ax, np.array(list(gains)), curves, colour, label)
    ax.axhline(0.0, color=fig.GREY, lw=0.8)
    ax.set_yscale("symlog", linthresh=1.0)
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("code at most (bytes)")
    ax.set_ylabel("PCA's error minus ours (m)")
    ax.legend()


def _metres(ax: Axes) -> None:
    ax.set(xscale="log", yscale="log")
    fig.plain_log_ticks(ax.xaxis)
    fig.plain_log_ticks(ax.yaxis)
    ax.set_ylabel("mean error (m)")
