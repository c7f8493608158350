"""The seven workloads of the paper's table "Datasets and evaluation configurations", each beside the one that stands in
for it here; sizes are read off the constants that the cards run with.
"""

from typing import Any, NamedTuple

from ovibjax.cards.retrieval_benchmark import FRAMES, QUERIES, TOWNS
from ovibjax.control.drives import DRIVES
from ovibjax.control.environment import PAPER_SLOTS
from ovibjax.control.policies import POLICIES, VARIANTS
from ovibjax.features.splits import split_indices
from ovibjax.report.claims import Claim
from ovibjax.views import VIEWS
from ovibjax.world.rooms.room import RoomConfig, platform_room
from ovibjax.world.town.feature_set import PAPER_FRAMES


class Workload(NamedTuple):
    """One row.

    Attributes:
        setting: the paper's name.
        paper: the paper's path, scenes, frames or routes, and views.
        paper_sizes: numbers in it that ours can equal.
        ours: what stands in for it.
        our_sizes: the same numbers here; empty where nothing stands in.
        used_by: cards.
    """

    setting: str
    paper: str
    paper_sizes: tuple[float, ...]
    ours: str
    our_sizes: tuple[float, ...]
    used_by: str

    @property
    def equal(self) -> bool:
        """Whether ours has the paper's size."""
        return self.paper_sizes == self.our_sizes


def workloads(seed: int) -> list[Workload]:
    """The paper's rows in its order (Table "setup").

    Args:
        seed: of the single-scene split.

    Returns:
        Seven rows.
    """
    parts, views, towns = tuple(map(len, split_indices(PAPER_FRAMES, seed))), len(VIEWS), len(TOWNS)
    papers = len(POLICIES) - len(VARIANTS)
    return [
        Workload(
            "Single-scene split",
            "Town05: 1 scene; 4994 frames; 3495/749/750; 5 views",
            (4994, 3495, 749, 750, 5),
            f"embedded town: 1 scene; {PAPER_FRAMES} frames; {'/'.join(map(str, parts))}; {views} views",
            (PAPER_FRAMES, *parts, views),
            "scalable_compression encoder_ablation single_scene_ib",
        ),
        Workload(
            "Raw multi-scene data",
            "CARLA UAV: 5 scenes; 6684 frames; 5 views",
            (5, 6684, 5),
            "none: towns are rendered at the sampled size",
            (),
            "-",
        ),
        Workload(
            "Sampled benchmark",
            "CARLA subset: 5 scenes; 4593 frames; 5 views",
            (5, 4593, 5),
            f"embedded towns: {towns} scenes; {FRAMES} frames; {views} views",
            (towns, FRAMES, views),
            "retrieval",
        ),
        Workload(
            "Control workload",
            "Town02 route replay: 593 slots; 7 policies",
            (593, 7),
            f"small embedded town: {DRIVES} drives of {PAPER_SLOTS} slots; {papers} policies and a variant",
            (PAPER_SLOTS, papers),
            "voi_predictor request_control view_rate_selection voi_timing multi_client weights",
        ),
        Workload(
            "Retrieval queries",
            "5 scenes; 400 queries; 5 views",
            (5, 400, 5),
            f"{towns} scenes; {QUERIES} queries a draw; {views} views",
            (towns, QUERIES, views),
            "retrieval",
        ),
        _room("Indoor UAV", "4.1 x 4.0 m; 76 references; 58 queries; 5 views", (4.1, 4.0, 76, 58, 5), "uav"),
        _room("Indoor UGV", "5.0 x 4.0 m; 78 references; 72 queries; 4 views", (5.0, 4.0, 78, 72, 4), "ugv"),
    ]


def _room(setting: str, paper: str, sizes: tuple[float, ...], platform: str) -> Workload:
    room: RoomConfig = platform_room(platform, 0)
    ours = (*room.size_m[:2], room.references, room.queries, room.n_views)
    text = "{} x {} m; {} references; {} queries; {} views".format(*ours)
    return Workload(setting, f"motion capture: {paper}", sizes, f"embedded room: {text}", ours, "real_scene")


def workload_rows(rows: list[Workload]) -> list[dict[str, Any]]:
    """The table as it is written."""
    return [
        {"setting": row.setting, "paper": row.paper, "ours": row.ours, "equal": "yes" if row.equal else "no"}
        | {"used_by": row.used_by}
        for row in rows
    ]


def sizes_claim(rows: list[Workload]) -> Claim:
    """How many rows of the paper's table are here at its size."""
    other = ", ".join(row.setting for row in rows if not row.equal)
    return Claim.reported(
        "Workloads of the paper's table that are here at its size",
        f"{len(rows)} rows",
        f"{sum(row.equal for row in rows)} of {len(rows)}; not: {other or 'none'}",
        "read off the constants that the cards run with; workloads.csv",
    ).as_own()
