"""Metadata and calibration files of the released layout: small JSON that nobody vouches for."""

import json
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ovibjax.errors import InputError, refusal
from ovibjax.features.frames import CONTEXTS
from ovibjax.features.images.source import MAX_MAGNITUDE, MAX_TEXT_BYTES, Files


class Pose(NamedTuple):
    """What a metadata file says of its frame.

    Attributes:
        position_m: x, y, z in the axes of the data.
        yaw_rad: heading, from x towards y.
        scene: last part of the map's name, "" if it has none.
        context: index into `frames.CONTEXTS`, -1 where unknown.
    """

    position_m: tuple[float, float, float]
    yaw_rad: float
    scene: str
    context: int


def _json(files: Files, name: str) -> dict[str, Any]:
    """A small JSON object; ValueError with the reason if it is none."""
    if files.sizes_bytes[name] > MAX_TEXT_BYTES:
        raise ValueError(f"{files.sizes_bytes[name]} bytes, too large")
    try:
        value = json.loads(files.read(name))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON ({' '.join(str(error).split())[:60]})") from error
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _numbers(value: Any, keys: Sequence[str], what: str) -> list[float]:
    """Finite numbers from an object with these keys, or from a list in their order."""
    if isinstance(value, dict):
        value = [value.get(key) for key in keys]
    if not isinstance(value, list) or len(value) != len(keys):
        raise ValueError(f"no {what} with {' '.join(keys)}")
    if any(isinstance(number, bool) or not isinstance(number, int | float) for number in value):
        raise ValueError(f"{what} is not numbers")
    # A whole number may have more digits than a float holds; the comparison takes any.
    if not all(-MAX_MAGNITUDE <= number <= MAX_MAGNITUDE for number in value):
        raise ValueError(f"{what} is not finite")
    return [float(number) for number in value]


def read_pose(files: Files, name: str) -> Pose:
    """Pose, scene and context of one metadata file.

    Args:
        files: where it lies.
        name: its name.

    Returns:
        The pose in the axes of the data.

    Raises:
        ValueError: no JSON object, or no finite position and rotation in it; the message is the reason.
    """
    about = _json(files, name)
    state = about.get("uav_state")
    if not isinstance(state, dict):
        raise ValueError("no uav_state")
    position = _numbers(state.get("position"), ("x", "y", "z"), "position")
    _, yaw_deg, _ = _numbers(state.get("rotation"), ("pitch", "yaw", "roll"), "rotation")
    scene, context = about.get("map_name"), about.get("context")
    return Pose(
        position_m=(position[0], position[1], position[2]),
        yaw_rad=math.radians(yaw_deg),
        # CARLA names its maps by path, "Carla/Maps/Town05".
        scene=scene.rsplit("/", 1)[-1] if isinstance(scene, str) else "",
        context=CONTEXTS.index(context) if context in CONTEXTS else -1,
    )


def read_axes(files: Files, calibration: str | None) -> str:
    """What a calibration file says of the axes; CARLA's where there is none or it says nothing.

    Raises:
        InputError: the file is damaged.
    """
    if calibration is None:
        return "left-handed (CARLA)"
    try:
        stated = _json(files, calibration).get("coordinates")
    except ValueError as error:
        raise refusal(files.path, f"{calibration} is damaged: {error}; mend or remove it") from error
    right = isinstance(stated, str) and stated.lower().startswith("right-handed")
    return "right-handed" if right else "left-handed (CARLA)"
