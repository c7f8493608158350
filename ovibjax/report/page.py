"""The results page in Markdown, to be read beside the code: figures, claims and small tables, the paper's beside ours.

Long tables stay CSV; `web` writes the page on which they can be explored.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, REPORTED, SILENT
from ovibjax.report.sections import Section, Table, read_sections

MOST_ROWS = 20
"""Rows up to which a table stands on the page."""

MARKS = {
    HELD: "✅ held",
    ON_AVERAGE: "🟡 held on average",
    NOT_HELD: "❌ not held",
    REPORTED: "ℹ️ reported",
    SILENT: "➖ says nothing here",
}


def write_page(folder: Path, parts: Mapping[str, Sequence[str]] | None = None) -> Path:
    """Write `README.md` in a results folder from what its cards left there.

    Args:
        folder: results folder; each subfolder with a `claims.json` becomes a section.
        parts: names of subfolders by part of the work, in the order in which they are shown.

    Returns:
        The page's path.

    Raises:
        InputError: a file of the folder is damaged, or the page cannot be written.
    """
    sections = list(read_sections(folder, parts))
    lines = [
        "# Results",
        "",
        "Written by `ovibjax reproduce`; do not edit. [index.html](index.html) is the same to explore: one file, to be",
        "downloaded and opened. Intervals are 95 % over seeds (Student's t). *Held* means that the whole interval",
        "satisfies the rule, *held on average* that only the mean does, *says nothing here* that what it presupposes",
        "is not met. Claims marked *(ours)* are this project's, not the paper's. The paper's numbers come from CARLA",
        "Town05 and a Jetson Orin NX: in another world metres do not compare, orderings do.",
        "",
        *_overview(sections),
    ]
    for section in sections:
        lines += _section(section)
    page = folder / "README.md"
    try:
        page.write_text("\n".join(lines), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{page}: cannot write there ({error.strerror}); choose another folder") from error
    return page


def _overview(sections: Sequence[Section]) -> list[str]:
    """Claims by figure and verdict."""
    lines = ["| part | figure | " + " | ".join(MARKS.values()) + " |", "|---|---|" + "---|" * len(MARKS)]
    for section in sections:
        tally = Counter(claim.verdict for claim in section.claims)
        counts = " | ".join(str(tally[verdict] or "") for verdict in MARKS)
        lines.append(f"| {section.part} | [{section.title}](#{_anchor(section.title)}) | {counts} |")
    total = Counter(claim.verdict for section in sections for claim in section.claims)
    return [*lines, "| | all | " + " | ".join(str(total[verdict]) for verdict in MARKS) + " |", ""]


def _anchor(title: str) -> str:
    """Address of a heading as forges make it."""
    return "".join("-" if c == " " else c for c in title.lower() if c.isalnum() or c in " -_")


def _section(section: Section) -> list[str]:
    name, facts = section.name, section.facts
    lines = [f"## {section.title}", ""]
    for picture in section.pictures:
        lines += [f"![{section.title}: {picture.stem}]({name}/{picture.name})", ""]
    if section.caption:
        lines += [section.caption, ""]
    lines += ["| claim | paper | ours | verdict |", "|---|---|---|---|"]
    lines += [_row((claim.text, claim.paper, claim.ours, MARKS[claim.verdict])) for claim in section.claims]
    for table in section.tables:
        lines += ["", *_table(name, table)]
    keys = ("preset", "seeds", "frames", "version", "commit", "jax")
    made = ", ".join(f"{key} {facts[key]}" for key in keys if key in facts)
    lines += ["", f"<sub>{made}; {facts.get('seconds', '?')} s on {facts.get('machine', '?')}</sub>", ""]
    return lines


def _table(folder: str, table: Table) -> list[str]:
    """A small table, or where a long one is."""
    name = f"[`{folder}/{table.path.name}`]({folder}/{table.path.name})"
    if len(table.rows) > MOST_ROWS or not table.rows:
        return [f"{name}: {len(table.rows):,} rows"]
    return [name, "", _row(table.header), "|" + "---|" * len(table.header), *map(_row, table.rows)]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
