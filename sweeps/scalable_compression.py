"""Fig. "Scalable O-VIB compression" and Table "Deployment overhead": one nested encoder against its rivals."""

import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.cards import codec_panel as codec_cards
from ovibjax.cards.codec_frontier import RIVAL_K, Frontier
from ovibjax.cards.compression_claims import LINK_KB_PER_S, PAPER_LATENCY_MS, judge_claims
from ovibjax.cards.compression_methods import FIXED, SPARSE_PREFIXES, TRAINED, Effort, Outcome, prefixes_of, run_method
from ovibjax.cards.compression_results import Results, collect, table_rows
from ovibjax.cards.deployment_overhead import measure_encoder, overhead_rows
from ovibjax.cards.job import CardInterrupted, Job
from ovibjax.encoder.data_split import member_data
from ovibjax.link.latency import (
    JETSON,
    LatencyProfile,
    compute_ms_at,
    kbytes_per_s,
    transmit_s,
)
from ovibjax.link.payload import representation_bytes
from ovibjax.report import figures as fig
from ovibjax.report.claims import write_claims
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import progress_bar
from ovibjax.runtime.threads import in_threads

TITLE = "Scalable O-VIB compression"
SEEDS = {"smoke": 2, "quick": 3, "full": 5}
EFFORTS = {
    "smoke": Effort(steps=60, fixed_steps=30, lr=3e-3),
    "quick": Effort(steps=2200, fixed_steps=800, lr=3e-3),
    "full": Effort(steps=8000, fixed_steps=4000, lr=2e-3),
}
NAMES = {"ovib": "O-VIB", "vib": "VIB", "fixed": "fixed-rate", "pca": "PCA", "raw": "raw features"}
COLOURS = {"ovib": fig.BLUE, "vib": fig.SKY, "fixed": fig.ORANGE, "pca": fig.RED, "raw": fig.GREY}


def run(job: Job) -> None:
    """Run the card: train, judge, write table, overhead, claims and figure."""
    started = time.perf_counter()
    effort = EFFORTS[job.preset]
    seeds = [job.seed + i for i in range(SEEDS[job.preset])]
    prepared = {seed: member_data(job.features, seed, job.rank) for seed in seeds}
    tasks = [(seed, method) for seed in seeds for method in TRAINED]
    finished: dict[int, dict[str, Outcome]] = {seed: {} for seed in seeds}

    def work(task: tuple[int, str]) -> tuple[int, str, Outcome]:
        seed, method = task
        return seed, method, run_method(method, seed, prepared[seed][0], effort)

    interrupted = False
    try:
        with progress_bar("training and judging", len(tasks)) as update:
            update(0)
            for done, (seed, method, outcome) in enumerate(in_threads(work, tasks), start=1):
                finished[seed][method] = outcome
                update(done)
    except KeyboardInterrupt:
        interrupted = True
    finished = {seed: outcomes for seed, outcomes in finished.items() if len(outcomes) == len(TRAINED)}
    if not finished:
        raise KeyboardInterrupt
    member, basis = prepared[next(iter(finished))]
    codecs, codec_note = None, " Image codecs are left out: the run was interrupted."
    if not interrupted:
        try:
            codecs, codec_note = codec_cards.code_and_judge(job, prepared, finished)
        except KeyboardInterrupt:
            interrupted = True
    results = collect(finished, raw_floats=int(np.prod(job.features.features.shape[1:])))
    host = measure_encoder(results, member)
    write_rows(job.out / "table.csv", table_rows(results))
    write_rows(
        job.out / "overhead.csv",
        overhead_rows(results, host, 4 * (basis.axes.size + basis.mean.size), LINK_KB_PER_S, PAPER_LATENCY_MS),
    )
    codec_claims = codec_cards.claims(codecs, LINK_KB_PER_S) if codecs else []
    (job.out / "codec.csv").unlink(missing_ok=True)  # of an earlier run on data with images
    if codecs:
        write_rows(job.out / "codec.csv", codecs.table_rows())
    write_claims(job.out / "claims.json", [*judge_claims(results, job.embedded), *codec_claims])
    draw(job.out / "figure.png", results, host, codecs)
    kept = float(np.mean([basis.energy_kept.mean() for _, basis in prepared.values()]))
    job.record(
        *(TITLE, caption(results, kept, member.train.x.shape[2]) + codec_note, finished, started),
        preset=job.preset + (" (interrupted)" if interrupted else ""),
        selected_k=results.chosen,
        view_coordinates=member.train.x.shape[2],
        energy_kept=round(kept, 4),
        steps=effort.steps,
        fixed_steps=effort.fixed_steps,
        final_losses={
            m: {k: float(v[-1]) for k, v in o.losses.items()} for m, o in next(iter(finished.values())).items()
        },
    )
    if interrupted:
        raise CardInterrupted(
            f"interrupted; {job.out} holds the figure of the finished seeds {' '.join(map(str, finished))}"
        )


def caption(results: Results, energy_kept: float, view_dim: int) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"(a) One trained model at every prefix k; selected on validation: k = {results.chosen}. (b) Serialized "
        "payload against error. (c) Errors per test frame of all seeds; box: quartiles, whiskers: 5th and 95th "
        "percentile, diamond: mean, red tick: 90th percentile. (d) Encoding after feature extraction (Jetson "
        f"Orin NX profile) plus transmission at {LINK_KB_PER_S} KB/s; image codecs: transmission alone, of the "
        f"bytes at which they reach O-VIB's error at k = {RIVAL_K}; black ticks: paper. Bands are 95 % intervals over "
        f"{len(results.outcomes)} seeds (split, initialisation, minibatches). The database holds uncompressed "
        f"reference descriptors (frozen localizer). {view_dim} principal coordinates per view keep "
        f"{100 * energy_kept:.0f} % of the feature variance."
    )


def draw(path: Path, results: Results, host: LatencyProfile, codecs: Frontier | None) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.3)
        _draw_prefixes(axes[0], results)
        _draw_frontier(axes[1], results, codecs)
        _draw_frames(axes[2], results)
        _draw_latency(axes[3], results, codecs)
        fig.save_figure(figure, path)


def _draw_prefixes(ax: Axes, results: Results) -> None:
    k = prefixes_of("ovib")
    curves = results.mean_m("ovib")
    fig.band(ax, k, curves, COLOURS["ovib"], "O-VIB, one model")
    sparse = np.array(SPARSE_PREFIXES)
    fig.band(ax, sparse, results.mean_m("vib"), COLOURS["vib"], "VIB (no orthogonality)", style="--")
    raw = float(results.mean_m("raw").mean())
    ax.axhline(raw, color=fig.GREY, lw=1, ls=":")
    label = f"raw features ({results.payload_bytes('raw', 0) / 1024:.0f} KB): {raw:.1f} m"
    ax.text(128, raw / 1.06, label, ha="right", va="top", color="#555555", fontsize=6.5)
    chosen = float(curves[:, results.chosen - 1].mean())
    ax.plot(results.chosen, chosen, "*", ms=10, color=fig.RED, zorder=5)
    ax.annotate(
        f"selected k = {results.chosen}\n{chosen:.1f} m, {representation_bytes(results.chosen)} B",
        *((results.chosen, chosen), (results.chosen + 8, chosen * 2.2)),
        arrowprops={"arrowstyle": "-", "lw": 0.6},
    )
    ax.set(xlabel="prefix length k (floats)", ylabel="mean error (m)", yscale="log", xlim=(0, 129))
    ax.set_ylim(bottom=min(ax.get_ylim()[0], 0.6 * raw))
    fig.plain_log_ticks(ax.yaxis)
    ax.legend(loc="upper right")
    fig.title(ax, "a", "every rate from one model")


def _draw_frontier(ax: Axes, results: Results, codecs: Frontier | None) -> None:
    def kib(method: str, ks: np.ndarray) -> np.ndarray:
        return np.array([results.payload_bytes(method, int(k)) for k in ks]) / 1024

    for method, marker in (("pca", "s"), ("vib", ""), ("ovib", "")):
        ks = prefixes_of(method)
        keep = ks >= 4
        x, curves = kib(method, ks[keep]), results.mean_m(method)[:, keep]
        fig.band(ax, x, curves, COLOURS[method], NAMES[method], "--" if method == "vib" else "-", marker)
    bank = np.concatenate([results.mean_m(f"fixed_{k}") for k in FIXED], axis=1)
    mean, half = fig.mean_and_half(bank)
    ax.errorbar(
        kib("fixed", np.array(FIXED)),
        mean,
        half,
        fmt="D",
        ms=4,
        color=COLOURS["fixed"],
        label="fixed-rate O-VIB",
        capsize=2,
        lw=1,
    )
    raw_kib = results.payload_bytes("raw", 0) / 1024
    ax.plot(raw_kib, results.mean_m("raw").mean(), "X", ms=6, color=COLOURS["raw"], label="raw features")
    if codecs:
        codec_cards.draw_frontier(ax, codecs)
    ax.set(xlabel="payload (KB)", ylabel="mean error (m)", xscale="log", yscale="log")
    fig.plain_log_ticks(ax.yaxis)
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper right", ncols=2, columnspacing=1.0, handlelength=1.4)
    fig.title(ax, "b", "payload and error")


def _draw_frames(ax: Axes, results: Results) -> None:
    groups: list[tuple[str, str, np.ndarray]] = []
    for label, method, k in (
        *((f"O-VIB k={k}", "ovib", k) for k in sorted({16, results.chosen}, reverse=True)),
        *((f"fixed-rate K={k}", f"fixed_{k}", k) for k in FIXED),
        *(("VIB k=16", "vib", 16), ("PCA k=16", "pca", 16), ("PCA k=35", "pca", 35), ("raw", "raw", None)),
    ):
        index = 0 if k is None else int(np.flatnonzero(prefixes_of(method) == k)[0])
        errors = np.concatenate([judged.test_error_m[index] for judged in results.judged[method]])
        groups.append((label, COLOURS[method.split("_")[0]], errors))
    fig.error_boxes(ax, groups)
    ax.set(xlabel="error per test frame (m)")
    fig.title(ax, "c", "errors per frame")


def _draw_latency(ax: Axes, results: Results, codecs: Frontier | None) -> None:
    rate = kbytes_per_s(LINK_KB_PER_S)
    rows: list[tuple[str, float, float, float | None]] = []  # label, encode ms, transmit ms, paper's ms
    for name, k in (
        *((f"O-VIB k={k}", k) for k in sorted({16, 35, results.chosen})),
        *((f"fixed K={k}", k) for k in FIXED),
    ):
        sent = 1e3 * float(transmit_s(representation_bytes(k), rate))
        rows.append((name, float(compute_ms_at(JETSON, k)), sent, PAPER_LATENCY_MS.get(k)))
    rows.append(("raw features", 0.0, 1e3 * float(transmit_s(results.payload_bytes("raw", 0), rate)), None))
    codec_rows = codec_cards.latency_rows(codecs, LINK_KB_PER_S)
    rows += [(name, 0.0, ms, paper_ms) for name, ms, paper_ms in codec_rows]
    y = np.arange(len(rows))
    encode = np.array([row[1] for row in rows])
    sent_ms = np.array([row[2] for row in rows])
    ax.barh(y, encode, color=fig.ORANGE, height=0.6, label="encode (Jetson)")
    ax.barh(y, np.where(np.isfinite(sent_ms), sent_ms, 0), left=encode, color=fig.BLUE, height=0.6, label="transmit")
    marks = [(row[3], i) for i, row in enumerate(rows) if row[3] is not None]
    ax.plot(*zip(*marks, strict=True), "|", ms=9, mew=1.6, color="black", label="paper")
    for i, total in enumerate(encode + sent_ms):
        if np.isfinite(total):
            text = f"{total:.0f} ms" if total < 1000 else f"{total / 1000:.2f} s"
            paper_ms = rows[i][3] or 0.0
            # Beside the bar, or beside the paper's tick where that is as near as the text would be.
            ax.text(1.08 * (paper_ms if total < paper_ms < 2 * total else total), i, text, va="center", fontsize=6.5)
        elif codecs:
            ax.text(9, i, "error not reached", va="center", fontsize=6.5)
    ax.set_yticks(y, [row[0] for row in rows])
    ax.set(xlabel=f"latency at {LINK_KB_PER_S} KB/s (ms)", xscale="log", xlim=(8, 2e4))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="upper right")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))
    fig.title(ax, "d", "latency after feature extraction")
