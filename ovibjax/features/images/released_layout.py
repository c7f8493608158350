"""The layout of the released data set: images, poses and scenes of towns, in a folder or an archive.

A town is `rgb/<Camera>/<frame>.png` (or .jpg, .jpeg, .webp, .bmp), `metadata/<frame>.json` and, optionally,
`calibration/camera_calibration.json`; `depth` and `semantic` may be there and are not read. Several towns side by side
are read as several scenes.

Axes: positions and yaw stay in the axes of the data, degrees become radians. CARLA's axes are left-handed and its yaw
runs clockwise seen from above; those of the embedded town are right-handed and its yaw runs counter-clockwise. In both,
yaw is measured from x towards y, so that (cos yaw, sin yaw) is the heading and errors in metres mean the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ovibjax.errors import doubt, refusal
from ovibjax.features.frames import MAX_ID_CHARS
from ovibjax.features.images.folder import FolderFiles, list_folder
from ovibjax.features.images.metadata import Pose, read_axes, read_pose
from ovibjax.features.images.source import Files, Frame, OnStep, Skipped, Source, nothing_left
from ovibjax.features.units import scale_doubt, seem_beyond_earth, seem_geographic, seem_radians
from ovibjax.views import VIEWS

_EXPECTED = "rgb/<Camera>/<frame>.png (or .jpg) and metadata/<frame>.json"
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")
_CALIBRATION = ("calibration", "camera_calibration.json")
_STEP_FRAMES = 200


@dataclass
class _Town:
    """Names of the files of one town, by what they are."""

    cameras: dict[str, dict[str, str]] = field(default_factory=dict)  # camera, frame
    images: dict[str, dict[str, str]] = field(default_factory=dict)  # view, frame
    metadata: dict[str, str] = field(default_factory=dict)  # frame
    calibration: str | None = None


def read_towns(files: Files, n_views: int | None, cameras: Mapping[str, str], on_step: OnStep | None) -> Source:
    """Frames of the towns among some files.

    Args:
        files: of a folder or an archive.
        n_views: 5 (UAV) or 4 (UGV); by default 5 where there are images of Down.
        cameras: the camera of each view, in any case.
        on_step: progress.

    Returns:
        The source, with at least one frame.

    Raises:
        InputError: no town, a camera is missing altogether, a name is unusable, or no frame is left.

    Warns:
        Doubt: positions or headings that can hardly be in metres and degrees.
    """
    towns = _towns(files)
    for town in towns.values():
        _name_views(town, cameras)
    n_views = n_views or (5 if any("Down" in town.images for town in towns.values()) else 4)
    axes, frames, skipped = set(), list[Frame](), list[Skipped]()
    for place, town in towns.items():
        missing = [view for view in VIEWS[:n_views] if view not in town.images]
        where = f"{files.path}/{place}" if place else str(files.path)
        if missing:
            has = ", ".join(sorted(town.cameras)[:8])
            what = f"no images of {', '.join(missing)}; {n_views} views are needed, rgb/ has {has}"
            raise refusal(where, f"{what}; say which camera is which: --cameras {missing[0]}=NAME")
        if not town.metadata:
            raise refusal(where, f"no poses; expected {_EXPECTED}")
        axes.add(read_axes(files, town.calibration))
        prefix, before = f"{place}/" if len(towns) > 1 else "", len(frames)
        _read_town(files, town, prefix, n_views, frames, skipped, on_step)
        _doubt_units(where, frames[before:])
    if not frames:
        raise nothing_left(str(files.path), skipped)
    return Source(files, tuple(frames), tuple(skipped), " and ".join(sorted(axes)))


def files_of_towns(root: Path) -> FolderFiles:
    """Files of the towns in a folder, or in the folders just below it."""
    try:
        towns = [""] if (root / "rgb").is_dir() else sorted(p.name + "/" for p in root.iterdir() if p.is_dir())
        folders = []
        for town in towns:
            rgb = root / town / "rgb"
            cameras = sorted(p.name for p in rgb.iterdir() if p.is_dir()) if rgb.is_dir() else []
            folders += [f"{town}rgb/{camera}" for camera in cameras]
            folders += [f"{town}metadata", f"{town}{_CALIBRATION[0]}"]
    except OSError as error:
        raise refusal(root, f"unreadable folder ({error.strerror or error})") from error
    return FolderFiles(root, list_folder(root, folders))


def role_of(name: str) -> tuple[str, str, str, str] | None:
    """Town, kind, camera and frame of a file of the layout; None for any other."""
    folder, _, file = name.rpartition("/")
    parts = folder.split("/")
    stem, dot, suffix = file.rpartition(".")
    if file.startswith(".") or not stem:
        return None
    if parts[-2:-1] == ["rgb"] and dot + suffix.lower() in _IMAGE_SUFFIXES:
        return "/".join(parts[:-2]), "rgb", parts[-1], stem
    if parts[-1] == "metadata" and suffix.lower() == "json":
        return "/".join(parts[:-1]), "metadata", "", stem
    return ("/".join(parts[:-1]), "calibration", "", stem) if (parts[-1], file) == _CALIBRATION else None


def _towns(files: Files) -> dict[str, _Town]:
    """The files by town, camera and frame; folders without images of any camera are no towns."""
    towns: dict[str, _Town] = {}
    for name in files.sizes_bytes:
        role = role_of(name)
        if role is None:
            continue
        place, kind, camera, stem = role
        if not name.isprintable() or len(place) + len(stem) >= MAX_ID_CHARS:
            raise refusal(files.path, f"{name} has a name that is too long or not printable text; rename it")
        town = towns.setdefault(place, _Town())
        if kind == "calibration":
            town.calibration = name
            continue
        known = town.metadata if kind == "metadata" else town.cameras.setdefault(camera, {})
        if stem in known:
            raise refusal(files.path, f"frame {stem} has two images, {known[stem]} and {name}; remove one")
        known[stem] = name
    towns = {place: town for place, town in sorted(towns.items()) if town.cameras}
    if not towns:
        raise refusal(files.path, f"holds no data set; expected {_EXPECTED}")
    return towns


def _name_views(town: _Town, cameras: Mapping[str, str]) -> None:
    """Find the images of each view: of the camera of its name, or of the one that has it in other letters."""
    for view in VIEWS:
        alike = [camera for camera in town.cameras if camera.lower() == cameras[view].lower()]
        name = cameras[view] if cameras[view] in alike else alike[0] if len(alike) == 1 else None
        if name is not None:
            town.images[view] = town.cameras[name]


def _in_order(names: set[str]) -> list[str]:
    """In numeric order where every name is a number."""
    numbered = all(name.isascii() and name.isdigit() and len(name) <= 18 for name in names)
    return sorted(names, key=lambda name: (int(name) if numbered else 0, name))


def _read_town(
    files: Files,
    town: _Town,
    prefix: str,
    n_views: int,
    frames: list[Frame],
    skipped: list[Skipped],
    on_step: OnStep | None,
) -> None:
    """Add the frames of a town to the lists."""
    views = VIEWS[:n_views]
    names = _in_order({*town.metadata, *(name for view in views for name in town.images[view])})
    poses: dict[str, Pose | Skipped] = {}
    stems = {file: stem for stem, file in town.metadata.items()}
    for done, file in enumerate(files.by_place(stems), 1):
        stem = stems[file]
        try:
            poses[stem] = read_pose(files, file)
        except ValueError as error:  # InputError among them
            poses[stem] = Skipped(prefix + stem, "no usable pose", f"{file}: {error}")
        if on_step is not None and done % _STEP_FRAMES == 0:
            on_step("reading poses", done, len(stems))
    for name in names:
        lacking = [view for view in views if name not in town.images[view]]
        pose = poses.get(name, Skipped(prefix + name, "no usable pose", "no metadata"))
        if lacking:
            skipped.append(Skipped(prefix + name, "a view is missing", ", ".join(lacking)))
        elif isinstance(pose, Skipped):
            skipped.append(pose)
        else:
            images = tuple(town.images[view][name] for view in views)
            sizes = tuple(files.sizes_bytes[image] for image in images)
            scene = pose.scene or prefix.rstrip("/")
            frames.append(Frame(prefix + name, pose.position_m, pose.yaw_rad, scene, pose.context, images, sizes))


def _doubt_units(where: str, frames: Sequence[Frame]) -> None:
    """Name poses of a town that can hardly be in the units of the layout."""
    position = np.array([frame.position_m for frame in frames]).reshape(-1, 3)
    if seem_geographic(position):
        doubt(where, "positions look like latitude and longitude in degrees; they are taken for metres")
    elif seem_beyond_earth(position):
        doubt(where, "positions lie beyond any place on Earth (degrees times 1e7?); they are taken for metres")
    elif odd := scale_doubt(position):
        doubt(where, f"{odd}; they are taken for metres")
    if seem_radians(position, np.degrees([frame.yaw_rad for frame in frames])):
        doubt(
            where,
            "rotation.yaw looks like radians: as such it follows the route or fills a turn; it is taken for degrees",
        )
