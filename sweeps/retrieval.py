"""Fig. "Coarse-to-fine retrieval on the sampled multi-scene benchmark": what prototypes prune, and what that costs."""

import time

import numpy as np

from ovibjax.cards.job import Job
from ovibjax.cards.retrieval_benchmark import FRAMES, QUERIES, Point
from ovibjax.cards.retrieval_drawing import draw
from ovibjax.cards.retrieval_study import (
    PREFIX,
    PRUNED,
    RECALL,
    SCENES,
    TILES,
    RetrievalStudy,
    StudySize,
    measure,
    table_rows,
)
from ovibjax.report.claims import Claim, Interval, above, interval, near_zero, positive, weakest, write_claims
from ovibjax.report.rows import write_rows

TITLE = "Coarse-to-fine retrieval on the sampled multi-scene benchmark"
SAME_M = 0.1
PRESETS = {
    "smoke": StudySize(2, 240, 24, 1, 2, 60, (10.0, 30.0), (1_000, 2_000), 1),
    "quick": StudySize(5, FRAMES, QUERIES, 2, 5, 2000, (5.0, 10.0, 20.0, 30.0), (5_000, 20_000, 100_000), 3),
    "full": StudySize(
        5, FRAMES, QUERIES, 5, 20, 2000, (5.0, 7.5, 10.0, 15.0, 20.0, 30.0), (5_000, 30_000, 200_000, 1_000_000), 3
    ),
}


def run(job: Job) -> None:
    """Run the card: render, train, sweep, time, tables, claims and figure."""
    started = time.perf_counter()
    found = measure(job, PRESETS[job.preset])
    write_rows(job.out / "table.csv", table_rows(found))
    write_rows(job.out / "growth.csv", found.growth)
    write_claims(job.out / "claims.json", judge_claims(found))
    with job.stage("draw"):
        draw(job.out / "figure.png", found)
    job.record(TITLE, caption(found), found.seeds, started, chosen=list(found.chosen), scenes=found.n_scenes)


def judge_claims(found: RetrievalStudy) -> list[Claim]:
    """The paper's statements at its own numbers of scenes and tiles, and at the point that tuning chose."""
    return [
        *_at(found, "the paper's", found.paper),
        *_at(found, "the selected", found.chosen),
        _scene(found),
        _latency(found),
        _growth(found),
    ]


def _at(found: RetrievalStudy, name: str, point: Point) -> list[Claim]:
    """Three claims at one point."""
    return [_pruned(found, name, point), _equal(found, name, point), _excess(found, name, point)]


def _pruned(found: RetrievalStudy, name: str, point: Point) -> Claim:
    pruned, hit, scene = (interval(found.at(point, measure)) for measure in ("pruned", "tile_hit", "scene_hit"))
    return Claim(
        f"At {name} numbers of scenes and tiles, at least 90 % is pruned at 98 % tile recall",
        "93.3 % pruned, tile top-12 recall 98.5 %",
        f"{_text(point)}: {_percent(pruned)} pruned, tile recall {_percent(hit)}, scene kept {_percent(scene)}",
        weakest([above(pruned, PRUNED), above(hit, RECALL)]),
        "intervals of the pruned share above 90 % and of the tile recall above 98 %",
    )


def _equal(found: RetrievalStudy, name: str, point: Point) -> Claim:
    ours, brute = found.at(point, "error_hit_m"), found.at(point, "brute_hit_m")
    more = interval(ours - brute).text("m", 3)
    return Claim.within(
        f"At {name} numbers, both methods have the same error given the right tile",
        "2.60 m and 2.60 m",
        f"{interval(ours).text('m')} and {interval(brute).text('m')}, difference {more}",
        SAME_M,
        ours - brute,
        rule=f"interval of the paired difference within {SAME_M:g} m of zero",
    )


def _excess(found: RetrievalStudy, name: str, point: Point) -> Claim:
    ours, brute = found.at(point, "error_m"), found.at(point, "brute_m")
    excess, rest = interval(ours - brute), interval(found.at(point, "kept_excess_m"))
    return Claim(
        f"At {name} numbers, the all-query error is above brute force by the coarse misses and no more",
        "6.52 m against 2.60 m, six misses of 400",
        f"{interval(ours).text('m')} against {interval(brute).text('m')}: {excess.text('m', 3)} more, of which queries "
        f"with the right tile kept contribute {rest.text('m', 3)}; another scene is answered to "
        f"{_percent(interval(found.at(point, 'wrong_scene')))}",
        weakest([positive(excess), near_zero(rest, SAME_M)]),
        f"interval of the excess above zero, that of the part without misses within {SAME_M:g} m of zero",
    )


def _scene(found: RetrievalStudy) -> Claim:
    kept = found.at(Point(min(SCENES, found.n_scenes), TILES, found.paper[2]), "scene_hit")
    return Claim.at_least(
        "The scene is among the top two scene prototypes",
        "98.5 %",
        _percent(interval(kept)),
        RECALL,
        kept,
        rule="interval above 98 %",
    )


def _latency(found: RetrievalStudy) -> Claim:
    ms = {name: found.median_ms(name) for name in found.times}
    return Claim.reported(
        "Coarse-to-fine retrieval takes less time than brute force",
        "4.21 ms against 5.75 ms (Jetson Orin NX)",
        f"{ms['fine_1']:.2f} ms against {ms['brute_1']:.2f} ms for one query, {ms['fine_all']:.3f} and "
        f"{ms['brute_all']:.3f} ms per query in one batch, median",
        "times of one machine",
    )


def _growth(found: RetrievalStudy) -> Claim:
    first, last = found.growth[0], found.growth[-1]
    return Claim.reported(
        "Fine search costs O(N_tile) instead of O(N)",
        "-",
        f"time grows as N^{found.slope('brute'):.2f} (brute force), N^{found.slope('fine_2'):.2f} (2 scenes kept), "
        f"N^{found.slope('fine_all'):.2f} (all scenes) from N = {first['n']:,.0f} to {last['n']:,.0f}; there "
        f"{last['brute']:.3g}, {last['fine_2']:.3g} and {last['fine_all']:.3g} ms per query",
        "slopes of a log-log fit",
    )


def _text(point: Point) -> str:
    scenes, tiles, tile_m = point
    return f"{scenes} scenes, {tiles} tiles of {tile_m:g} m"


def _percent(share: Interval) -> str:
    return Interval(100 * share.mean, 100 * share.half).text("%", 1)


def caption(found: RetrievalStudy) -> str:
    """What the reader of the figure needs to know."""
    part = found.grid[found.chosen[2]]
    floor = interval(np.asarray(part.floor_m)[:, 0, 0])
    return (
        f"Queries pass through a label-free code (k = {PREFIX} unless said), the database is uncompressed; queries "
        f"are drawn from a pool that the code was not trained on, {floor.text('m')} from the nearest reference. Mean "
        f"and 95 % interval over {len(found.seeds)} draws. Paper's point: {_text(found.paper)}; selected on tuning "
        f"draws: {_text(found.chosen)}. (a) Latency after warming up, one query at a time; paper: Jetson, and raw "
        "images over 2 Mbps. (b) Recall of scenes, and of the right tile, which holds the nearest reference. (c) Every "
        "point of the grid of scenes, tiles and tile edges. (d) Error, conditional on the right tile and over all "
        "queries; across scenes it is the distance in their overlapping coordinates, as in the paper. (e) By prefix of "
        "the code. (f) Databases recombined from the drives' views, 12 tiles kept: cost only, "
        "batches of queries; C2f: coarse-to-fine."
    )
