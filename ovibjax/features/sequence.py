"""Whether frames are a drive in their order, or places in none; and what a drive's stops and jumps are."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, StrPath, refusal
from ovibjax.features.frames import FeatureSet

ORDERS = ("drive", "places")
"""What somebody can say that frames are."""

_STOP_M = 1e-3  # less is no movement
_JUMP = 10.0  # a step this many times the median is no movement but the start of another drive
_PAIRS = 4096
_FEW = 10  # steps that say nothing


class Sequence(NamedTuple):
    """Frames in their order, scene by scene.

    Attributes:
        step_m: median distance from frame to frame, stops left out; 0 where nothing moves.
        apart_m: median distance between any two frames of a scene.
        length_m: length of the drives, jumps left out.
        stops: steps of less than a millimetre.
        jumps: steps of over ten times the median.
        is_drive: whether the order looks like that of a drive.
    """

    step_m: float
    apart_m: float
    length_m: float
    stops: int
    jumps: int
    is_drive: bool

    def line(self) -> str:
        """The sequence in words, for one line."""
        if not self.is_drive:
            far = f"neighbours are {self.step_m:.3g} m apart, any two frames {self.apart_m:.3g} m (medians)"
            return f"places in no order: {far}"
        said = f"a drive of {self.length_m:.4g} m, {self.step_m:.3g} m from frame to frame (median)"
        kinds = ((self.stops, "stop", "under 1 mm"), (self.jumps, "jump", f"over {_JUMP:g} times the median"))
        told = [f", {count} {name}{'s'[: count != 1]} ({what})" for count, name, what in kinds if count]
        return said + "".join(told)


def sequence_of(positions_m: NDArray[np.float64], scene_id: NDArray[np.int32]) -> Sequence:
    """Look at the order of some frames.

    Along a drive neighbours are close. Where they are as far apart as any two frames, or half so and every step goes
    back where the last one came from, the order is none of time.

    Args:
        positions_m: [N, 3].
        scene_id: [N]; a step from one scene to another is none.

    Returns:
        The sequence; a handful of frames is taken for a drive.
    """
    scenes = [positions_m[scene_id == scene] for scene in np.unique(scene_id)]
    step = [np.diff(places, axis=0) for places in scenes]
    length = np.concatenate([np.linalg.norm(one, axis=1) for one in step])
    moving = length[length >= _STOP_M]
    typical = float(np.median(moving)) if moving.size else 0.0
    apart = float(np.median(np.concatenate([_apart_m(places, len(positions_m)) for places in scenes])))
    jumps = length > max(_JUMP * typical, _STOP_M)
    turns = np.concatenate([_turn_cosines(one) for one in step])
    back = float(turns.mean()) if turns.size else 1.0
    share = typical / apart if apart > 0 else 0.0
    return Sequence(
        step_m=typical,
        apart_m=apart,
        length_m=float(length[~jumps].sum()),
        stops=int((length < _STOP_M).sum()),
        jumps=int(jumps.sum()),
        is_drive=moving.size < _FEW or not (share > 0.5 or (share > 0.2 and back < -0.2)),
    )


def require_drive(feature_set: FeatureSet, source: StrPath, order: str | None = None) -> FeatureSet:
    """Refuse frames that nobody has driven through in their order.

    Args:
        feature_set: frames of somebody's own.
        source: what to call them.
        order: one of `ORDERS`, where somebody said; None as they look.

    Returns:
        The same set.

    Raises:
        InputError: places in no order; the message says what settles it.
    """
    if order not in (None, *ORDERS):
        raise InputError(f"--order {order}: frames are {' or '.join(ORDERS)}")
    found = sequence_of(feature_set.positions_m, feature_set.scene_id)
    if order == "drive" or (order is None and found.is_drive):
        return feature_set
    said = found.line() if order is None else "said to be places in no order"
    settled = "; --order drive if they are one all the same" if order is None else ""
    raise refusal(
        source, f"{said}, and a drive is needed; order a table by time: ovibjax features --order COLUMN{settled}"
    )


def _apart_m(places_m: NDArray[np.float64], among: int) -> NDArray[np.float64]:
    """Distances between random pairs of a scene, as many as its share of all frames."""
    count = max(1, _PAIRS * len(places_m) // among)
    one, other = np.random.default_rng(0).integers(0, len(places_m), (2, count))
    distance: NDArray[np.float64] = np.linalg.norm(places_m[one] - places_m[other], axis=1)
    return distance[one != other] if (one != other).any() else np.zeros(1)


def _turn_cosines(step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cosines of the angles between steps that follow one another, those of stops left out."""
    moving = step[np.linalg.norm(step, axis=1) >= _STOP_M]
    unit = moving / np.linalg.norm(moving, axis=1, keepdims=True)
    cosines: NDArray[np.float64] = (unit[1:] * unit[:-1]).sum(axis=1)
    return cosines
