"""Where the images of a table's frames lie: a path with places for view, frame, scene or a file named in the table."""

import re
import string
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PureWindowsPath

from ovibjax.errors import InputError, refusal
from ovibjax.views import VIEWS

EXAMPLE = "images/{view}/{frame}.jpg"
_FIELDS = {"view": r"(lower|upper)?", "frame": r"(0?\d{1,2}d)?", "scene": r"", "file": r""}


class ImagePattern:
    """A path pattern, relative to the table's folder unless it is absolute.

    Args:
        text: as typed; `{view}`, `{view:lower}` or `{view:upper}`, `{frame}` or `{frame:06d}`, `{scene}`, and `{file}`
            for what the table's column of the view says.
        cameras: what `{view}` stands for by view.

    Raises:
        InputError: another field, a conversion, or neither `{file}` nor both `{view}` and `{frame}`.
    """

    def __init__(self, text: str, cameras: Mapping[str, str]) -> None:
        try:
            self._parts = list(string.Formatter().parse(text))
        except ValueError as error:
            raise InputError(f"--images {text!r}: {error}; write it like {EXAMPLE}") from error
        self.text, self._cameras, self.fields = text, cameras, set[str]()
        for _, name, spec, conversion in self._parts:
            if name is None:
                continue
            if name not in _FIELDS or conversion or not re.fullmatch(_FIELDS[name], spec or ""):
                known = "only {view}, {frame}, {scene} and {file} can stand in it"
                raise InputError(f"--images {text!r}: {known}: {EXAMPLE}")
            self.fields.add(name)
        for name in ("view", "frame"):
            if name not in self.fields and "file" not in self.fields:
                raise InputError(f"--images {text!r}: {{{name}}} is missing; write it like {EXAMPLE}")
        if not text.isprintable():
            raise InputError(f"--images {text!r}: write printable text, like {EXAMPLE}")

    def path_of(self, table: Path, line: int, view: str, frame: str, cells: Mapping[str, str]) -> str:
        """The path of one image.

        Args:
            table: for messages.
            line: of the frame.
            view: one of `VIEWS`.
            frame: its name.
            cells: `scene` and the columns of views, where the table has them.

        Returns:
            The path; what the table says leads no further than where the pattern begins.

        Raises:
            InputError: the table names a file outside, or `{frame:06d}` meets a frame that is no number.
        """
        values = {"view": self._cameras[view], "frame": frame, "scene": cells.get("scene", ""), "file": cells.get(view)}
        parts = []
        for text, name, spec, _ in self._parts:
            value = values.get(name or "") or ""
            if spec == "lower":
                value = value.lower()
            elif spec == "upper":
                value = value.upper()
            elif spec:
                if not (value.isascii() and value.isdigit() and len(value) <= 18):
                    raise refusal(table, f"frame {value!r} is no number, as {{frame:{spec}}} needs", line)
                value = format(int(value), spec)
            if name in ("frame", "scene", "file") and not stays_inside(value):
                what = f"image {value!r} leads out of the table's folder"
                raise refusal(table, f"{what}; name images below it, or their folder in --images", line)
            parts += [text, value]
        return "".join(parts)


def stays_inside(path: str) -> bool:
    """Whether a path is printable, relative and without `..`, by the rules of any system."""
    pure = PureWindowsPath(path)  # knows both separators
    return path.isprintable() and not pure.anchor and ".." not in pure.parts


def cameras_of(typed: Sequence[str]) -> dict[str, str]:
    """What each view is called in somebody's data, by what `--cameras` says: `Front=cam0`.

    Raises:
        InputError: not a view, not a name, or one of either twice.
    """
    names = dict(zip(VIEWS, VIEWS, strict=True))
    given: dict[str, str] = {}
    for item in typed:
        view, _, name = item.partition("=")
        if view not in VIEWS or not name or not stays_inside(name) or view in given:
            raise InputError(f"--cameras {item}: write VIEW=NAME once for each of {' '.join(VIEWS)} that differs")
        given[view] = name
    names |= given
    taken = [name for view, name in names.items() if view in given]
    if len(set(taken)) < len(taken):
        raise InputError(f"--cameras {' '.join(typed)}: two views have one camera")
    return names


def hint_at(root: Path, image: str) -> str:
    """What may have been meant by an image that is not there: a file with nearly its name; "" if there is none."""
    path = root / image
    try:
        beside = sorted(entry.name for entry in path.parent.iterdir())
    except (OSError, ValueError):
        folder = next((parent for parent in path.parents if parent.is_dir()), root)
        try:
            folders = sorted(entry.name for entry in folder.iterdir() if entry.is_dir())
        except OSError:
            folders = []
        there = f"; {folder} has {', '.join(folders[:8])}, see --cameras" if folders else ""
        return f"there is no folder {path.parent}{there}"
    return _hint_among(path.name, beside)


def _hint_among(name: str, beside: Collection[str]) -> str:
    """A file that differs from a name in case, in how its accents are encoded, or in leading zeros."""
    stem, _, suffix = name.rpartition(".")
    for other in beside:
        if unicodedata.normalize("NFC", other) == unicodedata.normalize("NFC", name):
            return f"there is {other!r}, whose accents are encoded otherwise (NFC, NFD); rename files or frames"
        if other.lower() == name.lower():
            return f"there is {other}, in other letters"
    for other in beside:
        other_stem, _, other_suffix = other.rpartition(".")
        if other_stem == stem and other_suffix != suffix:
            return f"there is {other}"
        digits, wanted = re.search(r"\d+$", other_stem), re.search(r"\d+$", stem)
        same = digits and wanted and other_stem[: digits.start()] == stem[: wanted.start()]
        if same and digits and wanted and int(digits[0]) == int(wanted[0]):
            return f"there is {other}: write {{frame:0{len(digits[0])}d}}"
    return ""
