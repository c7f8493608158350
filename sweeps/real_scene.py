"""Fig. and Table "Real-scene localization": few references, separate queries, a UAV and a UGV in a room."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ovibjax.cards.indoor_drawing import draw
from ovibjax.cards.indoor_paper import PAPER
from ovibjax.cards.indoor_study import (
    PLATFORMS,
    PlatformResults,
    embedded_scenes,
    measure,
    platform_of,
    room_config,
    summary_rows,
    table_rows,
    tails_of,
)
from ovibjax.cards.job import Job
from ovibjax.report.claims import Claim, interval, write_claims
from ovibjax.report.rows import write_rows
from ovibjax.world.rooms.picture import room_sheet

TITLE = "Real-scene localization: a UAV and a UGV in a room"
TAKES_QUERIES = True


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
    "full": Preset(rooms=8, seeds=3, steps=600, checkpoints=12),
}


def run(job: Job) -> None:
    """Run the card: render or take the data, train, judge, write tables, claims, figure and the rooms' picture."""
    started = time.perf_counter()
    preset = PRESETS[job.preset]
    rooms = [job.seed + i for i in range(preset.rooms)]
    seeds = [job.seed + i for i in range(preset.seeds)]
    if job.queries is None:
        with job.stage("render"):
            scenes = embedded_scenes(rooms)
    else:
        scenes = {platform_of(job.features): {0: (job.features, job.queries)}}
    size = (seeds, preset.steps, preset.checkpoints, job.rank)
    found = [measure(job.sweep, name, of_name, *size) for name, of_name in scenes.items()]
    write_rows(job.out / "table.csv", [row for platform in found for row in table_rows(platform)])
    write_rows(job.out / "summary.csv", [row for platform in found for row in summary_rows(platform)])
    write_claims(job.out / "claims.json", [claim for platform in found for claim in judge_claims(platform)])
    with job.stage("draw"):
        draw(job.out / "figure.png", found, preset.steps, job.embedded)
        if job.embedded:
            room_sheet([(name, room_config(name, rooms[0])) for name in PLATFORMS], job.out / "rooms.png")
    job.record(
        *(TITLE, caption(found, job.embedded), seeds, started),
        over=(len(rooms), "rooms") if job.embedded else None,
        frames=", ".join(f"{platform.name} {platform.counts}" for platform in found),
        data="embedded rooms" if job.embedded else Path(job.source).name,
        rooms=" ".join(map(str, rooms)) if job.embedded else "1",
        steps=preset.steps,
        view_weights={part.name: part.data.weights.isel(seed=0).to_numpy().round(3).tolist() for part in found},
        best_checkpoint={part.name: (1 + part.data.best.to_numpy()).tolist() for part in found},
        checkpoints=preset.checkpoints,
    )


def judge_claims(found: PlatformResults) -> list[Claim]:
    """The paper's statements about one platform, by stated rules; differences are paired."""
    return [
        *_against_retrieval(found),
        _downward_view(found) if found.name == "UAV" else _large_residuals(found),
        *_protocol(found),
    ]


def _against_retrieval(found: PlatformResults) -> list[Claim]:
    name, whole, paper = found.name, found.whole, PAPER[found.name]
    raw, front = found.mean_m("raw"), found.mean_m("raw", mode="F")
    ovib, floor = found.mean_m("ovib", 32), found.mean_m("floor")
    coded_m, raw_m, floor_m = interval(ovib), interval(raw).text("m", 3), interval(floor).text("m", 3)
    raw_bytes, coded_bytes = found.payload_bytes("raw", 0, whole), found.payload_bytes("ovib", 32, whole)
    saved = 1 - coded_bytes / raw_bytes
    return [
        Claim.less(
            f"{name}: several views beat front-only (calibrated retrieval of raw features)",
            f"{paper.mode_m['F']} -> {paper.mode_m[whole]} m",
            f"{interval(front).text(digits=3)} -> {raw_m}, gain {interval(front - raw).text('m', 3)}",
            raw,
            front,
        ),
        Claim.less(
            f"{name}: O-VIB-32 has a lower mean error than calibrated retrieval of all views",
            f"{paper.table['retrieval'][1]} -> {paper.table[32][1]} m",
            f"{interval(raw).text(digits=3)} -> {coded_m.text('m', 3)}, gain {interval(raw - ovib).text('m', 3)}",
            ovib,
            raw,
        ),
        Claim.true(
            f"{name}: O-VIB-32 cuts the descriptor traffic by at least 98 %",
            f"{100 * paper.traffic_saved:.1f} %",
            f"{raw_bytes} B -> {coded_bytes} B, {100 * saved:.1f} %",
            saved >= 0.98,
            "sizes of the representations; arithmetic, nothing is measured",
        ),
        Claim.less(
            f"{name}: O-VIB-32 interpolates below the mean distance of a query to its nearest reference",
            f"{paper.table[32][1]} m against {paper.floor_m} m",
            f"{coded_m.text(digits=3)} m against {floor_m}, below by {interval(floor - ovib).text('m', 3)}",
            ovib,
            floor,
        ),
    ]


def _downward_view(found: PlatformResults) -> Claim:
    without, all_views, paper_m = found.mean_m("raw", mode="H4"), found.mean_m("raw"), PAPER["UAV"].mode_m
    return Claim.less(
        "UAV: the downward view improves on the four horizontal ones (calibrated retrieval)",
        f"{paper_m['H4']} -> {paper_m['A5']} m",
        f"gain {interval(without - all_views).text('m', 3)}",
        all_views,
        without,
    )


def _large_residuals(found: PlatformResults) -> Claim:
    (raw_p90_m, raw_recall), paper = tails_of(found.errors_m("raw")), PAPER["UGV"].table
    coded_p90_m, coded_recall = tails_of(found.errors_m("ovib", 32))
    return Claim.above_zero(
        "UGV: O-VIB-32 has a higher p90 and a lower R@0.5 than retrieval (regression leaves large residuals)",
        f"p90 {paper['retrieval'][2]} -> {paper[32][2]} m, R@0.5 98.6 -> 88.9 %",
        f"p90 {interval(raw_p90_m).text(digits=3)} -> {interval(coded_p90_m).text('m', 3)}, R@0.5 "
        f"{100 * raw_recall.mean():.1f} -> {100 * coded_recall.mean():.1f} %",
        coded_p90_m - raw_p90_m,
        raw_recall - coded_recall,
        rule="the whole intervals of both paired differences above zero",
    )


def _protocol(found: PlatformResults) -> list[Claim]:
    fold, uniform = (interval(found.data[field].isel(seed=0).to_numpy()) for field in ("fold_m", "fold_uniform_m"))
    scores_m = found.data.score.to_numpy()
    last_m, best_m = scores_m[..., -1].mean(), scores_m.min(axis=-1).mean()
    return [
        Claim.reported(
            f"{found.name}: what view-fusion weights are worth against equal weights, on the calibration folds",
            "-",
            f"{fold.text(digits=3)} m against {uniform.text('m', 3)}",
            "no worse by construction: equal weights are among those that calibration chooses from",
        ).as_own(),
        Claim.reported(
            f"{found.name}: what early stopping and the mixture with retrieval are worth",
            "-",
            f"validation error {best_m:.3f} m at the best checkpoint, {last_m:.3f} m at the last; queries at k = 32: "
            f"regression alone {interval(found.mean_m('regression', 32)).text('m', 3)}, mixture "
            f"{interval(found.mean_m('ovib', 32)).text('m', 3)}",
            "no rule; the validation error is that on which the checkpoint was chosen",
        ).as_own(),
    ]


def caption(found: Sequence[PlatformResults], embedded: bool) -> str:
    """What the reader of the figure needs to know."""
    rooms = len(found[0].rooms)
    over = f"{rooms} rooms" if rooms > 1 else "queries"
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
        f"training, on which the checkpoint is chosen. Bands and caps are 95 % intervals over {over}, each the mean of "
        f"{found[0].data.sizes['seed']} training seeds."
    )
