"""The paper's claims on coarse-to-fine retrieval at its own operating point, and ours at the selected one."""

import numpy as np

from ovibjax.cards.raw_images import PAPER_KB, upload_s
from ovibjax.cards.retrieval_benchmark import Point
from ovibjax.cards.retrieval_study import PREFIX, PRUNED, RECALL, RetrievalStudy
from ovibjax.report.claims import Claim, Interval, above, interval, positive, weakest

PAPER = {"pruned": 0.933, "scene": 0.985, "tile": 0.985, "brute_ms": 5.75, "fine_ms": 4.21}
PAPER_M = {"brute": 2.60, "fine": 6.52, "hit": 2.60}
"""The paper's shares, latency and mean errors."""
SAME_M = 0.1


def retrieval_claims(found: RetrievalStudy) -> list[Claim]:
    """The paper's statements at its own numbers, then checks and expectations of ours, then what is only reported.

    Args:
        found: the study.

    Returns:
        The claims, judged.
    """
    judged = [_scene(found), _tile(found), _conditional(found), _astray(found)]
    own = [_exact(found), _selected(found), _selected_error(found)]
    return [*judged, *(claim.as_own() for claim in own), *_raw(found), _latency(found), _growth(found)]


def _scene(found: RetrievalStudy) -> Claim:
    kept = found.at(found.paper, "scene_hit")
    return Claim.at_least(
        "The scene of a query is among its two most similar scene prototypes",
        "98.5 %",
        _percent(interval(kept)),
        PAPER["scene"],
        kept,
        rule="interval at or above the paper's 98.5 %",
    )


def _tile(found: RetrievalStudy) -> Claim:
    pruned, hit = (interval(found.at(found.paper, name)) for name in ("pruned", "tile_hit"))
    return Claim(
        "The right tile is among the twelve most similar tile prototypes, while 90 % or more is pruned",
        "98.5 %, with 93.3 % pruned",
        f"{_text(found.paper)}: {_percent(hit)}, with {_percent(pruned)} pruned",
        weakest([above(pruned, PRUNED), above(hit, PAPER["tile"])]),
        "interval of the recall at or above the paper's 98.5 %, that of the pruned share at or above 90 %",
    )


def _conditional(found: RetrievalStudy) -> Claim:
    """The paper's two numbers are over different queries, and that is what makes their equality a statement."""
    ours, brute = found.at(found.paper, "error_hit_m"), found.at(found.paper, "brute_m")
    return Claim.within(
        "Where the right tile is kept, coarse-to-fine retrieval has the error of brute force over all queries: the "
        "tiles that are lost are not those of difficult queries",
        "2.60 m and 2.60 m",
        f"{interval(ours).text('m')} and {interval(brute).text('m')}, difference {interval(ours - brute).text('m', 3)}",
        SAME_M,
        ours - brute,
        rule=f"interval of the paired difference within {SAME_M:g} m of zero (tolerance ours)",
    )


def _astray(found: RetrievalStudy) -> Claim:
    ours, brute = found.at(found.paper, "error_m"), found.at(found.paper, "brute_m")
    excess, astray = ours - brute, found.at(found.paper, "astray_excess_m")
    wrong = interval(found.at(found.paper, "wrong_scene"))
    return Claim(
        "Over all queries the error rises above brute force because misses select the wrong scene",
        "6.52 m against 2.60 m, six misses of 400 (1.5 %)",
        f"{interval(ours).text('m')} against {interval(brute).text('m')}: {interval(excess).text('m')} more, of which "
        f"queries answered with another scene ({_percent(wrong)}) contribute {interval(astray).text('m')}",
        weakest([positive(interval(excess)), positive(interval(astray - excess / 2))]),
        "interval of the excess above zero, and that of what the wrong scene contributes above half of it",
    )


def _exact(found: RetrievalStudy) -> Claim:
    ours, brute = found.at(found.paper, "error_hit_m"), found.at(found.paper, "brute_hit_m")
    return Claim.within(
        "Check of the search, which is exact inside the tiles it keeps: both methods have one error over the queries "
        "whose right tile is kept",
        "-",
        f"{interval(ours).text('m')} and {interval(brute).text('m')}, difference {interval(ours - brute).text('m', 3)}",
        SAME_M,
        ours - brute,
        rule=f"interval of the paired difference within {SAME_M:g} m of zero",
    )


def _selected(found: RetrievalStudy) -> Claim:
    pruned, hit, scene = (interval(found.at(found.chosen, name)) for name in ("pruned", "tile_hit", "scene_hit"))
    return Claim(
        "The point selected on tuning draws prunes 90 % or more at 98 % tile recall",
        "-",
        f"{_text(found.chosen)}: {_percent(pruned)} pruned, tile recall {_percent(hit)}, scene kept {_percent(scene)}",
        weakest([above(pruned, PRUNED), above(hit, RECALL)]),
        "intervals of the pruned share above 90 % and of the tile recall above 98 %",
    )


def _selected_error(found: RetrievalStudy) -> Claim:
    ours, brute = found.at(found.chosen, "error_m"), found.at(found.chosen, "brute_m")
    return Claim.at_most(
        f"At the selected point, pruning costs at most {SAME_M:g} m over all queries",
        "-",
        f"{interval(ours).text('m')} against {interval(brute).text('m')}, difference "
        f"{interval(ours - brute).text('m', 3)}",
        SAME_M,
        ours - brute,
        rule=f"interval of the paired difference at most {SAME_M:g} m",
    )


def _raw(found: RetrievalStudy) -> list[Claim]:
    if len(found.raw_bytes) == 0:
        return []
    kb, seconds = interval(found.raw_bytes / 1e3), interval(upload_s(found.raw_bytes))
    return [
        Claim.reported(
            "The five views as image files, and their upload at 2 Mbps",
            f"{PAPER_KB} KB; 3.59 s with all, of which 99.3 % are upload",
            f"{kb.text('KB', 0)}, {seconds.text('s')}: PNG files of 400 x 300 px, {len(found.raw_bytes)} frames",
            "sizes of what is rendered here, which is not CARLA",
        )
    ]


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
        "from O(N d) to O(N_tile d)",
        f"time grows as N^{found.slope('brute'):.2f} (brute force), N^{found.slope('fine_2'):.2f} (2 scenes kept), "
        f"N^{found.slope('fine_all'):.2f} (all scenes) from N = {first['n']:,.0f} to {last['n']:,.0f}; there "
        f"{last['brute']:.3g}, {last['fine_2']:.3g} and {last['fine_all']:.3g} ms per query",
        "slopes of a log-log fit",
    )


def retrieval_caption(found: RetrievalStudy) -> str:
    """What the reader of the figure needs to know."""
    floor = interval(np.asarray(found.grid[found.chosen.tile_m].floor_m)[:, 0, 0])
    raw = " Image upload: five PNG files at 2 Mbps." if len(found.raw_bytes) else ""
    return (
        f"Queries pass through a label-free code (k = {PREFIX} unless said), the database is uncompressed; queries "
        f"are drawn from a pool that the code was not trained on, {floor.text('m')} from the nearest reference. Mean "
        f"and 95 % interval over {len(found.seeds)} draws. Paper's point: {_text(found.paper)}; selected on tuning "
        f"draws: {_text(found.chosen)}. (a) Latency after warming up, one query at a time; paper: Jetson.{raw} "
        "(b) Recall of scenes, and of the right tile, which holds the nearest reference, at the paper's tile size. (c) "
        "Every point of the grid of scenes, tiles and tile edges. (d) Error, conditional on the right tile and over "
        "all queries; across scenes it is the distance in their overlapping coordinates, as in the paper. (e) By "
        "prefix of the code. (f) Databases recombined from the drives' views, 12 tiles kept: cost only, "
        "batches of queries; C2f: coarse-to-fine."
    )


def _text(point: Point) -> str:
    scenes, tiles, tile_m = point
    return f"{scenes} scenes, {tiles} tiles of {tile_m:g} m"


def _percent(share: Interval) -> str:
    return Interval(100 * share.mean, 100 * share.half).text("%", 1)
