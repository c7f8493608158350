"""Somebody's own images: a table or another file of poses, and a pattern that says where each image lies."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ovibjax.errors import InputError, doubt, refusal
from ovibjax.features.frames import CONTEXTS, MAX_ID_CHARS
from ovibjax.features.images.axes import Axes, axes_of
from ovibjax.features.images.folder import FolderFiles
from ovibjax.features.images.image_pattern import EXAMPLE, ImagePattern, hint_at
from ovibjax.features.images.pose_formats import name_recorded_files, read_poses
from ovibjax.features.images.pose_table import PoseOptions, Poses
from ovibjax.features.images.source import MAX_MAGNITUDE, Frame, Skipped, Source, nothing_left
from ovibjax.features.units import scale_doubt, seem_beyond_earth, seem_degrees, seem_geographic, seem_radians
from ovibjax.runtime.text_tables import read_text
from ovibjax.views import VIEWS

_MAX_TABLE_BYTES = 2**30


def read_table(
    path: Path, images: str | None, n_views: int | None, options: PoseOptions, cameras: Mapping[str, str]
) -> Source:
    """Frames of a file of poses, in its order, with the images that a pattern names.

    Args:
        path: a table with named columns or one of the forms of `pose_formats`, UTF-8.
        images: path of an image, see `ImagePattern`; None where the table names the file of every view.
        n_views: 5 or 4; by default 5 where any image of Down exists.
        options: form, columns and axes.
        cameras: what each view is called in paths.

    Returns:
        The source; yaw is measured from x towards y, in float64 as positions are.

    Raises:
        InputError: the file, the pattern or an option is bad, a frame is listed twice, axes are in doubt, or no frame
            is left.
    """
    axes = axes_of(options.axes, stated=True) if options.axes is not None else None
    pattern = ImagePattern(images, cameras) if images is not None else None
    poses = read_poses(
        path, read_text(path, _MAX_TABLE_BYTES, "table of poses", tolerant=True), options, cameras["Front"]
    )
    if not poses.frame:
        raise refusal(path, "has no poses")
    _check_frames(path, poses)
    pattern = pattern or _by_column(path, poses)
    if "file" in pattern.fields:
        name_recorded_files(path, poses, cameras)
    places = _places(path, pattern, poses)
    sizes = {image: size for place in places for image in place if (size := _size(path.parent / image)) is not None}
    n_views = n_views or (5 if any(place[4] in sizes for place in places) else 4)
    axes = axes or axes_of(poses.axes)
    motion = _motion(path, poses, axes)
    _refuse_doubts(path, poses, axes.stated, options.columns, list(motion))
    if axes.degrees is None and options.axes != "flu":
        odd = scale_doubt(np.array([place for place, _ in motion.values()]).reshape(-1, 3))
        if odd:
            doubt(path, f"{odd}; they are taken for metres")
    frames, skipped = list[Frame](), list[Skipped]()
    for row, (frame, place) in enumerate(zip(poses.frame, places, strict=True)):
        lacking = [image for image in place[:n_views] if image not in sizes]
        if lacking:
            skipped.append(Skipped(frame, "a view is missing", ", ".join(lacking)))
        elif row not in motion:
            skipped.append(Skipped(frame, "no usable pose", f"line {poses.line[row]}: {poses.wrong[row]}"))
        else:
            about, chosen = poses.cells[row], place[:n_views]
            position, yaw_rad = motion[row]
            context = _context(path, poses.line[row], about.get("context", ""))
            lengths = tuple(sizes[image] for image in chosen)
            frames.append(Frame(frame, position, yaw_rad, about.get("scene", ""), context, chosen, lengths))
    if not frames:
        first = next((image for place in places for image in place[:n_views] if image not in sizes), None)
        raise nothing_left(str(path), skipped, hint_at(path.parent, first) if first is not None else "")
    form = f"{poses.form}: {len(poses.frame)} pose{'s'[: len(poses.frame) != 1]}"
    return Source(FolderFiles(path.parent, sizes), tuple(frames), tuple(skipped), axes.describe(), form)


def _check_frames(path: Path, poses: Poses) -> None:
    """Refuse names of frames that are none, or that occur twice."""
    seen = dict[str, int]()
    for frame, line in zip(poses.frame, poses.line, strict=True):
        if not frame or not frame.isprintable() or len(frame) > MAX_ID_CHARS:
            raise refusal(path, "frame is empty, too long or not printable text", line)
        if frame in seen:
            raise refusal(path, f"frame {frame!r} is listed twice, first in line {seen[frame]}", line)
        seen[frame] = line


def _by_column(path: Path, poses: Poses) -> ImagePattern:
    """The pattern of a table that names the files."""
    if not all(view in poses.cells[0] for view in VIEWS[:4]):
        columns = "or name files in columns Front, Back, Left, Right (--columns Front=NAME ...)"
        raise refusal(path, f"say where its images lie, e.g. --images '{EXAMPLE}', {columns}")
    return ImagePattern("{file}", dict(zip(VIEWS, VIEWS, strict=True)))


def _places(path: Path, pattern: ImagePattern, poses: Poses) -> list[tuple[str, ...]]:
    """The paths of every frame's images, in the order of `VIEWS`."""
    cells = poses.cells[0]
    if "scene" in pattern.fields and "scene" not in cells:
        raise InputError(f"--images {pattern.text}: {{scene}} needs a column scene in {path.name}")
    if "file" in pattern.fields and not all(view in cells for view in VIEWS[:4]):
        lacking = next(view for view in VIEWS[:4] if view not in cells)
        needed = f"needs a column of files for each view in {path.name}: --columns {lacking}=NAME"
        raise InputError(f"--images {pattern.text}: {{file}} {needed}")
    rows = zip(poses.line, poses.frame, poses.cells, strict=True)
    return [tuple(pattern.path_of(path, line, view, frame, about) for view in VIEWS) for line, frame, about in rows]


def _motion(path: Path, poses: Poses, axes: Axes) -> dict[int, tuple[tuple[float, float, float], float]]:
    """Position and yaw of the complete poses by row; marks the others, and refuses rotations that do not fit axes."""
    position = np.array(poses.position, np.float64)
    for what, values in (("position", position), ("yaw", np.array(poses.yaw_rad).reshape(-1, 1))):
        for row in np.flatnonzero(~(np.abs(values) <= MAX_MAGNITUDE).all(axis=1)).tolist():
            poses.wrong[row] = poses.wrong[row] or f"{what} is not finite or beyond {MAX_MAGNITUDE:g}"
    rows = [row for row, wrong in enumerate(poses.wrong) if not wrong]
    if not rows:
        return {}
    if poses.yaw_rad:
        yaw_rad = axes.yaw_of_angle(np.array(poses.yaw_rad)[rows])
    else:
        turn = Rotation.from_quat(np.array(poses.quaternion)[rows])
        if not axes.stated and not axes.upright(turn):
            why = f"with axes {axes.code}, usual for this form, the bodies do not stand upright"
            raise refusal(path, f"{why}; say which way x, y and z point: --axes enu/rdf for a camera, see --help")
        yaw_rad = axes.yaw_of_rotation(turn)
    placed = axes.place(position[rows])
    return {
        row: ((float(x), float(y), float(z)), float(yaw))
        for row, (x, y, z), yaw in zip(rows, placed, yaw_rad, strict=True)
    }


def _refuse_doubts(path: Path, poses: Poses, axes_stated: bool, asked: Sequence[str], rows: list[int]) -> None:
    """Refuse numbers that can hardly be in the unit of their column, where nobody said that they are."""
    position = np.array(poses.position, np.float64)[rows].reshape(-1, 3)
    if not axes_stated and seem_geographic(position):
        why = "positions look like latitude and longitude in degrees, not metres"
        raise refusal(path, f"{why}; say --axes lat-lon-alt or lon-lat-alt, or --axes flu for metres")
    if not axes_stated and seem_beyond_earth(position):
        why = f"positions reach {np.abs(position).max():.10g}, which is no place on Earth in metres"
        settled = "divide by 1e7 and say --axes lat-lon-alt if they are degrees times 1e7, or say --axes flu for metres"
        raise refusal(path, f"{why}; {settled}")
    name, column = poses.turn
    if not name or any(item.startswith(("yaw_deg=", "yaw_rad=")) for item in asked):
        return
    yaw = np.array(poses.yaw_rad)[rows]
    if name == "yaw_deg" and seem_radians(position, np.degrees(yaw)):
        why = f"{column} looks like radians: as such it follows the route or fills a turn, as degrees it does not"
    elif name == "yaw_rad" and seem_degrees(position, yaw):
        why = f"{column} looks like degrees: it goes beyond 2 pi as the route does not"
    else:
        return
    raise refusal(path, f"{why}; say which it is, --columns yaw_rad={column} or --columns yaw_deg={column}")


def _context(path: Path, line: int, text: str) -> int:
    if text and text not in CONTEXTS:
        raise refusal(path, f"context is {text[:40]!r}, not one of {', '.join(CONTEXTS)} or empty", line)
    return CONTEXTS.index(text) if text else -1


def _size(image: Path) -> int | None:
    """Length of a regular file; None if there is none."""
    try:
        return image.stat().st_size if image.is_file() else None
    except (OSError, ValueError):
        return None
