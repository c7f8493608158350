"""Text tables that nobody vouches for: UTF-8 text, its lines with their numbers, cells however separated, numbers."""

import codecs
import csv
import re
from collections.abc import Collection, Iterator
from pathlib import Path

from ovibjax.errors import refusal
from ovibjax.runtime.plain_numbers import plain_float

MISSING = frozenset({"", "-", "--", "na", "n/a", "nan", "null", "none", "#n/a"})
"""What stands in a cell without a value, in lower case."""

_WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
_WITH_POINT = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")


_RULE = re.compile(r"[-+|:\s]*---[-+|:\s]*")  # between the names of a table that is drawn and its rows


def read_text(path: Path, max_bytes: int, what: str, tolerant: bool = False) -> str:
    """The content of a text file: UTF-8, its byte-order mark dropped, no NUL, of bounded size.

    Args:
        path: the file.
        max_bytes: longest accepted.
        what: what the file should be, for messages, such as `trace`.
        tolerant: leave it to the caller what bytes that are not UTF-8 mean, where they stand; see `is_utf8`.

    Returns:
        The text, with line breaks as they are in the file.

    Raises:
        InputError: no such file, unreadable, too large, binary or not UTF-8.
    """
    try:
        if not path.exists():
            raise refusal(path, "no such file")
        if not path.is_file():
            raise refusal(path, f"not a regular file; name one {what}")
        if (size := path.stat().st_size) > max_bytes:
            raise refusal(path, f"too large: {size} bytes, over {max_bytes}; this is no {what}")
        with path.open("rb") as file:
            data = file.read(max_bytes).removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror or type(error).__name__})") from error
    if (nul := data.find(b"\0")) >= 0:
        raise refusal(path, "a binary file or UTF-16 text; save it as UTF-8 text", _line_of(data, nul))
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        if tolerant:
            return data.decode(errors="surrogateescape")
        raise refusal(path, "not UTF-8 text; save it as UTF-8", _line_of(data, error.start)) from error


def is_utf8(cell: str) -> bool:
    """Whether a cell of a text that was read tolerantly was UTF-8."""
    return cell.isascii() or not any("\udc80" <= letter <= "\udcff" for letter in cell)


def _line_of(data: bytes, offset: int) -> int:
    """Number of the line that holds a byte."""
    before = data[:offset]
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


class ContentLines:
    """Lines with something in them, one by one; `number` is that of the line given last.

    Args:
        text: of the file, with line breaks of any kind.
        inline_comments: whether `#` ends a line wherever it stands, instead of at the start of a line only.
    """

    def __init__(self, text: str, inline_comments: bool = False) -> None:
        self._text, self._inline, self.number = text, inline_comments, 0

    def __iter__(self) -> Iterator[str]:
        # Not splitlines(), which knows nine more breaks, nor a list: a trace may have millions of lines.
        for number, found in enumerate(re.finditer(r"[^\r\n]*(?:\r\n|\r|\n|$)", self._text), start=1):
            line = found[0].rstrip("\r\n")
            content = line.partition("#")[0] if self._inline else line if not line.lstrip().startswith("#") else ""
            if content.strip():
                self.number = number
                yield content


def separator_of(line: str) -> str:
    """What separates the cells of a table, from its first line: `;`, a tab, `,`, `|`, or else white space (a blank)."""
    words = line.split()
    if len(words) > 1 and all(number_of(word) is not None or _WITH_COMMA.fullmatch(word) for word in words):
        return " "  # numbers between white space, decimal commas among them
    return next((mark for mark in ("|;\t," if line.strip().startswith("|") else ";\t,|") if mark in line.strip()), " ")


def cells_of(path: Path, lines: ContentLines, separator: str, strict: bool = False) -> Iterator[list[str]]:
    """Rows of cells, stripped; a quoted cell may hold the separator.

    Args:
        path: what to call the file.
        lines: those of the file; its `number` is that of the row given last.
        separator: as `separator_of` finds it.
        strict: refuse text behind a closing quote.

    Returns:
        The rows.

    Raises:
        InputError: a quote is never closed, or the like.
    """
    if separator == " ":
        yield from (line.split() for line in lines)
        return
    source = (line + "\n" for line in lines) if separator != "|" else (line for line in map(_drawn, lines) if line)
    try:
        for cells in csv.reader(source, delimiter=separator, skipinitialspace=True, strict=strict):
            if any("\n" in cell.rstrip() for cell in cells):
                raise refusal(path, "a quote is never closed, or a cell has several lines", lines.number)
            yield [cell.strip() for cell in cells]
    except csv.Error as error:
        raise refusal(path, f"not a table of cells ({error})", lines.number) from error


def _drawn(line: str) -> str:
    """A line of a table that is drawn with `|`, without what stands around its cells; "" for a rule."""
    if _RULE.fullmatch(line):
        return ""
    line = line.strip()
    return (line[1:].removesuffix("|") if line.startswith("|") else line) + "\n"


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no value: empty, `-`, `NA`, `NaN` and their like."""
    return cell.lower() in MISSING


Rows = Iterator[tuple[int, list[str]]]
"""Numbered lines with their cells."""


def with_points(path: Path, rows: Rows, columns: Collection[int] | None = None) -> Rows:
    """Rows of a table with decimal commas made points: `1,5` as `1.5`.

    Args:
        path: what to call the file.
        rows: numbered lines with their cells.
        columns: those of numbers; None for all.

    Returns:
        The rows; they must be read to their end, where a doubt may be left.

    Raises:
        InputError: points stand in other numbers, or every comma could be one of thousands.
    """
    comma, point, doubt = (0, ""), (0, ""), True
    for line, cells in rows:
        for at, cell in enumerate(cells):
            if columns is not None and at not in columns:
                continue
            if _WITH_POINT.fullmatch(cell):
                point = point if point[0] else (line, cell)
            elif _WITH_COMMA.fullmatch(cell):
                comma = comma if comma[0] else (line, cell)
                doubt = doubt and _THOUSANDS.fullmatch(cell) is not None
                cells[at] = cell.replace(",", ".")
        if comma[0] and point[0]:
            reason = (
                f"{quoted(comma[1])} here and {quoted(point[1])} in line {point[0]}: use one decimal mark, no other"
            )
            raise refusal(path, reason, comma[0])
        yield line, cells
    if comma[0] and doubt:
        reason = f"{quoted(comma[1])} may be thousands or have three decimals, as all such numbers here; write points"
        raise refusal(path, reason, comma[0])


def number_of(cell: str) -> float | None:
    """A cell as a number in plain notation, which may be infinite; None if it is none."""
    try:
        return plain_float(cell)
    except ValueError:
        return None


def quoted(cell: str) -> str:
    """A cell as it may stand in a message."""
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")
