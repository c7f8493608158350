"""The paper's numbers of the indoor experiment: a UAV and a UGV under motion capture."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Paper:
    """The paper's numbers of one platform, metres unless said (Table "real_ablation").

    Attributes:
        table: kilobytes, mean, 90th percentile and recall by prefix length, and of "retrieval" of raw features.
        mode_m: mean error of retrieval by view mode.
        floor_m: mean distance of a query to its nearest reference.
        traffic_saved: share of the descriptor traffic that O-VIB-32 saves.
    """

    table: dict[str | int, tuple[float, float, float, float]]
    mode_m: dict[str, float]
    floor_m: float
    traffic_saved: float


PAPER = {
    "UAV": Paper(
        table={
            "retrieval": (10.0, 0.407, 0.758, 0.862),
            8: (0.051, 0.286, 0.458, 0.897),
            32: (0.145, 0.293, 0.447, 0.914),
            128: (0.520, 0.274, 0.459, 0.931),
        },
        mode_m={"F": 0.626, "H4": 0.415, "A5": 0.407},
        floor_m=0.322,
        traffic_saved=0.986,
    ),
    "UGV": Paper(
        table={
            "retrieval": (8.0, 0.346, 0.396, 0.986),
            8: (0.051, 0.305, 0.519, 0.889),
            32: (0.145, 0.296, 0.501, 0.889),
            128: (0.520, 0.293, 0.481, 0.903),
        },
        mode_m={"F": 0.622, "H4": 0.346},
        floor_m=0.316,
        traffic_saved=0.982,
    ),
}
"""By platform."""
