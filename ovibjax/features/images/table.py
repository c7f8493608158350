"""Somebody's own images: a CSV table of poses beside them, and a pattern that says where each image lies."""

import csv
import io
import math
import re
import string
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath

from ovibjax.errors import InputError, refusal
from ovibjax.features.frames import CONTEXTS, MAX_ID_CHARS
from ovibjax.features.images.folder import FolderFiles
from ovibjax.features.images.source import MAX_MAGNITUDE, Frame, Skipped, Source, nothing_left
from ovibjax.runtime.plain_numbers import plain_float
from ovibjax.views import VIEWS

REQUIRED = ("frame", "x_m", "y_m", "z_m", "yaw_deg")
OPTIONAL = ("scene", "context")
_MAX_TABLE_BYTES = 2**30
_EXAMPLE = "images/{view}/{frame}.jpg"


def read_table(path: Path, images: str | None, n_views: int | None) -> Source:
    """Frames of a CSV table.

    Columns `frame,x_m,y_m,z_m,yaw_deg`, optionally `scene` and `context` (corridor, intersection or repetitive);
    others are left alone. Frames keep the order of the table. Yaw is measured from x towards y.

    Args:
        path: the table, UTF-8.
        images: path of an image relative to the table's folder, with `{view}` (or `{view:lower}`), `{frame}` (or
            `{frame:06d}`) and, if need be, `{scene}`.
        n_views: 5 or 4; by default 5 where any image of Down exists.

    Returns:
        The source.

    Raises:
        InputError: the table or the pattern is bad, a value is no number, a frame is listed twice, or no frame
            is left.
    """
    if images is None:
        raise refusal(path, f"say where its images lie, e.g. --images '{_EXAMPLE}'")
    fields = _check_pattern(images)
    rows = _rows(path)
    if "scene" in fields and rows and "scene" not in rows[0][1]:
        raise InputError(f"--images {images}: {{scene}} needs a column scene in {path.name}")
    root, sizes = path.parent, dict[str, int]()
    frames, skipped, seen = list[Frame](), list[Skipped](), dict[str, int]()
    places: list[tuple[str, ...]] = []
    for line, row in rows:
        name = row["frame"]
        if name in seen:
            raise refusal(path, f"line {line}: frame {name!r} is listed twice, first in line {seen[name]}")
        seen[name] = line
        places.append(tuple(_image(path, line, images, view, row) for view in VIEWS))
    for image in {image for place in places for image in place}:
        size = _size(root / image)
        if size is not None:
            sizes[image] = size
    n_views = n_views or (5 if any(place[4] in sizes for place in places) else 4)
    for (line, row), place in zip(rows, places, strict=True):
        lacking = [image for image in place[:n_views] if image not in sizes]
        pose = [_number(path, line, key, row[key]) for key in REQUIRED[1:]]
        context = _context(path, line, row.get("context", ""))
        if lacking:
            skipped.append(Skipped(row["frame"], "a view is missing", ", ".join(lacking)))
        elif not all(abs(number) <= MAX_MAGNITUDE for number in pose):
            bad = next(key for key, number in zip(REQUIRED[1:], pose, strict=True) if not abs(number) <= MAX_MAGNITUDE)
            skipped.append(Skipped(row["frame"], "no usable pose", f"line {line}: {bad} is empty or not finite"))
        else:
            chosen = place[:n_views]
            position = (pose[0], pose[1], pose[2])
            lengths = tuple(sizes[image] for image in chosen)
            frames.append(
                Frame(row["frame"], position, math.radians(pose[3]), row.get("scene", ""), context, chosen, lengths)
            )
    if not frames:
        raise nothing_left(str(path), skipped)
    return Source(FolderFiles(root, sizes), tuple(frames), tuple(skipped), "as given, yaw from x towards y")


def _check_pattern(images: str) -> set[str]:
    """Fields of a path pattern; refused if it could lead out of the table's folder."""
    try:
        parsed = list(string.Formatter().parse(images))
    except ValueError as error:
        raise InputError(f"--images {images!r}: {error}; write it like {_EXAMPLE}") from error
    names = set()
    for _, name, spec, conversion in parsed:
        if name is None:
            continue
        allowed = {"view": r"(lower)?", "frame": r"(0?\d{1,2}d)?", "scene": r""}.get(name)
        if allowed is None or conversion or not re.fullmatch(allowed, spec or ""):
            raise InputError(f"--images {images!r}: only {{view}}, {{frame}} and {{scene}} can stand in it: {_EXAMPLE}")
        names.add(name)
    for name in ("view", "frame"):
        if name not in names:
            raise InputError(f"--images {images!r}: {{{name}}} is missing; write it like {_EXAMPLE}")
    if not _stays_inside(images):
        raise InputError(f"--images {images!r} leads out of the table's folder; name images below it")
    return names


def _stays_inside(path: str) -> bool:
    pure = PureWindowsPath(path)  # knows both separators
    return path.isprintable() and not pure.anchor and ".." not in pure.parts


def _image(path: Path, line: int, images: str, view: str, row: Mapping[str, str]) -> str:
    """The relative path of one image."""
    parts = []
    for text, name, spec, _ in string.Formatter().parse(images):
        value = view if name == "view" else row.get(name or "", "")
        if spec == "lower":
            value = value.lower()
        elif spec:
            if not (value.isascii() and value.isdigit() and len(value) <= 18):
                raise refusal(path, f"line {line}: frame {value!r} is no number, as {{frame:{spec}}} needs")
            value = format(int(value), spec)
        parts += [text, value]
    image = "".join(parts)
    if not _stays_inside(image):
        raise refusal(path, f"line {line}: image {image!r} leads out of the table's folder")
    return image


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Rows by column, with their line numbers."""
    try:
        if path.stat().st_size > _MAX_TABLE_BYTES:
            raise refusal(path, f"larger than {_MAX_TABLE_BYTES} bytes; this is no table of poses")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise refusal(path, f"is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[int, dict[str, str]]] = []
    try:
        columns = [column.strip() for column in next(reader, [])]
        for column in (*REQUIRED, *OPTIONAL):
            if columns.count(column) > 1:
                raise refusal(path, f"column {column!r} occurs twice")
            if column in REQUIRED and column not in columns:
                has = ",".join(columns)[:100]
                raise refusal(path, f"no column {column!r}; needs {','.join(REQUIRED)}, has {has!r}")
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(columns):
                raise refusal(path, f"line {reader.line_num}: {len(cells)} values for {len(columns)} columns")
            row = {c: cell.strip() for c, cell in zip(columns, cells, strict=True) if c in (*REQUIRED, *OPTIONAL)}
            if not row["frame"] or not row["frame"].isprintable() or len(row["frame"]) > MAX_ID_CHARS:
                raise refusal(path, f"line {reader.line_num}: frame is empty, too long or not printable text")
            rows.append((reader.line_num, row))
    except csv.Error as error:
        raise refusal(path, f"line {reader.line_num}: not CSV ({error})") from error
    if not rows:
        raise refusal(path, "has no rows below its header")
    return rows


def _number(path: Path, line: int, column: str, text: str) -> float:
    """A number; NaN where the cell is empty."""
    try:
        return plain_float(text or "nan")
    except ValueError:
        raise refusal(path, f"line {line}: {column} is {text[:40]!r}, not a number") from None


def _context(path: Path, line: int, text: str) -> int:
    if text and text not in CONTEXTS:
        raise refusal(path, f"line {line}: context is {text[:40]!r}, not one of {', '.join(CONTEXTS)} or empty")
    return CONTEXTS.index(text) if text else -1


def _size(image: Path) -> int | None:
    """Length of a regular file; None if there is none."""
    try:
        return image.stat().st_size if image.is_file() else None
    except (OSError, ValueError):
        return None
