"""Numbers in the README and the findings, written from `results/`: `python -m tests.documents` writes both anew.

Templates are in `docs/templates/`. `said` quotes the numbers of a claim in their order, `over_seeds` takes the mean of
a column of a card's table over its seeds, with the 95 % interval; both round to the digits that are asked for.
"""

import csv
import json
import re
import textwrap
from collections import Counter
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ovibjax.report.claims import HELD, NOT_HELD, ON_AVERAGE, interval
from ovibjax.report.page import MARKS

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
WRITTEN = {"README.md": ROOT / "README.md", "findings.md": ROOT / "docs" / "findings.md"}
NUMBER = re.compile(r"(?<![\w.])(-?\d+(?:,\d{3})*(?:\.\d+)?)(?: ± (\d+(?:\.\d+)?))?")


def claims(card: str) -> list[dict]:
    """The claims of a card."""
    return json.loads((RESULTS / card / "claims.json").read_text())


def claim(card: str, start: str) -> dict:
    """The one claim of a card with this statement, or else the one whose statement begins so."""
    every = claims(card)
    found = [one for one in every if one["statement"] == start]
    found = found or [one for one in every if one["statement"].startswith(start)]
    if len(found) != 1:
        raise LookupError(f"{card}: {len(found)} claims begin with {start!r}")
    return found[0]


def said(card: str, start: str, place: int = 0, digits: int | None = None, spread: bool = True) -> str:
    """A number of a claim, the one at `place`; without its interval if that is asked for."""
    mean, half = NUMBER.findall(claim(card, start)["ours"])[place]
    if digits is not None:
        mean = f"{float(mean.replace(',', '')):.{digits}f}"
        half = half and f"{float(half):.{digits}f}"
    return f"{mean} ± {half}" if half and spread else mean


def ours(card: str, start: str) -> str:
    """A claim's own text."""
    return claim(card, start)["ours"]


def sign(card: str, start: str) -> str:
    """What came of a claim."""
    return MARKS[claim(card, start)["verdict"]]


def rows(card: str, table: str = "table.csv", **where: object) -> list[dict[str, str]]:
    """Rows of a card's table in which these columns have these values."""
    with (RESULTS / card / table).open(newline="") as file:
        found = [row for row in csv.DictReader(file) if all(row[name] == str(value) for name, value in where.items())]
    if not found:
        raise LookupError(f"{card}/{table}: no row has {where}")
    return found


def over_seeds(card: str, column: str, digits: int = 1, spread: bool = True, **where: object) -> str:
    """Mean of a column over the seeds of a table, and its interval."""
    found = rows(card, **where)
    if len({row["seed"] for row in found}) != len(found):
        raise LookupError(f"{card}: several rows a seed have {where}")
    made = interval([float(row[column]) for row in found])
    return made.text(digits=digits) if spread else f"{made.mean:.{digits}f}"


def made(card: str) -> bool:
    """Whether `results/` has a card; what is said of a new one comes with its first full run."""
    return (RESULTS / card / "claims.json").exists()


def counted() -> Counter:
    """How many of the paper's claims came to which verdict, and of ours under `(ours)`."""
    every = [one for path in sorted(RESULTS.glob("*/claims.json")) for one in json.loads(path.read_text())]
    return Counter(one["verdict"] + (" (ours)" if one["own"] else "") for one in every)


def tried() -> int:
    """How many claims of the paper were judged."""
    return sum(counted()[verdict] for verdict in (HELD, ON_AVERAGE, NOT_HELD))


def written() -> dict[Path, str]:
    """Every document as it follows from its template and `results/`."""
    # Nothing of these is shown by a browser as it stands, and Markdown has no escapes of HTML.
    environment = Environment(
        loader=FileSystemLoader(ROOT / "docs" / "templates"), undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.globals |= {"said": said, "ours": ours, "sign": sign, "over_seeds": over_seeds, "made": made}
    environment.globals |= {"counted": counted(), "paper_claims": tried()}
    return {path: filled(environment.get_template(name).render()) for name, path in WRITTEN.items()}


def filled(text: str) -> str:
    """A text whose paragraphs are broken anew, as numbers have lengths of their own; code, tables and pictures stay."""
    parts = text.split("\n\n")
    for i, part in enumerate(parts):
        coded = "\n\n".join(parts[:i]).count("```") % 2 or "```" in part
        if not coded and not re.match(r"[#|!\[<]", part):
            end = "\n" * part.endswith("\n")
            parts[i] = textwrap.fill(" ".join(part.split()), 118, break_long_words=False, break_on_hyphens=False) + end
    return "\n\n".join(parts)


if __name__ == "__main__":
    for path, text in written().items():
        path.write_text(text)
        print(path.relative_to(ROOT))
