"""The panels of the compression figure: every prefix, payload against error, errors per frame, latency."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards.codec_frontier import PAPER_LATENCY_S, Frontier
from ovibjax.cards.compression_methods import FIXED, SPARSE_PREFIXES, prefixes_of
from ovibjax.cards.compression_results import Results
from ovibjax.cards.deployment_overhead import LINK_KB_PER_S, PAPER_LATENCY_MS
from ovibjax.features.images.codecs import CODECS
from ovibjax.features.images.codecs import NAMES as CODEC_NAMES
from ovibjax.link.latency import JETSON, compute_ms_at, kbytes_per_s, transmit_s
from ovibjax.link.payload import representation_bytes
from ovibjax.report import figures as fig
from ovibjax.report.panels import category_axis, headroom, sheet, star

NAMES = {
    "ovib": "O-VIB",
    "vib": "VIB",
    "fixed": "fixed-rate",
    "pca": "PCA",
    "pca_completed": "PCA, our decoder",
    "raw": "raw features",
}
COLOURS = {
    "ovib": fig.BLUE,
    "vib": fig.SKY,
    "fixed": fig.ORANGE,
    "pca": fig.RED,
    "pca_completed": fig.DARK_RED,
    "raw": fig.GREY,
}
CODEC_COLOURS = {"jpeg": fig.GREEN, "webp": fig.PURPLE, "h264": "#8C6D31", "h265": "#222222"}
CODEC_MARKERS = {"jpeg": "o", "webp": "v", "h264": "^", "h265": "P"}


def draw(path: Path, results: Results, frontier: Frontier | None) -> None:
    """Draw the four panels.

    Args:
        path: the PNG.
        results: outcomes of all methods.
        frontier: image codecs on the same data; None leaves the paper's latency alone.
    """
    with sheet(path, 2, 2, height_in=2.3) as (prefix, payload, frames, latency):
        _draw_prefixes(prefix, results)
        _draw_payloads(payload, results, frontier)
        _draw_frames(frames, results)
        _draw_latency(latency, results, frontier)


def _draw_prefixes(ax: Axes, results: Results) -> None:
    k = prefixes_of("ovib")
    curves = results.mean_m("ovib")
    fig.band(ax, k, curves, COLOURS["ovib"], "O-VIB, one model")
    sparse = np.array(SPARSE_PREFIXES)
    if "vib" in results.judged:
        fig.band(ax, sparse, results.mean_m("vib"), COLOURS["vib"], "VIB (no orthogonality)", style="--")
    fig.band(
        ax, sparse, results.mean_m("pca_completed"), COLOURS["pca_completed"], "PCA, our decoder trained on it", ":"
    )
    raw = float(results.mean_m("raw").mean())
    ax.axhline(raw, color=fig.GREY, lw=1, ls=":")
    label = f"raw features ({results.payload_bytes('raw', 0) / 1024:.0f} KB): {raw:.1f} m"
    ax.text(128, raw / 1.06, label, ha="right", va="top", color="#555555", fontsize=6.5)
    chosen = float(curves[:, results.chosen - 1].mean())
    star(ax, results.chosen, chosen)
    ax.annotate(
        f"selected k = {results.chosen}\n{chosen:.1f} m, {representation_bytes(results.chosen)} B",
        *((results.chosen, chosen), (min(results.chosen + 8, 88), chosen * 2.2)),
        arrowprops={"arrowstyle": "-", "lw": 0.6},
    )
    ax.set(xlabel="prefix length k (floats)", ylabel="mean error (m)", yscale="log", xlim=(0, 129))
    ax.set_ylim(bottom=min(ax.get_ylim()[0], 0.6 * raw))
    fig.plain_log_ticks(ax.yaxis)
    ax.legend(loc="upper right")
    fig.title(ax, "a", "every rate from one model")


def _draw_payloads(ax: Axes, results: Results, frontier: Frontier | None) -> None:
    def kib(method: str, ks: np.ndarray) -> np.ndarray:
        return np.array([results.payload_bytes(method, int(k)) for k in ks]) / 1024

    # Plain VIB is in the first panel, where it lies on O-VIB.
    looks = {"pca": ("-", "s"), "pca_completed": (":", ""), "ovib": ("-", "")}
    for method, (style, marker) in looks.items():
        if method not in results.judged:
            continue
        ks = prefixes_of(method)
        keep = ks >= 4
        x, curves = kib(method, ks[keep]), results.mean_m(method)[:, keep]
        fig.band(ax, x, curves, COLOURS[method], NAMES[method], style, marker)
    _draw_recoded(ax, kib("ovib", np.array(SPARSE_PREFIXES)), results)
    if results.fixed:
        _draw_bank(ax, kib("fixed", np.array(results.fixed)), results)
    raw_kib = results.payload_bytes("raw", 0) / 1024
    ax.plot(raw_kib, results.mean_m("raw").mean(), "X", ms=6, color=COLOURS["raw"], label="raw features")
    if frontier:
        _draw_codecs(ax, frontier)
    ax.set(xlabel="payload (KB)", ylabel="mean error (m)", xscale="log", yscale="log")
    headroom(ax, 12.0)
    fig.plain_log_ticks(ax.yaxis)
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper right", ncols=2, columnspacing=1.0, handlelength=1.4)
    fig.title(ax, "b", "payload and error")


def _draw_recoded(ax: Axes, sizes_kb: np.ndarray, results: Results) -> None:
    """Payload and error where the references pass through the same code as the query; means alone."""
    for method in results.recoded:
        ax.plot(sizes_kb, results.recoded_m(method).mean(axis=0), "--", lw=1, color=COLOURS[method], zorder=3)
    ax.plot([], [], "--", lw=1, color="black", label="references re-coded")


def _draw_bank(ax: Axes, sizes_kb: np.ndarray, results: Results) -> None:
    """Payload and error of the fixed-rate models."""
    errors_m = np.concatenate([results.mean_m(f"fixed_{k}") for k in results.fixed], axis=1)
    look: dict[str, Any] = {"color": COLOURS["fixed"], "label": "fixed-rate O-VIB", "capsize": 2, "lw": 1}
    ax.errorbar(sizes_kb, *fig.mean_and_half(errors_m), fmt="D", ms=4, **look)


def _draw_codecs(ax: Axes, frontier: Frontier) -> None:
    """Payload and error of every codec, with 95 % intervals."""
    for codec in frontier.codecs:
        sizes, errors = frontier.of(codec)
        mean, half = fig.mean_and_half(errors)
        ax.errorbar(
            sizes.mean(axis=0) / 1024,
            mean,
            np.stack([np.minimum(half, 0.7 * mean), half]),
            fmt=f"{CODEC_MARKERS[codec]}-",
            ms=3.5,
            lw=0.9,
            elinewidth=0.6,
            color=CODEC_COLOURS[codec],
            label=CODEC_NAMES[codec],
        )


def _draw_frames(ax: Axes, results: Results) -> None:
    groups: list[tuple[str, str, np.ndarray]] = []
    for label, method, k in (
        *((f"O-VIB k={k}", "ovib", k) for k in sorted({16, results.chosen}, reverse=True)),
        *((f"fixed-rate K={k}", f"fixed_{k}", k) for k in results.fixed),
        *(("VIB k=16", "vib", 16), ("PCA, our decoder k=16", "pca_completed", 16)),
        *(("PCA k=16", "pca", 16), ("PCA k=35", "pca", 35), ("raw", "raw", None)),
    ):
        if method not in results.judged:
            continue
        index = 0 if k is None else int(np.flatnonzero(prefixes_of(method) == k)[0])
        errors = np.concatenate([judged.test_error_m[index] for judged in results.judged[method]])
        groups.append((label, COLOURS["fixed" if method.startswith("fixed_") else method], errors))
    fig.error_boxes(ax, groups)
    ax.set(xlabel="error per test frame (m)")
    fig.title(ax, "c", "errors per frame")


class Latency(NamedTuple):
    """A row of the latency panel: label, milliseconds to encode and to transmit, the paper's total, where encoded."""

    label: str
    encode_ms: float
    transmit_ms: float
    paper_ms: float | None = None
    here: bool = False


def latencies(results: Results, frontier: Frontier | None) -> list[Latency]:
    """Latency of representations, and of image codecs.

    Args:
        results: outcomes of all methods.
        frontier: image codecs; None gives the paper's figures alone.

    Returns:
        One row per representation, then per codec at equal error: encoding on this machine, and transmission, which is
        infinite if that error is not reached on every seed.
    """
    rate_bps = kbytes_per_s(LINK_KB_PER_S)
    rows = []
    for label, k in (
        *((f"O-VIB k={k}", k) for k in sorted({16, 35, results.chosen})),
        *((f"fixed K={k}", k) for k in FIXED),
    ):
        sent_ms = 1e3 * float(transmit_s(representation_bytes(k), rate_bps))
        rows.append(Latency(label, float(compute_ms_at(JETSON, k)), sent_ms, PAPER_LATENCY_MS.get(k)))
    raw_ms = 1e3 * float(transmit_s(results.payload_bytes("raw", 0), rate_bps))
    rows.append(Latency("raw features", 0.0, raw_ms))
    for codec in frontier.codecs if frontier else CODECS:
        label, paper_ms = CODEC_NAMES[codec] + ("" if frontier else " (paper)"), 1e3 * PAPER_LATENCY_S[codec]
        whole_ms = float(frontier.latency_ms(codec, rate_bps).mean()) if frontier else np.inf
        encode_ms = float(frontier.equal_error_encode_ms(codec).mean()) if frontier and np.isfinite(whole_ms) else 0.0
        rows.append(Latency(label, encode_ms, whole_ms - encode_ms, paper_ms, here=True))
    return rows


def _draw_latency(ax: Axes, results: Results, frontier: Frontier | None) -> None:
    rows = latencies(results, frontier)
    y = np.arange(len(rows))
    encode = np.array([row.encode_ms for row in rows])
    sent = np.array([row.transmit_ms for row in rows])
    here = np.array([row.here for row in rows])
    for where, colour, label in ((~here, fig.ORANGE, "encode (Jetson)"), (here, fig.PURPLE, "encode (here)")):
        ax.barh(y[where], encode[where], color=colour, height=0.6, label=label)
    ax.barh(y, np.where(np.isfinite(sent), sent, 0), left=encode, color=fig.BLUE, height=0.6, label="transmit")
    marks = [(row.paper_ms, i) for i, row in enumerate(rows) if row.paper_ms is not None]
    ax.plot(*zip(*marks, strict=True), "|", ms=9, mew=1.6, color="black", label="paper")
    for i, total in enumerate(encode + sent):
        if np.isfinite(total):
            text = f"{total:.0f} ms" if total < 1000 else f"{total / 1000:.2f} s"
            paper_ms = rows[i].paper_ms or 0.0
            # Beside the bar, or beside the paper's tick where that is as near as the text would be.
            end = paper_ms if total < paper_ms < 5.5 * total else total
            # A paper's tick inside the bar's end would touch the text as well: a distance in points, not a factor.
            clear = max(end, paper_ms) if abs(np.log(max(paper_ms, 1e-3) / end)) < 0.15 else end
            ax.annotate(text, (clear, i), (5, 0), textcoords="offset points", va="center", fontsize=6.5)
        elif frontier:
            ax.text(1.2, i, "error not reached", va="center", fontsize=6.5)
    category_axis(ax, [row.label for row in rows])
    ax.set(xlabel=f"latency at {LINK_KB_PER_S} KB/s (ms)", xscale="log", xlim=(1, 4e4))
    ax.legend(loc="upper right")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))
    fig.title(ax, "d", "latency after feature extraction")
