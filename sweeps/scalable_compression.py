"""Fig. "Scalable O-VIB compression" and Table "Deployment overhead": one nested encoder against its rivals."""

import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ovibjax.edge.compare import Results, collect, table_rows
from ovibjax.edge.methods import FIXED, SPARSE_PREFIXES, TRAINED, Effort, Outcome, prefixes_of, run_method
from ovibjax.edge.overhead import measure_encoder, overhead_rows
from ovibjax.encoder.prepare import prepare
from ovibjax.link.latency import (
    JETSON,
    LatencyProfile,
    compute_ms_at,
    kbytes_per_s,
    semantic_latency_ms,
    transmit_s,
)
from ovibjax.link.payload import representation_bytes
from ovibjax.progress import progress_bar
from ovibjax.report import figures as fig
from ovibjax.report.claims import HELD, NOT_HELD, REPORTED, Claim, above, below, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.reproduce import Interrupted, Job
from ovibjax.threads import in_threads

TITLE = "Scalable O-VIB compression"
LINK_KB_PER_S = 8
SEEDS = {"smoke": 2, "quick": 3, "full": 5}
EFFORTS = {
    "smoke": Effort(steps=60, fixed_steps=30, lr=3e-3),
    "quick": Effort(steps=2200, fixed_steps=800, lr=3e-3),
    "full": Effort(steps=8000, fixed_steps=4000, lr=2e-3),
}
PAPER_LATENCY_MS = {16: 42.0, 35: 52.0, 32: 50.4, 128: 100.6}
PAPER_CODECS_S = {"WebP": 2.92, "H.265": 3.61, "JPEG": 4.58, "H.264": 5.04}
NAMES = {"ovib": "O-VIB", "vib": "VIB", "fixed": "fixed-rate", "pca": "PCA", "raw": "raw features"}
COLOURS = {"ovib": fig.BLUE, "vib": fig.SKY, "fixed": fig.ORANGE, "pca": fig.RED, "raw": fig.GREY}


def run(job: Job) -> None:
    """Run the card: train, judge, write table, overhead, claims and figure."""
    started = time.perf_counter()
    effort = EFFORTS[job.preset]
    seeds = [job.seed + i for i in range(SEEDS[job.preset])]
    prepared = {seed: prepare(job.features, seed, job.rank) for seed in seeds}
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
    results = collect(finished, raw_floats=int(np.prod(job.features.features.shape[1:])))
    host = measure_encoder(results, member)
    write_rows(job.out / "table.csv", table_rows(results))
    write_rows(
        job.out / "overhead.csv",
        overhead_rows(results, host, 4 * (basis.axes.size + basis.mean.size), LINK_KB_PER_S, PAPER_LATENCY_MS),
    )
    write_claims(job.out / "claims.json", judge_claims(results, job))
    draw(job.out / "figure.png", results, host)
    kept = float(np.mean([basis.energy_kept.mean() for _, basis in prepared.values()]))
    job.record(
        *(TITLE, caption(results, kept, member.train.x.shape[2]), finished, started),
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
        raise Interrupted(
            f"interrupted; {job.out} holds the figure of the finished seeds {' '.join(map(str, finished))}"
        )


def judge_claims(results: Results, job: Job) -> list[Claim]:
    """The paper's claims and the project's own expectations of the embedded town, by stated rules."""
    at = {k: interval(results.at("ovib", k)) for k in (16, 35, 128)}
    pca16 = results.at("pca", 16)
    ratio = interval(results.at("ovib", 16) / pca16)
    curve = results.mean_m("ovib")[:, 23:]
    spread = interval(100 * (curve.max(axis=1) / curve.min(axis=1) - 1))
    shorter = interval(results.at("ovib", 16) / results.at("ovib", 128))
    ours_16 = f"{at[16].text()} m against {interval(pca16).text('m')}, ratio {ratio.text()}"
    claims = [
        Claim(
            "A 16-float prefix localizes about as well as all 128: error at k = 16 at most 1.15 of that at k = 128",
            "9.31 / 10.11 m = 0.92",
            f"{at[16].text()} / {at[128].text('m')}, ratio {shorter.text()}",
            below(shorter, 1.15),
            "interval of the paired ratio at most 1.15",
        ),
        Claim(
            "O-VIB at k = 16 has at most half of PCA's error at k = 16",
            "-",
            ours_16,
            below(ratio, 0.5),
            "interval of the paired ratio at most 0.5",
        ),
    ]
    best_pca = min(SPARSE_PREFIXES, key=lambda k: results.at("pca", k).mean())
    crossing = [k for k in SPARSE_PREFIXES if results.at("pca", k).mean() < results.at("ovib", k).mean()]
    ahead = max((k for k in SPARSE_PREFIXES if k not in crossing), default=0)
    claims.append(
        Claim(
            "At every payload O-VIB is at least as accurate as PCA",
            "-",
            f"O-VIB is ahead up to k = {ahead}; PCA reaches "
            f"{interval(results.at('pca', best_pca)).text('m')} at k = {best_pca}",
            NOT_HELD if crossing else HELD,
            "no prefix at which PCA's mean error is lower",
        )
    )
    recoded = [interval(results.at(m, 16, recoded=True)) for m in ("ovib", "pca")]
    claims.append(
        Claim(
            "What a re-coded database changes: references passed through the same code and prefix as the query, k = 16",
            "-",
            f"O-VIB {recoded[0].text('m')}, PCA {recoded[1].text('m')}",
            REPORTED,
            "not part of the frozen-localizer protocol",
        )
    )
    difference = interval(results.at("vib", 35) - results.at("ovib", 35))
    claims.append(
        Claim(
            "Orthogonality helps: O-VIB below plain VIB at k = 35 (paired over seeds)",
            "9.30 - 8.75 = 0.55 m",
            f"VIB minus O-VIB {difference.text('m')}",
            HELD if difference.low > 0 else NOT_HELD,
            "the whole interval of the paired difference above zero",
        )
    )
    for k in FIXED:
        gap = interval(results.at("ovib", k) - results.at(f"fixed_{k}", k))
        claims.append(
            Claim(
                f"One scalable model replaces the fixed-rate model of K = {k}: at most 1 m worse at the same payload",
                "-",
                f"O-VIB minus fixed-rate {gap.text('m')}",
                below(gap, 1.0),
                "interval of the paired difference at most 1 m",
            )
        )
    span = [float(semantic_latency_ms(JETSON, k, kbytes_per_s(LINK_KB_PER_S))) for k in PAPER_LATENCY_MS]
    paper = list(PAPER_LATENCY_MS.values())
    claims.append(
        Claim(
            "Latency at 8 KB/s under the Jetson profile (k = 16, 35, 32, 128); the profile is read off its table, "
            "so this checks the payload and link arithmetic and measures nothing",
            " / ".join(map(str, paper)) + " ms",
            " / ".join(f"{ms:.1f}" for ms in span) + " ms",
            HELD if max(abs(a - b) for a, b in zip(span, paper, strict=True)) <= 0.1 else NOT_HELD,
            "each within 0.1 ms",
        )
    )
    if not job.embedded:
        return claims
    front_m, sides_m = (interval(results.raw_mode_m[mode]) for mode in ("F", "FS"))
    front = interval(results.raw_mode_m["F"] / results.raw_mode_m["FS"])
    expected = "expectation of the embedded town"
    return [
        *claims,
        Claim("Error at k = 16 at most 6 m", "9.31 m", at[16].text("m"), below(at[16], 6.0), expected),
        Claim("Error at k = 35 at most 6 m", "9.18 m", at[35].text("m"), below(at[35], 6.0), expected),
        Claim(
            "The error curve is flat within 15 % from k = 24 to 128",
            "9.18 to 10.11 m",
            f"{curve.mean(axis=0).min():.2f} to {curve.mean(axis=0).max():.2f} m, per seed {spread.text('%', 1)}",
            below(spread, 15.0),
            "interval over seeds of the largest over the smallest mean error",
        ),
        Claim(
            "Validation selects a prefix between 12 and 48",
            "k = 35",
            f"k = {results.chosen}",
            HELD if 12 <= results.chosen <= 48 else NOT_HELD,
            "shortest prefix within one standard error of the best, all seeds together",
        ),
        Claim(
            "Front-only has at least 3 times the error of front-plus-sides on raw features",
            "-",
            f"{front_m.text()} m / {sides_m.text()} m, ratio {front.text()}",
            above(front, 3.0),
            "interval of the paired ratio at least 3",
        ),
    ]


def caption(results: Results, energy_kept: float, view_dim: int) -> str:
    """What the reader of the figure needs to know."""
    return (
        f"(a) One trained model at every prefix k; selected on validation: k = {results.chosen}. (b) Serialized "
        "payload against error. (c) Errors per test frame of all seeds; box: quartiles, whiskers: 5th and 95th "
        "percentile, diamond: mean, red tick: 90th percentile. (d) Encoding after feature extraction (Jetson "
        f"Orin NX profile) plus transmission at {LINK_KB_PER_S} KB/s. Bands are 95 % intervals over "
        f"{len(results.outcomes)} seeds (split, initialisation, minibatches). The database holds uncompressed "
        f"reference descriptors (frozen localizer). {view_dim} principal coordinates per view keep "
        f"{100 * energy_kept:.0f} % of the feature variance."
    )


def draw(path: Path, results: Results, host: LatencyProfile) -> None:
    """The four panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(2, 2, height_in=2.3)
        _draw_prefixes(axes[0], results)
        _draw_frontier(axes[1], results)
        _draw_frames(axes[2], results)
        _draw_latency(axes[3], results, host)
        fig.save_figure(figure, path)


def _draw_prefixes(ax: Axes, results: Results) -> None:
    k = prefixes_of("ovib")
    curves = results.mean_m("ovib")
    fig.band(ax, k, curves, COLOURS["ovib"], "O-VIB, one model")
    sparse = np.array(SPARSE_PREFIXES)
    fig.band(ax, sparse, results.mean_m("vib"), COLOURS["vib"], "VIB (no orthogonality)", style="--")
    raw = float(results.mean_m("raw").mean())
    ax.axhline(raw, color=fig.GREY, lw=1, ls=":")
    ax.text(
        128, raw * 1.06, f"raw features (10 KB): {raw:.1f} m", ha="right", va="bottom", color="#555555", fontsize=6.5
    )
    chosen = float(curves[:, results.chosen - 1].mean())
    ax.plot(results.chosen, chosen, "*", ms=10, color=fig.RED, zorder=5)
    ax.annotate(
        f"selected k = {results.chosen}\n{chosen:.1f} m, {representation_bytes(results.chosen)} B",
        *((results.chosen, chosen), (results.chosen + 8, chosen * 2.2)),
        arrowprops={"arrowstyle": "-", "lw": 0.6},
    )
    ax.set(xlabel="prefix length k (floats)", ylabel="mean error (m)", yscale="log", xlim=(0, 129))
    fig.plain_log_ticks(ax.yaxis)
    ax.legend(loc="upper right")
    fig.title(ax, "a", "every rate from one model")


def _draw_frontier(ax: Axes, results: Results) -> None:
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
    ax.set(xlabel="payload (KB)", ylabel="mean error (m)", xscale="log", yscale="log")
    fig.plain_log_ticks(ax.yaxis)
    fig.plain_log_ticks(ax.xaxis)
    ax.legend(loc="upper right")
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


def _draw_latency(ax: Axes, results: Results, host: LatencyProfile) -> None:
    rate = kbytes_per_s(LINK_KB_PER_S)
    rows = [(f"O-VIB k={k}", k, PAPER_LATENCY_MS.get(k)) for k in sorted({16, 35, results.chosen})]
    rows += [(f"fixed-rate K={k}", k, PAPER_LATENCY_MS[k]) for k in FIXED]
    labels = [name for name, _, _ in rows] + ["raw features"]
    compute = [float(compute_ms_at(JETSON, k)) for _, k, _ in rows] + [0.0]
    sent = [1e3 * float(transmit_s(representation_bytes(k), rate)) for _, k, _ in rows]
    sent.append(1e3 * float(transmit_s(results.payload_bytes("raw", 0), rate)))
    y = np.arange(len(labels))
    ax.barh(y, compute, color=fig.ORANGE, height=0.6, label="encode (Jetson)")
    ax.barh(y, sent, left=compute, color=fig.BLUE, height=0.6, label="transmit")
    marks = [(ms, i) for i, (_, _, ms) in enumerate(rows) if ms is not None]
    ax.plot(*zip(*marks, strict=True), "|", ms=11, mew=1.6, color="black", label="paper")
    for i, total in enumerate(np.add(compute, sent)):
        ax.text(
            total * 1.06,
            i,
            f"{total:.0f} ms" if total < 1000 else f"{total / 1000:.2f} s",
            va="center",
            fontsize=6.5,
        )
    for name, seconds in PAPER_CODECS_S.items():
        ax.plot(seconds * 1e3, len(labels), "|", ms=8, mew=1.6, color="black")
        if name in ("WebP", "H.264"):
            ha = "right" if name == "WebP" else "left"
            ax.text(
                seconds * 1e3 * (0.93 if ha == "right" else 1.07),
                len(labels),
                name,
                ha=ha,
                va="center",
                fontsize=6.5,
            )
    ax.set_yticks([*y, len(labels)], [*labels, "image codecs (paper)"])
    ax.set(xlabel=f"latency at {LINK_KB_PER_S} KB/s (ms)", xscale="log", xlim=(8, 2e4))
    ax.invert_yaxis()
    ax.grid(visible=False, axis="y")
    ax.legend(loc="upper right")
    fig.plain_log_ticks(ax.xaxis, subs=(1.0,))
    fig.title(ax, "d", "latency after feature extraction")
