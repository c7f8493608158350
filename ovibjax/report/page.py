"""The results page: every figure with its claims, the paper's numbers beside ours."""

import json
from pathlib import Path

from ovibjax.report.claims import read_claims

_MARKS = {
    "held": "✅ held",
    "held on average": "🟡 held on average",
    "not held": "❌ not held",
    "reported": "ℹ️ reported",
    "says nothing here": "➖ says nothing here",
}


def write_page(folder: Path) -> Path:
    """Write `README.md` in a results folder from what its cards left there.

    Args:
        folder: results folder; each subfolder with a `claims.json` becomes a section.

    Returns:
        The page's path.
    """
    lines = [
        "# Results",
        "",
        "Written by `ovibjax reproduce`; do not edit. Intervals are 95 % over seeds (Student's t). *Held* means that",
        "the whole interval satisfies the rule, *held on average* that only the mean does, *says nothing here* that",
        "what it presupposes is not met. Claims marked *(ours)* are this project's, not the paper's. The paper's",
        "numbers come from CARLA Town05 and a Jetson Orin NX: in another world metres do not compare, orderings do.",
        "",
    ]
    for section in sorted(path.parent for path in folder.glob("*/claims.json")):
        lines += _section(section)
    page = folder / "README.md"
    page.write_text("\n".join(lines))
    return page


def _section(folder: Path) -> list[str]:
    provenance = json.loads((folder / "provenance.json").read_text())
    name = folder.name
    lines = [f"## {provenance.get('title', name)}", "", f"![{name}]({name}/figure.png)", ""]
    if provenance.get("caption"):
        lines += [provenance["caption"], ""]
    lines += ["| claim | paper | ours | verdict |", "|---|---|---|---|"]
    for claim in read_claims(folder / "claims.json"):
        cells = (claim.text, claim.paper, claim.ours, _MARKS[claim.verdict])
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    for table in sorted(folder.glob("*.csv")):
        if table.stat().st_size < 4000:
            lines += ["", f"`{name}/{table.name}`", "", *_markdown_table(table)]
    made = ", ".join(
        f"{key} {provenance[key]}"
        for key in ("preset", "seeds", "frames", "version", "commit", "jax")
        if key in provenance
    )
    lines += [
        "",
        f"<sub>{made}; {provenance.get('seconds', '?')} s on {provenance.get('machine', '?')}</sub>",
        "",
    ]
    return lines


def _markdown_table(path: Path) -> list[str]:
    header, *rows = [line.split(",") for line in path.read_text().strip().splitlines()]
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
