"""Tables of poses with a line of names: CSV, tabs, semicolons, drawn with `|`, decimal commas; which column is what.

| column                                  | what is in it                                               |
|-----------------------------------------|-------------------------------------------------------------|
| `frame`                                 | name of the frame                                           |
| `x_m`, `y_m`, `z_m`                     | position in metres, or in degrees under `--axes lat-lon-alt`|
| `yaw_deg` or `yaw_rad`                  | heading, from x towards y                                   |
| `qw`, `qx`, `qy`, `qz`                  | instead of yaw: rotation of the body, which looks along x   |
| `time`, `time_s` or `timestamp`         | optional: frames are put in this order                      |
| `scene`, `context`                      | optional                                                    |
| `Front`, `Back`, `Left`, `Right`, `Down`| optional: name of each view's image                         |

Names of columns are taken in any case. `--columns frame=id yaw_rad=heading` says which other columns are meant.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from ovibjax.errors import InputError, refusal
from ovibjax.features.images.second_headings import SecondHeadings
from ovibjax.runtime.text_tables import (
    ContentLines,
    Rows,
    cells_of,
    is_missing,
    is_utf8,
    number_of,
    quoted,
    separator_of,
    with_points,
)
from ovibjax.views import VIEWS

POSITION = ("x_m", "y_m", "z_m")
QUATERNION = ("qx", "qy", "qz", "qw")
"""In the order of scipy."""
YAW = {"yaw_deg": math.pi / 180, "yaw_rad": 1.0}
OPTIONAL = ("scene", "context", *VIEWS)
NEEDED = "frame,x_m,y_m,z_m,yaw_deg (or yaw_rad, or qw,qx,qy,qz)"
TIMES = ("time", "time_s", "timestamp")
_KNOWN = ("frame", *POSITION, *YAW, *QUATERNION, *OPTIONAL)
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "white space"}


@dataclass(frozen=True)
class PoseOptions:
    """What the user says of a file of poses.

    Attributes:
        form: `table`, `tum`, `kitti`, `euroc`, `airsim` or `colmap`; None to find out.
        columns: `NAME=COLUMN`, which column of a table is meant by a known name.
        axes: a code of `features.images.axes`; None for what is usual for the form.
        order: the column that frames are put in order by; None for one of time, if there is any.
    """

    form: str | None = None
    columns: tuple[str, ...] = ()
    axes: str | None = None
    order: str | None = None


@dataclass
class Poses:
    """Poses as a file has them, by row.

    Attributes:
        form: what the file was taken for, for the user.
        axes: code of the axes that are usual for it.
        frame: names.
        line: where each stands.
        position: x, y, z; NaN where missing.
        yaw_rad: from x towards y; empty where there are rotations.
        quaternion: x, y, z, w of the body in the world; empty where there are angles.
        wrong: what is missing or unusable; "" for a complete pose.
        cells: optional columns.
        turn: known name of the column of angles, and its name in the file; "" where there are rotations.
    """

    form: str
    axes: str = "flu"
    frame: list[str] = field(default_factory=list)
    line: list[int] = field(default_factory=list)
    position: list[tuple[float, ...]] = field(default_factory=list)
    yaw_rad: list[float] = field(default_factory=list)
    quaternion: list[tuple[float, ...]] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    cells: list[dict[str, str]] = field(default_factory=list)
    turn: tuple[str, str] = ("", "")

    def add(
        self, line: int, frame: str, position: Sequence[float], quaternion: Sequence[float], wrong: str = ""
    ) -> None:
        """Append a pose whose rotation is a quaternion x, y, z, w."""
        self.frame.append(frame)
        self.line.append(line)
        self.position.append(tuple(position))
        self.quaternion.append(tuple(quaternion))
        self.wrong.append(wrong)
        self.cells.append({})

    def arrange(self, rows: Sequence[int]) -> None:
        """Put the poses in the order of some rows."""
        for name in ("frame", "line", "position", "yaw_rad", "quaternion", "wrong", "cells"):
            values = getattr(self, name)
            if values:
                setattr(self, name, [values[row] for row in rows])


def read_table_of_poses(path: Path, text: str, columns: Sequence[str] = (), order: str | None = None) -> Poses:
    """Poses of a table with named columns.

    Args:
        path: what to call the file.
        text: its content.
        columns: see `PoseOptions`.
        order: see `PoseOptions`.

    Returns:
        The poses; a cell that says that there is no value makes its pose incomplete.

    Raises:
        InputError: no table, a column is missing, twice there or not known, or a cell is no number.

    Warns:
        Doubt: two columns of headings that nobody chose between disagree.
    """
    first = next(iter(ContentLines(text)), "")
    separator = separator_of(first)
    lines = ContentLines(text)
    rows: Rows = ((lines.number, cells) for cells in cells_of(path, lines, separator, strict=True))
    line, names = next(rows, (0, [""]))
    where, spare = _columns(path, line, names, columns)
    second = SecondHeadings(spare)
    by_time = _order_column(path, line, names, order)
    numbers = {name: where[name] for name in (*POSITION, *YAW, *QUATERNION) if name in where}
    rows = with_points(path, rows, frozenset(numbers.values()))
    ignored = [
        name.encode(errors="replace").decode() for at, name in enumerate(names) if at not in (*where.values(), by_time)
    ]
    not_read = f", not read {', '.join(ignored)[:80]}" if ignored else ""
    read = (name if names[at].lower() == name.lower() else f"{name} from {names[at]}" for name, at in where.items())
    times: list[str] = []
    poses = Poses(f"table with {_SEPARATORS[separator]}, {', '.join(read)}{not_read}")
    poses.turn = next(((name, names[where[name]]) for name in YAW if name in where), ("", ""))
    for line, cells in rows:
        if not any(cells):
            continue
        if len(cells) != len(names):
            raise refusal(path, f"{len(cells)} values for {len(names)} columns", line)
        _take(path, line, poses, {name: cells[at] for name, at in where.items()}, list(numbers))
        if poses.yaw_rad:
            second.compare(line, poses.yaw_rad[-1], cells)
        if by_time is not None:
            times.append(cells[by_time])
    second.doubt_them(path, poses.turn[1])
    if by_time is not None:
        _arrange(path, poses, names[by_time], times, asked=order is not None)
    return poses


def _order_column(path: Path, line: int, names: Sequence[str], order: str | None) -> int | None:
    """Where the column stands that frames are put in order by."""
    for wanted in TIMES if order is None else (order,):
        found = [at for at, name in enumerate(names) if name.lower() == wanted.lower()]
        if found:
            return found[0]
    if order is not None:
        raise refusal(path, f"--order {order}: no such column; there are {', '.join(names)[:100]}", line or None)
    return None


def _arrange(path: Path, poses: Poses, column: str, times: Sequence[str], asked: bool) -> None:
    """Put poses in order of time; a column that only happens to be called so, and is no time, changes nothing."""
    found: list[float] = []
    for line, cell in zip(poses.line, times, strict=True):
        value = number_of(cell)
        if value is None:
            with suppress(ValueError):
                value = datetime.fromisoformat(cell).timestamp()
        if value is None or not math.isfinite(value):
            if asked:
                raise refusal(path, f"{column} is {quoted(cell)}, neither a number nor a date such as 2024-05-31", line)
            poses.form += f", {column} not read (in line {line} it is {quoted(cell)}, no time)"
            return
        found.append(value)
    rows = sorted(range(len(found)), key=lambda row: found[row])
    poses.arrange(rows)
    moved = sum(at != row for at, row in enumerate(rows))
    poses.form += f", in order of {column}" + (f" ({moved} moved)" if moved else "")


def _take(path: Path, line: int, poses: Poses, row: Mapping[str, str], numbers: Sequence[str]) -> None:
    """Append the pose of one row."""
    for name, cell in row.items():
        if not is_utf8(cell):
            raise refusal(path, f"{name} is not UTF-8 text; save the file as UTF-8", line)
    found = {name: _number(path, line, name, row[name]) for name in numbers}
    wrong = next((name for name, value in found.items() if not math.isfinite(value)), "")
    if wrong:
        wrong = f"{wrong} is {row[wrong]!r}" if row[wrong].lower() not in ("", "nan") else f"{wrong} is empty"
    quaternion = [found[name] for name in QUATERNION if name in found]
    if quaternion and not wrong:
        wrong = "" if abs(math.hypot(*quaternion) - 1) < 0.1 else "quaternion is not of length 1"
    poses.add(line, row["frame"], [found[name] for name in POSITION], quaternion, wrong)
    poses.yaw_rad += [found[name] * unit for name, unit in YAW.items() if name in found]
    poses.cells[-1].update({name: row[name] for name in OPTIONAL if name in row})


def _number(path: Path, line: int, column: str, cell: str) -> float:
    """A number; NaN where the cell says that there is none."""
    if is_missing(cell):
        return math.nan
    if (value := number_of(cell)) is None:
        raise refusal(path, f"{column} is {quoted(cell)}, not a number", line)
    return value


def _columns(
    path: Path, line: int, names: Sequence[str], wanted: Sequence[str]
) -> tuple[dict[str, int], dict[str, int]]:
    """Where each known column is: what `--columns` says, else its own name in any case; and headings left over."""
    asked: dict[str, str] = {}
    for item in wanted:
        name, equals, column = item.partition("=")
        if not equals or name not in _KNOWN:
            raise InputError(f"--columns {item}: write NAME=COLUMN, with a name of {', '.join(_KNOWN)}")
        asked[name] = column
    where: dict[str, int] = {}
    lower = [name.lower() for name in names]
    for name in _KNOWN:
        column = asked.get(name, name)
        found = [at for at, there in enumerate(names) if there == column]
        if not found and name not in asked:
            found = [at for at, there in enumerate(lower) if there == name.lower()]
        if len(found) > 1:
            raise refusal(path, f"column {column!r} occurs twice", line)
        if not found and name in asked:
            raise refusal(path, f"--columns {name}={column}: no such column; there are {', '.join(names)[:100]}", line)
        # A column that somebody named is that and nothing else.
        if found and (name in asked or names[found[0]] not in asked.values()):
            where[name] = found[0]
    turns = [name for name in YAW if name in where]
    if sum(name in where for name in QUATERNION) == len(QUATERNION):
        turns.append("qw")
    lacking = [name for name in ("frame", *POSITION) if name not in where]
    if lacking or not turns:
        has = ",".join(names)[:100]
        what = f"no column {lacking[0]!r}" if lacking else "no column of headings"
        example = " ".join(f"{name}=NAME" for name in [*lacking, *([] if turns else ["yaw_deg"])])
        raise refusal(
            path, f"{what}; needs {NEEDED}, has {has!r}: say which is meant, --columns {example}", line or None
        )
    # Several headings are one, as a recorder writes it; the one that somebody named, or else the plainest.
    turn = next((name for name in turns if name in asked), turns[0])
    unused = {*YAW, *QUATERNION} - (set(QUATERNION) if turn == "qw" else {turn})
    spare = {} if turn in asked else {name: at for name, at in where.items() if name in unused}
    return {name: at for name, at in where.items() if name not in unused}, spare
