"""The pages of a results folder: `README.md` to read beside the code, `index.html` to open, share and print."""

from pathlib import Path

from ovibjax.cards.paper_parts import ABOUT, PARTS
from ovibjax.cards.paper_points import paper_pairs
from ovibjax.cards.result_studies import result_studies
from ovibjax.report.page import write_page
from ovibjax.report.web.results_html import write_results_page


def write_result_pages(folder: Path) -> Path:
    """Write both pages of a results folder.

    Args:
        folder: results folder; each subfolder with a `claims.json` becomes a section.

    Returns:
        Path of the web page.

    Raises:
        InputError: a file of the folder is damaged, or a page cannot be written.
    """
    write_page(folder, PARTS)
    return write_results_page(folder, PARTS, list(result_studies(folder)), list(paper_pairs(folder)), ABOUT)
