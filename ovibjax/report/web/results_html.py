"""A results folder as one web page: claims to filter, the paper's numbers beside ours, studies to explore, figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, REPORTED, SILENT
from ovibjax.report.comparison import Pair
from ovibjax.report.sections import OTHER, Section, Table, read_sections
from ovibjax.report.web.pictures import Picture, embedded
from ovibjax.report.web.rendering import render, write
from ovibjax.report.web.studies import Study
from ovibjax.runtime.progress import progress_bar
from ovibjax.runtime.threads import in_order

NAME = "index.html"

VERDICTS = {HELD: "✓", ON_AVERAGE: "≈", NOT_HELD: "✗", REPORTED: "i", SILENT: "–"}
"""Verdicts in the order of the filters, with signs that do not need a colour."""

MOST_ROWS = 40
"""Rows up to which a table stands on the page."""

_MOST_LETTERS = 240
_TOLD_ELSEWHERE = ("title", "caption", "stages", "compile", "packages")


def write_results_page(
    folder: Path,
    parts: Mapping[str, Sequence[str]] | None = None,
    studies: Sequence[Study] = (),
    pairs: Sequence[Pair] = (),
    about: Sequence[str] = (),
) -> Path:
    """Write `index.html` in a results folder: one file that needs nothing beside it.

    Args:
        folder: results folder, see `read_sections`; pictures in folders without claims are shown at the end.
        parts: names of figures by part of the work, in the order in which they are shown.
        studies: what the reader may explore.
        pairs: the paper's numbers beside ours.
        about: paragraphs that say what this is.

    Returns:
        The page's path.

    Raises:
        InputError: a file of the folder is damaged, or the page cannot be written.
    """
    sections = list(read_sections(folder, parts))
    extras = _extras(folder)
    pictures = _embedded([*(path for section in sections for path in section.pictures), *extras])
    used = list(dict.fromkeys(section.part for section in sections))
    page = render(
        "results.html.jinja",
        scripts="charts" if studies else "filters",
        about=about,
        verdicts=VERDICTS,
        tally=_tally(sections),
        parts=used,
        other=OTHER,
        sections=[_shown(section, pictures) for section in sections],
        pairs=pairs,
        titles={section.name: section.title for section in sections},
        studies=[study.packed() for study in studies],
        extras=[_picture(path, pictures) for path in extras],
        origins=_origins(sections),
    )
    return write(folder / NAME, page)


def _tally(sections: Sequence[Section]) -> dict[str, int]:
    """Claims by verdict, and `ours` and `paper` by whose they are."""
    claims = [claim for section in sections for claim in section.claims]
    whose = Counter("ours" if claim.own else "paper" for claim in claims)
    return Counter(claim.verdict for claim in claims) | whose


def _shown(section: Section, pictures: Mapping[Path, Picture]) -> dict[str, Any]:
    """What the template shows of a section."""
    facts = section.facts
    return {
        "name": section.name,
        "part": section.part,
        "title": section.title,
        "caption": section.caption,
        "claims": section.claims,
        "pictures": [_picture(path, pictures) for path in section.pictures],
        "tables": [_table(table) for table in section.tables],
        "facts": {key: _said(value) for key, value in facts.items() if key not in _TOLD_ELSEWHERE},
        "packages": facts.get("packages", {}),
        "stages": facts.get("stages", {}),
        "compile": facts.get("compile", {}),
    }


def _embedded(paths: Sequence[Path]) -> dict[Path, Picture]:
    """All pictures of a page, packed in threads: it takes a third of a second each."""
    found: dict[Path, Picture] = {}
    with progress_bar("packing figures", len(paths), transient=True) as update:
        for path, picture in zip(paths, in_order(embedded, paths, ahead=8), strict=True):
            found[path] = picture
            update(len(found))
    return found


def _picture(path: Path, pictures: Mapping[Path, Picture]) -> tuple[str, Picture]:
    return path.stem.replace("_", " "), pictures[path]


def _extras(folder: Path) -> list[Path]:
    """Pictures of subfolders that are no figure's."""
    return sorted(path for path in folder.glob("*/*.png") if not (path.parent / "claims.json").exists())


def _table(table: Table) -> dict[str, Any]:
    """A table with which of its columns are numbers; its rows only where they are few."""
    numeric = [all(_is_numeric(row[i]) for row in table.rows if i < len(row)) for i in range(len(table.header))]
    few = len(table.rows) <= MOST_ROWS
    name = f"{table.path.parent.name}/{table.path.name}"
    return {"name": name, "header": table.header, "numeric": numeric, "count": len(table.rows), "few": few} | {
        "rows": table.rows if few else []
    }


def _is_numeric(cell: str) -> bool:
    """Whether a cell is a number, one with an interval, or empty."""
    parts = [part for part in cell.replace("±", " ").split() if part != "-"]
    try:
        return all(float(part) == float(part) for part in parts)
    except ValueError:
        return False


def _said(value: Any) -> str:
    """A fact in one or two lines: whole numbers in a row as their first and last, long lists cut."""
    text = ", ".join(f"{key} {part}" for key, part in value.items()) if isinstance(value, dict) else str(value)
    numbers = text.split()
    if len(numbers) > 2 and all(map(str.isdigit, numbers)):
        first, last = int(numbers[0]), int(numbers[-1])
        if list(map(int, numbers)) == list(range(first, last + 1)):
            return f"{first} to {last}"
    return text if len(text) <= _MOST_LETTERS else f"{text[:_MOST_LETTERS]} … (all of it in provenance.json)"


def _origins(sections: Sequence[Section]) -> dict[str, list[str]]:
    """What the figures come from, one value each where all are of one run: version, commit, preset, machine."""
    keys = ("version", "commit", "preset", "machine", "instructions", "jax", "python")
    found = {key: [str(section.facts[key]) for section in sections if section.facts.get(key)] for key in keys}
    return {key: list(dict.fromkeys(values)) for key, values in found.items() if values}
