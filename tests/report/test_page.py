"""The results in Markdown: claims by figure, small tables, links to long ones."""

import pytest

from ovibjax.errors import InputError
from ovibjax.report.page import write_page
from tests.report.folders import PARTS, write_results


@pytest.fixture
def page(tmp_path):
    return write_page(write_results(tmp_path), PARTS).read_text()


def test_every_claim_stands_under_its_figure(page):
    first, second = page.split("## Figure two")
    assert first.count("| statement ") == 29 and "| rule" not in page
    assert [line.split(" | ")[0] for line in second.splitlines() if "(ours) |" in line] == ["| of the project (ours)"]
    assert "➖ says nothing here" in second and "| premise |" in second
    assert page.index("## Figure one") < page.index("## Figure two")  # by part, not by name of the part


def test_an_overview_counts_verdicts(page):
    rows = {line.split(" | ")[1]: line.split(" | ")[2:] for line in page.splitlines() if line.startswith("| Second")}
    assert rows == {"[Figure one](#figure-one)": ["8", "8", "7", "7", " |"]}
    assert "| | all | 9 | 8 | 7 | 7 | 1 |" in page


def test_cells_keep_commas_and_bars(page):
    assert "| a, b | 10 |" in page and "| c\\|d | 9 |" in page and "1 \\| 2" in page


def test_long_tables_stay_files(page):
    assert "[`one/long.csv`](one/long.csv): 100 rows" in page and "| 99 |" not in page


def test_pictures_are_linked(page):
    assert "(one/figure.png)" in page and "(extra/" not in page


def test_a_damaged_file_is_named(tmp_path):
    (write_results(tmp_path) / "one" / "claims.json").write_text('[{"statement": 1}]')
    with pytest.raises(InputError, match=r"one: not results of a figure"):
        write_page(tmp_path)
