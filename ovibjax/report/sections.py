"""A results folder as it is read for a page: a section per figure, with its claims, tables and provenance."""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ovibjax.errors import InputError
from ovibjax.report.claims import Claim, read_claims

OTHER = "other"
"""Part of figures that no part names, such as somebody's own."""

FIGURE = "figure.png"


@dataclass(frozen=True)
class Table:
    """A tidy table.

    Attributes:
        path: its file.
        header: names of the columns.
        rows: cells as texts.
    """

    path: Path
    header: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Section:
    """One figure of a results folder.

    Attributes:
        name: the folder's name.
        part: which part of the work it is about.
        title: heading.
        caption: what its reader needs to know.
        facts: its provenance.
        claims: its judged statements.
        pictures: its pictures, the figure first.
        tables: its tables.
    """

    name: str
    part: str
    title: str
    caption: str
    facts: Mapping[str, Any]
    claims: Sequence[Claim]
    pictures: Sequence[Path]
    tables: Sequence[Table]


def read_sections(folder: Path, parts: Mapping[str, Sequence[str]] | None = None) -> Iterator[Section]:
    """Read a results folder.

    Args:
        folder: each subfolder with a `claims.json` is a section.
        parts: names of subfolders by part; sections come in this order, others after them.

    Yields:
        The sections.

    Raises:
        InputError: a file of the folder is damaged.
    """
    part_of = {name: part for part, names in (parts or {}).items() for name in names}
    order = list(part_of)
    found = sorted(path.parent for path in folder.glob("*/claims.json"))
    for path in sorted(found, key=lambda path: order.index(path.name) if path.name in order else len(order)):
        try:
            facts = json.loads((path / "provenance.json").read_text(encoding="utf-8"))
            claims = read_claims(path / "claims.json")
            tables = [read_table(table) for table in sorted(path.glob("*.csv"))]
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"{path}: not results of a figure ({error}); make it again, or remove it") from error
        pictures = sorted(path.glob("*.png"), key=lambda picture: (picture.name != FIGURE, picture.name))
        title, caption = facts.get("title", path.name), facts.get("caption", "")
        yield Section(path.name, part_of.get(path.name, OTHER), title, caption, facts, claims, pictures, tables)


def read_table(path: Path) -> Table:
    """Read a CSV file as texts; an empty one has no columns."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = [*csv.reader(file)] or [[]]
    return Table(path, header, rows)
