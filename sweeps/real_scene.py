"""Fig. and Table "Real-scene localization": few references, separate queries, a UAV and a UGV in a room."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray
from matplotlib.axes import Axes

from ovibjax.cards.job import Job
from ovibjax.edge.indoor import DIMS, Protocol, scene_data
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.train import PAPER_PREFIXES, TrainConfig
from ovibjax.features.frames import FeatureSet
from ovibjax.link.payload import representation_bytes
from ovibjax.report import figures as fig
from ovibjax.report.claims import (
    HELD,
    NOT_HELD,
    REPORTED,
    Claim,
    Interval,
    below,
    interval,
    positive,
    write_claims,
)
from ovibjax.report.rows import write_rows
from ovibjax.runtime.progress import progress_bar
from ovibjax.sweep import Along
from ovibjax.views import MODES, full_mode, modes_for
from ovibjax.world.rooms.feature_set import rooms_features
from ovibjax.world.rooms.picture import draw_plan, room_sheet
from ovibjax.world.rooms.room import make_room, platform_room

TITLE = "Real-scene localization: a UAV and a UGV in a room"
TAKES_QUERIES = True
RECALL_M = 0.5
TABLE_PREFIXES = (8, 32, 128)
PAPER_KB_MEAN_P90_RECALL = {
    "UAV": {
        "retrieval": (10.0, 0.407, 0.758, 0.862),
        8: (0.051, 0.286, 0.458, 0.897),
        32: (0.145, 0.293, 0.447, 0.914),
        128: (0.520, 0.274, 0.459, 0.931),
    },
    "UGV": {
        "retrieval": (8.0, 0.346, 0.396, 0.986),
        8: (0.051, 0.305, 0.519, 0.889),
        32: (0.145, 0.296, 0.501, 0.889),
        128: (0.520, 0.293, 0.481, 0.903),
    },
}
PAPER_MODE_M = {"UAV": {"F": 0.626, "H4": 0.415, "A5": 0.407}, "UGV": {"F": 0.622, "H4": 0.346}}
PAPER_FLOOR_M = {"UAV": 0.322, "UGV": 0.316}
PAPER_TRAFFIC_SHARE = {"UAV": 0.986, "UGV": 0.982}
COLOURS = {"UAV": fig.BLUE, "UGV": fig.ORANGE}
MARKERS = {"UAV": "o", "UGV": "s"}


@dataclass(frozen=True)
class Preset:
    """How much is run.

    Attributes:
        rooms: rooms per platform.
        seeds: training seeds per room.
        steps: of each training.
        checkpoints: of early stopping.
    """

    rooms: int
    seeds: int
    steps: int
    checkpoints: int


PRESETS = {
    "smoke": Preset(rooms=2, seeds=1, steps=40, checkpoints=4),
    "quick": Preset(rooms=4, seeds=2, steps=600, checkpoints=12),
    "full": Preset(rooms=8, seeds=3, steps=1000, checkpoints=20),
}


@dataclass(frozen=True)
class Found:
    """What one platform gave.

    Attributes:
        name: "UAV" or "UGV".
        data: outputs of the protocol over room and seed.
        scenes: references and queries per room.
        rooms: names of the rooms.
    """

    name: str
    data: xarray.Dataset
    scenes: list[tuple[FeatureSet, FeatureSet]]
    rooms: list[int]

    @property
    def whole(self) -> str:
        """The mode with every view."""
        return full_mode(self.scenes[0][0].features.shape[1])

    def errors(self, method: str, k: int = 0, mode: str | None = None) -> np.ndarray:
        """[rooms, seeds, Q] errors of a method: ovib, regression (at k), raw or floor."""
        part = self.data[f"{method}_m"]
        part = part if method == "floor" else part.sel(mode=mode or self.whole)
        part = part.sel(prefix=k) if "prefix" in part.dims else part
        return part.transpose("room", "seed", "query").to_numpy()

    def mean(self, method: str, k: int = 0, mode: str | None = None) -> np.ndarray:
        """Mean errors of independent repetitions: rooms, or the queries of somebody's only room."""
        return repetitions(self.errors(method, k, mode))

    def payload_bytes(self, method: str, k: int, mode: str) -> int:
        """Bytes of one representation: header and prefix, or the kept views as float32."""
        dim = self.scenes[0][0].features.shape[2]
        return representation_bytes(k) if method == "ovib" else 4 * dim * len(MODES[mode])


def repetitions(errors: np.ndarray) -> np.ndarray:
    """Means over training seeds, and over queries where there are several rooms, of values [rooms, seeds, Q]."""
    return errors.mean(axis=(1, 2)) if len(errors) > 1 else errors[0].mean(axis=0)


def spread_of(errors: np.ndarray) -> dict[str, Interval]:
    """Mean, 90th percentile and recall of errors [rooms, seeds, Q], with intervals over repetitions."""
    p90 = np.percentile(errors, 90, axis=2).mean(axis=1)
    return {
        "mean_m": interval(repetitions(errors)),
        "p90_m": interval(p90),
        "recall": interval(repetitions((errors <= RECALL_M).astype(float))),
    }


def run(job: Job) -> None:
    """Run the card: render or take the data, train, judge, write tables, claims, figure and the rooms' picture."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    rooms = [job.seed + i for i in range(preset.rooms)]
    seeds = [job.seed + i for i in range(preset.seeds)]
    if job.embedded:
        found = [measure(job, name, scenes, rooms, seeds, preset) for name, scenes in embedded_scenes(rooms)]
        room_sheet([(name.upper(), platform_room(name, rooms[0])) for name in ("uav", "ugv")], job.out / "rooms.png")
    else:
        assert job.queries is not None
        name = "UAV" if job.features.features.shape[1] == 5 else "UGV"
        found = [measure(job, name, [(job.features, job.queries)], [0], seeds, preset)]
    write_rows(job.out / "table.csv", [row for part in found for row in table_rows(part)])
    write_rows(job.out / "summary.csv", [row for part in found for row in summary_rows(part)])
    write_claims(job.out / "claims.json", [claim for part in found for claim in judge_claims(part)])
    draw(job.out / "figure.png", found, preset, job.embedded)
    counts = ", ".join(
        f"{part.name} {len(part.scenes[0][0].features)} references / {len(part.scenes[0][1].features)} queries"
        for part in found
    )
    job.record(
        *(TITLE, caption(found, job.embedded), seeds, started),
        frames=counts,
        data="embedded rooms" if job.embedded else Path(job.source).name,
        rooms=" ".join(map(str, rooms)) if job.embedded else "1",
        steps=preset.steps,
        view_weights={part.name: part.data.weights.isel(seed=0).to_numpy().round(3).tolist() for part in found},
        best_checkpoint={part.name: (1 + part.data.best.to_numpy()).tolist() for part in found},
        checkpoints=preset.checkpoints,
    )


def embedded_scenes(rooms: Sequence[int]) -> list[tuple[str, list[tuple[FeatureSet, FeatureSet]]]]:
    """References and queries of every room, per platform."""
    configs = [platform_room(name, seed) for name in ("uav", "ugv") for seed in rooms]
    with progress_bar(f"rendering {len(configs)} rooms", len(configs)) as update:
        scenes = rooms_features(configs, on_rooms=update)
    return [("UAV", scenes[: len(rooms)]), ("UGV", scenes[len(rooms) :])]


def measure(
    job: Job,
    name: str,
    scenes: list[tuple[FeatureSet, FeatureSet]],
    rooms: list[int],
    seeds: list[int],
    preset: Preset,
) -> Found:
    """The whole protocol of one platform over rooms and training seeds, as one sweep."""
    prepared = [scene_data(*scene, job.rank) for scene in scenes]
    n_views, dim = prepared[0][0].x.shape[1:]
    arch = Architecture(n_views=n_views, view_dim=dim, latent=PAPER_PREFIXES[-1], hidden=256, last_hidden=128, head=128)
    protocol = Protocol(TrainConfig(arch=arch, steps=preset.steps), PAPER_PREFIXES, preset.checkpoints)
    data = job.sweep(
        f"{name}: training and judging",
        protocol,
        {"room": rooms, "seed": seeds},
        Along("room", prepared),
        dims=DIMS,
        coords={"mode": list(modes_for(n_views)), "prefix": list(PAPER_PREFIXES)},
    )
    return Found(name, data, scenes, rooms)


def table_rows(found: Found) -> list[dict[str, Any]]:
    """One tidy row per room, training seed, view mode, method and prefix; retrieval has no training seed."""
    rows = []
    cases = [("retrieval", "raw", 0)] + [("ovib", "ovib", k) for k in PAPER_PREFIXES]
    for mode in found.data.mode.to_numpy().tolist():
        for method, field, k in cases:
            errors = found.errors(field, k, mode)
            for r, room in enumerate(found.rooms):
                for s, seed in enumerate(found.data.seed.to_numpy().tolist()):
                    if method == "retrieval" and s > 0:
                        continue
                    one = errors[r, s]
                    eta = 0.0 if method == "retrieval" else float(found.data.eta.sel(mode=mode, prefix=k)[r, s])
                    rows.append(
                        {
                            "platform": found.name,
                            "method": method,
                            "mode": mode,
                            "k": k or found.payload_bytes(method, k, mode) // 4,
                            "room": room,
                            "seed": seed if method == "ovib" else "",
                            "payload_bytes": found.payload_bytes(method, k, mode),
                            "mean_m": float(one.mean()),
                            "p90_m": float(np.percentile(one, 90)),
                            "recall_0.5m": float((one <= RECALL_M).mean()),
                            "eta": eta,
                            "floor_m": float(found.errors("floor")[r, s].mean()),
                        }
                    )
    return rows


def summary_rows(found: Found) -> list[dict[str, Any]]:
    """The paper's table: ours with 95 % intervals, and the paper's numbers."""
    rows = []
    for key, paper in PAPER_KB_MEAN_P90_RECALL[found.name].items():
        k = key if isinstance(key, int) else 0
        spread = spread_of(found.errors("ovib" if k else "raw", k))
        rows.append(
            {
                "platform": found.name,
                "representation": f"O-VIB-{k}" if k else "retrieval",
                "kb": f"{found.payload_bytes('ovib' if k else 'raw', k, found.whole) / 1024:.3f}",
                "mean_m": spread["mean_m"].text(digits=3),
                "p90_m": spread["p90_m"].text(digits=3),
                "recall_0.5m": spread["recall"].text(digits=3),
                **{f"paper_{name}": value for name, value in zip(("kb", "mean", "p90", "recall"), paper, strict=True)},
            }
        )
    return rows


def judge_claims(found: Found) -> list[Claim]:
    """The paper's statements about one platform, by stated rules; differences are paired."""
    name, whole = found.name, found.whole
    paper, modes = PAPER_KB_MEAN_P90_RECALL[name], PAPER_MODE_M[name]
    raw, front, ovib, floor = (
        *(found.mean("raw"), found.mean("raw", mode="F")),
        *(found.mean("ovib", 32), found.mean("floor")),
    )
    gain, views, under = interval(raw - ovib), interval(front - raw), interval(floor - ovib)
    rule = "the whole interval of the paired difference above zero"
    clip, code = found.payload_bytes("raw", 0, whole), found.payload_bytes("ovib", 32, whole)
    saved = 1 - code / clip
    claims = [
        Claim(
            f"{name}: several views beat front-only (calibrated retrieval of raw features)",
            f"{modes['F']} -> {modes[whole]} m",
            f"{interval(front).text(digits=3)} -> {interval(raw).text('m', 3)}, gain {views.text('m', 3)}",
            positive(views),
            rule,
        ),
        Claim(
            f"{name}: O-VIB-32 has a lower mean error than calibrated retrieval of all views",
            f"{paper['retrieval'][1]} -> {paper[32][1]} m",
            f"{interval(raw).text(digits=3)} -> {interval(ovib).text('m', 3)}, gain {gain.text('m', 3)}",
            positive(gain),
            rule,
        ),
        Claim(
            f"{name}: O-VIB-32 cuts the descriptor traffic by at least 98 %",
            f"{100 * PAPER_TRAFFIC_SHARE[name]:.1f} %",
            f"{clip} B -> {code} B, {100 * saved:.1f} %",
            HELD if saved >= 0.98 else NOT_HELD,
            "sizes of the representations; arithmetic, nothing is measured",
        ),
        Claim(
            f"{name}: O-VIB-32 interpolates below the mean distance of a query to its nearest reference",
            f"{paper[32][1]} m against {PAPER_FLOOR_M[name]} m",
            f"{interval(ovib).text(digits=3)} m against {interval(floor).text('m', 3)}, below by {under.text('m', 3)}",
            positive(under),
            rule,
        ),
    ]
    if name == "UAV":
        down = interval(found.mean("raw", mode="H4") - raw)
        claims.append(
            Claim(
                "UAV: the downward view improves on the four horizontal ones (calibrated retrieval)",
                f"{modes['H4']} -> {modes['A5']} m",
                f"gain {down.text('m', 3)}",
                positive(down),
                rule,
            )
        )
    else:
        retrieval, coded = spread_of(found.errors("raw")), spread_of(found.errors("ovib", 32))
        more, less = coded["p90_m"].mean - retrieval["p90_m"].mean, retrieval["recall"].mean - coded["recall"].mean
        claims.append(
            Claim(
                "UGV: O-VIB-32 has a higher p90 and a lower R@0.5 than retrieval (regression leaves large residuals)",
                f"p90 {paper['retrieval'][2]} -> {paper[32][2]} m, R@0.5 98.6 -> 88.9 %",
                f"p90 {retrieval['p90_m'].text(digits=3)} -> {coded['p90_m'].text('m', 3)}, R@0.5 "
                f"{100 * retrieval['recall'].mean:.1f} -> {100 * coded['recall'].mean:.1f} %",
                HELD if more > 0 and less > 0 else NOT_HELD,
                "both means",
            )
        )
    fold = [interval(found.data[field].isel(seed=0).to_numpy()) for field in ("fold_m", "fold_uniform_m")]
    scores = found.data.score.to_numpy()
    last, best = scores[..., -1].mean(), scores.min(axis=-1).mean()
    regression = interval(found.mean("regression", 32))
    return [
        *claims,
        Claim(
            f"{name}: view-fusion weights are no worse than equal weights on the calibration folds",
            "-",
            f"{fold[0].text(digits=3)} m against {fold[1].text('m', 3)}",
            below(Interval(fold[0].mean - fold[1].mean, 0.0), 0.0),
            "by construction; fails only if calibration is broken",
        ),
        Claim(
            f"{name}: what early stopping and the mixture with retrieval are worth",
            "-",
            f"validation error {best:.3f} m at the best checkpoint, {last:.3f} m at the last; queries at k = 32: "
            f"regression alone {regression.text('m', 3)}, mixture {interval(ovib).text('m', 3)}",
            REPORTED,
            "no rule; the validation error is that on which the checkpoint was chosen",
        ),
    ]


def caption(found: Sequence[Found], embedded: bool) -> str:
    """What the reader of the figure needs to know."""
    count = len(found[0].rooms)
    over = f"{count} rooms" if count > 1 else "queries"
    world = (
        "Embedded rooms stand in for the motion-capture captures (rooms.png shows one of each platform); the embedded "
        "backbone stands in for CLIP. "
        if embedded
        else ""
    )
    return (
        f"{world}(a) Reference (open) and query (filled) positions; grey: furniture. (b) Calibrated retrieval of raw "
        "features by view mode (bars) and O-VIB at k = 32 (diamonds); black ticks: the paper's values; dotted: mean "
        "distance of a query to its nearest reference. (c) Distribution of query errors; dotted: that distance. (d) "
        "Mean error against serialized size; crosses: raw features; hollow: the paper's. (e) Validation error along "
        "training, on which "
        f"the checkpoint is chosen. Bands and caps are 95 % intervals over {over}, each the mean of "
        f"{found[0].data.sizes['seed']} training seeds."
    )


def draw(path: Path, found: Sequence[Found], preset: Preset, embedded: bool) -> None:
    """The panels."""
    with mpl.rc_context(fig.style()):
        figure, axes = fig.panels(3, 2, height_in=2.45)
        for ax, part in zip(axes, found, strict=False):
            _draw_positions(ax, part, embedded)
        if len(found) == 1:
            axes[1].remove()
        _draw_modes(axes[2], found, embedded)
        _draw_distribution(axes[3], found)
        _draw_size(axes[4], found, embedded)
        _draw_training(axes[5], found, preset)
        fig.save_figure(figure, path)


def _draw_positions(ax: Axes, found: Found, embedded: bool) -> None:
    references, queries = found.scenes[0]
    if embedded:
        draw_plan(ax, make_room(platform_room(found.name.lower(), found.rooms[0])))
    look: dict[str, Any] = {"marker": MARKERS[found.name], "color": COLOURS[found.name], "ls": "", "zorder": 3}
    ax.plot(*references.positions_m[:, :2].T, mfc="white", ms=3.2, mew=0.8, label="reference", **look)
    ax.plot(*queries.positions_m[:, :2].T, ms=2.8, mec="none", label="query", **look)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.24), ncols=2, handletextpad=0.2)
    fig.title(ax, "a", f"{found.name}: {len(references.features)} references, {len(queries.features)} queries")


def _draw_modes(ax: Axes, found: Sequence[Found], embedded: bool) -> None:
    names = [mode for mode in MODES if any(mode in part.data.mode.to_numpy() for part in found)]
    width = 0.8 / len(found)
    for i, part in enumerate(found):
        modes = part.data.mode.to_numpy().tolist()
        x = np.array([names.index(mode) for mode in modes]) + (i - (len(found) - 1) / 2) * width
        spans = [interval(part.mean("raw", mode=mode)) for mode in modes]
        half = [span.half if np.isfinite(span.half) else 0.0 for span in spans]
        colour = COLOURS[part.name]
        ax.bar(
            x,
            [span.mean for span in spans],
            0.9 * width,
            yerr=half,
            color=colour,
            alpha=0.55,
            capsize=2,
            label=part.name,
        )
        coded = [interval(part.mean("ovib", 32, mode)).mean for mode in modes]
        ax.plot(x, coded, "D", ms=4, color=colour, mec="black", mew=0.6, zorder=4)
        ax.axhline(part.mean("floor").mean(), color=colour, ls=":", lw=1)
        if embedded:
            marks = [
                (at, PAPER_MODE_M[part.name][mode])
                for at, mode in zip(x, modes, strict=True)
                if mode in PAPER_MODE_M[part.name]
            ]
            ax.plot(*zip(*marks, strict=True), "_", ms=11, mew=1.5, color="black", zorder=5)
    ax.plot([], [], "D", ms=4, color="white", mec="black", mew=0.6, label="O-VIB, k = 32")
    if embedded:
        ax.plot([], [], "_", ms=9, mew=1.5, color="black", label="paper, retrieval")
    ax.set_xticks(range(len(names)), [{"FS": "F+S"}.get(name, name) for name in names])
    ax.set(xlabel="view mode", ylabel="mean error (m)")
    ax.set_ylim(top=ax.get_ylim()[1] * 1.4)
    ax.grid(visible=False, axis="x")
    ax.legend(loc="upper right", ncols=2, columnspacing=0.8)
    fig.title(ax, "b", "more views, less error")


def _draw_distribution(ax: Axes, found: Sequence[Found]) -> None:
    x = np.linspace(0, 1.2, 121)

    def curves(errors: np.ndarray) -> np.ndarray:
        below_x = errors[..., None] <= x
        return below_x.mean(axis=(1, 2)) if len(errors) > 1 else below_x[0].mean(axis=0)

    for part in found:
        colour = COLOURS[part.name]
        for method, k, style in (("ovib", 32, "-"), ("raw", 0, "--")):
            mean, half = fig.mean_and_half(curves(part.errors(method, k)))
            ax.fill_between(x, np.maximum(mean - half, 0), np.minimum(mean + half, 1), color=colour, alpha=0.15, lw=0)
            name = "O-VIB-32" if method == "ovib" else "retrieval"
            ax.plot(x, mean, style, color=colour, label=f"{part.name} {name}")
        ax.plot(x, curves(part.errors("floor")).mean(axis=0), ":", color=colour, lw=1)
    ax.axvline(RECALL_M, color=fig.GREY, lw=0.7)
    ax.set(xlabel="query error (m)", ylabel="share of queries", xlim=(0, 1.2), ylim=(0, 1.01))
    ax.legend(loc="lower right")
    fig.title(ax, "c", "error distribution")


def _draw_size(ax: Axes, found: Sequence[Found], embedded: bool) -> None:
    kib = np.array([representation_bytes(k) for k in PAPER_PREFIXES]) / 1024
    for part in found:
        colour, marker = COLOURS[part.name], MARKERS[part.name]
        curves = np.stack([part.mean("ovib", k) for k in PAPER_PREFIXES], axis=1)
        fig.band(ax, kib, curves, colour, f"{part.name} O-VIB", marker=marker)
        raw = interval(part.mean("raw"))
        half = raw.half if np.isfinite(raw.half) else 0.0
        at = part.payload_bytes("raw", 0, part.whole) / 1024
        ax.errorbar(at, raw.mean, half, fmt="X", ms=6, color=colour, capsize=2, lw=1, label=f"{part.name} raw features")
        ax.axhline(part.mean("floor").mean(), color=colour, ls=":", lw=1)
        if embedded:
            paper = PAPER_KB_MEAN_P90_RECALL[part.name].values()
            ax.plot(
                [row[0] for row in paper], [row[1] for row in paper], marker, ms=4, mfc="none", mew=0.9, color=colour
            )
    if embedded:
        ax.plot([], [], "o", ms=4, mfc="none", mew=0.9, color=fig.GREY, label="paper")
    ax.plot([], [], ":", color=fig.GREY, label="nearest reference")
    ax.set(xlabel="representation (KB)", ylabel="mean error (m)", xscale="log")
    ax.set_ylim(bottom=0, top=ax.get_ylim()[1] * 1.6)
    fig.plain_log_ticks(ax.xaxis, subs=(1.0, 3.0))
    ax.legend(loc="upper center", ncols=2, columnspacing=0.8)
    fig.title(ax, "d", "size and error")


def _draw_training(ax: Axes, found: Sequence[Found], preset: Preset) -> None:
    step = np.arange(1, preset.checkpoints + 1) * preset.steps / preset.checkpoints
    for part in found:
        scores = part.data.score.transpose("room", "seed", "checkpoint").to_numpy()
        fig.band(ax, step, scores.reshape(-1, preset.checkpoints), COLOURS[part.name], part.name)
        best = part.data.best.to_numpy().ravel()
        ax.plot(step[best], scores.reshape(-1, preset.checkpoints).min(axis=1), ".", ms=4, color=COLOURS[part.name])
    ax.plot([], [], ".", color=fig.GREY, label="checkpoint kept")
    ax.set(xlabel="training step", ylabel="validation error (m)")
    ax.legend(loc="upper right")
    fig.title(ax, "e", "early stopping")
