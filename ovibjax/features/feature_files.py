"""Feature sets on disk: one `.npz` file, or the folder layout that the paper's authors publish."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import StrPath, doubt, refusal, unreadable
from ovibjax.features.frames import FeatureSet, OnFrames, make_feature_set, validate
from ovibjax.features.npz import read_npz, write_npz
from ovibjax.features.places import coarse_m
from ovibjax.features.units import scale_doubt, seem_beyond_earth, seem_degrees, seem_geographic
from ovibjax.views import VIEWS

POSITION_TOLERANCE_M = 1e-3
"""Largest difference, per coordinate, between the positions that two cameras report for one frame."""


def save(path: StrPath, feature_set: FeatureSet) -> None:
    """Write a feature set to an `.npz` file, whole or not at all.

    Args:
        path: the file to write or replace; its folder must exist.
        feature_set: checked before anything is written.

    Raises:
        InputError: the set is not valid, or the file cannot be written.
    """
    write_npz(path, validate(feature_set, str(path))._asdict())


def load(path: StrPath, on_frame: OnFrames | None = None) -> FeatureSet:
    """Read a feature set from an `.npz` file or from a folder in the layout of the paper's authors.

    Args:
        path: an archive with `features`, `positions_m` and, optionally, the other fields of `FeatureSet`; or
            a folder `view_features/<Camera>/<frame>.npz` (see `read_view_folder`).
        on_frame: called with (frames read, frames in all) while a folder is read.

    Returns:
        The checked set. A folder gives no yaw, context or scene: they take their defaults.

    Raises:
        InputError: the file or folder is missing, corrupt or not valid; the message names it and the reason.

    Warns:
        Doubt: positions or headings that can hardly be in metres and radians.
    """
    try:
        is_folder = Path(path).is_dir()
    except OSError as error:
        raise refusal(path, f"unreadable path ({error.strerror})") from error
    if is_folder:
        arrays = read_view_folder(path, on_frame)
    else:
        arrays = read_npz(path, FeatureSet._fields[:2], FeatureSet._fields[2:])
    made = make_feature_set(**arrays, source=str(path))
    if seem_geographic(made.positions_m):
        doubt(path, "positions_m look like latitude and longitude in degrees; they are taken for metres")
    elif seem_beyond_earth(made.positions_m):
        doubt(path, "positions_m lie beyond any place on Earth (degrees times 1e7?); they are taken for metres")
    elif odd := scale_doubt(made.positions_m):
        doubt(path, f"positions_m: {odd}; they are taken for metres")
    if seem_degrees(made.positions_m, made.yaw_rad.astype(np.float64)):
        doubt(path, "yaw_rad looks like degrees: it goes beyond 2 pi as the route does not; it is taken for radians")
    return made


def read_view_folder(path: StrPath, on_frame: OnFrames | None = None) -> dict[str, NDArray[Any]]:
    """Read the layout that the paper's authors publish: `view_features/<Camera>/<frame>.npz`.

    Each file holds `feature` ([d] or [1, d]) and `position` ([3], or [2] for z = 0, in metres). A UGV has no
    folder `Down`.

    Args:
        path: the folder `view_features`, or the one that contains it.
        on_frame: progress.

    Returns:
        `features` [N, M, d] float32 as stored, `positions_m` [N, 3] float64 and `frame_id` [N] text.

    Raises:
        InputError: a view folder is missing, a file is bad, or files disagree on frames, size or position.

    Warns:
        Doubt: positions in a type that steps by more than a millimetre where they lie.
    """
    root = Path(path)
    try:
        root = root / "view_features" if (root / "view_features").is_dir() else root
        cameras = VIEWS if (root / "Down").is_dir() else VIEWS[:4]
        for camera in cameras:
            if not (root / camera).is_dir():
                raise refusal(root, f"missing view folder {camera!r}; it needs {', '.join(cameras)}")
        frames = {camera: _frame_names(root / camera) for camera in cameras}
    except OSError as error:
        raise unreadable(root, "unreadable folder", error) from error
    names = frames[cameras[0]]
    for camera in cameras[1:]:
        if differing := sorted(set(names) ^ set(frames[camera])):
            has, lacks = (cameras[0], camera) if differing[0] in names else (camera, cameras[0])
            raise refusal(root, f"frame {differing[0]!r} is in {has} but not in {lacks}; add or remove it")
    if not names:
        raise refusal(root / cameras[0], "no frames: the folder holds no .npz file")
    features: list[NDArray[Any]] = []
    positions_m: list[NDArray[Any]] = []
    coarsest_m = 0.0
    for name in names:
        with np.errstate(all="ignore"):  # overflow becomes infinity, refused by the feature set's own checks
            views, place, step_m = _read_frame(root, cameras, name)
        coarsest_m = max(coarsest_m, step_m)
        if features and views.shape != features[0].shape:
            reason = f"dimension {views.shape[1]}, that of frame {names[0]} has {features[0].shape[1]}"
            raise refusal(root / cameras[0] / f"{name}.npz", f"feature has {reason}")
        features.append(views)
        positions_m.append(place)
        if on_frame is not None:
            on_frame(len(features), len(names))
    if coarsest_m:
        doubt(root, f"position has a type that steps by {coarsest_m:.2g} m where it lies; save it as float64")
    return {"features": np.stack(features), "positions_m": np.stack(positions_m), "frame_id": np.array(names)}


def _vector(array: NDArray[Any], path: Path, key: str) -> NDArray[Any]:
    """The array of one frame file as a finite vector."""
    vector = array[0] if array.ndim == 2 and array.shape[0] == 1 else array
    if vector.ndim != 1 or vector.dtype.kind not in "iuf":
        have = f"shape {array.shape} and dtype {array.dtype}"
        raise refusal(path, f"array {key!r} has {have}, expected a vector of numbers")
    if not np.isfinite(vector).all():
        raise refusal(path, f"array {key!r} has values that are not finite (NaN or infinity)")
    return vector


def _frame_names(folder: Path) -> list[str]:
    """Frames of one camera, in numeric order when every name is a number."""
    names = []
    for entry in folder.iterdir():
        # Hidden files are the droppings of other systems (.DS_Store, ._000001.npz).
        if entry.suffix != ".npz" or entry.name.startswith("."):
            continue
        if not entry.stem.isprintable():
            raise refusal(entry, "file name has characters that are not printable text; rename the frame")
        names.append(entry.stem)
    numbered = all(name.isascii() and name.isdigit() for name in names)
    return sorted(names, key=lambda name: (int(name) if numbered else 0, name))


def _read_frame(root: Path, cameras: tuple[str, ...], name: str) -> tuple[NDArray[Any], NDArray[Any], float]:
    """Features [M, d] and position [3] in metres of one frame, and what its type may have lost of the latter."""
    step_m = 0.0
    views: list[NDArray[Any]] = []
    places: list[NDArray[Any]] = []
    for camera in cameras:
        file = root / camera / f"{name}.npz"
        arrays = read_npz(file, ("feature", "position"))
        stored = _vector(arrays["position"], file, "position")
        step_m, place = max(step_m, coarse_m(stored)), stored.astype(np.float64)
        if place.size not in (2, 3):
            raise refusal(file, f"position has {place.size} coordinates, expected x, y, z or x, y")
        places.append(np.pad(place, (0, 3 - place.size)))
        if (np.abs(places[-1] - places[0]) > POSITION_TOLERANCE_M).any():
            raise refusal(file, f"position differs by more than 1 mm from that of {cameras[0]}/{file.name}")
        views.append(_vector(arrays["feature"], file, "feature").astype(np.float32))
        if views[-1].size != views[0].size:
            reason = f"dimension {views[-1].size}, that of {cameras[0]}/{file.name} has {views[0].size}"
            raise refusal(file, f"feature has {reason}")
    return np.stack(views), places[0], step_m
