"""The data of the cards: somebody's feature sets, checked, or the embedded town or room instead."""

from collections.abc import Sequence
from pathlib import Path

from ovibjax.errors import InputError, StrPath
from ovibjax.features.feature_files import load
from ovibjax.features.frames import FeatureSet
from ovibjax.features.splits import MIN_QUERIES, MIN_REFERENCES, require_frames
from ovibjax.runtime.progress import console, progress_bar
from ovibjax.world.rooms.feature_set import room_features
from ovibjax.world.rooms.room import platform_room
from ovibjax.world.town.feature_set import PAPER_FRAMES, town_features
from ovibjax.world.town.layout import TownConfig

_SMOKE_FRAMES = 400


def load_features(data: StrPath | None = None, preset: str = "full") -> FeatureSet:
    """The data of a run: somebody's feature set, or the embedded town.

    Args:
        data: a feature set (`.npz` or folder), or None for the embedded town.
        preset: the smoke preset takes a short drive.

    Returns:
        The feature set.

    Raises:
        InputError: unreadable data, or fewer than 200 frames.
    """
    if data is not None:
        path = Path(data)
        with progress_bar(f"reading {path.name}", 1) as update:
            features = load(path, on_frame=lambda done, total: update(done // total))
        require_frames(features, source=str(path))
        return features
    frames = _SMOKE_FRAMES if preset == "smoke" else PAPER_FRAMES
    with progress_bar(f"rendering {frames} frames x 5 views", frames) as update:
        return town_features(TownConfig(), frames, on_frames=lambda done, _: update(done))


def load_pair(data: Sequence[Path], seed: int) -> tuple[FeatureSet, FeatureSet | None]:
    """References and queries of somebody, or the references of the first embedded room.

    Args:
        data: two feature sets, or none.
        seed: the embedded room.

    Returns:
        References, and queries (None for embedded data).

    Raises:
        InputError: unreadable data, too few frames, or two sets that do not match.
    """
    if not data:
        with console.status("rendering a room"):
            return room_features(platform_room("uav", seed))[0], None
    references, queries = (load(path) for path in data)
    require_frames(references, MIN_REFERENCES, str(data[0]))
    require_frames(queries, MIN_QUERIES, str(data[1]))
    if references.features.shape[1:] != queries.features.shape[1:]:
        (m, d), (views, dim) = references.features.shape[1:], queries.features.shape[1:]
        raise InputError(f"{data[1]}: queries have {views} views of dimension {dim}, the references {m} of {d}")
    return references, queries
