"""The pages of results/: parts, studies and the paper's numbers are those of the figures that are there."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from ovibjax.cards.catalog import card_names
from ovibjax.cards.paper_parts import PARTS
from ovibjax.cards.paper_points import paper_pairs, points
from ovibjax.cards.result_pages import write_result_pages
from ovibjax.cards.result_studies import TABLES, melted, result_studies
from ovibjax.report.page import write_page

RESULTS = Path(__file__).parents[2] / "results"


def test_every_figure_is_in_one_part():
    assert sorted(name for names in PARTS.values() for name in names) == card_names()


def test_every_table_that_is_there_can_be_explored():
    studies = {study.name: study for study in result_studies(RESULTS)}
    assert len(studies) > 12 and list(studies) == [
        spec.name for file, spec in TABLES.items() if (RESULTS / file).is_file()
    ]
    for name, study in studies.items():
        start = study.start
        texts = {axis["name"]: axis["texts"] for axis in study.packed()["axes"]}
        assert {start.get("x"), start.get("lines")} - {None} <= set(texts), name
        for axis, value in start.get("fixed", {}).items():
            optional = next(spec.optional for spec in TABLES.values() if spec.name == name)
            assert value in texts.get(axis, [value] if axis in optional else []), (
                f"{name}: {value} is no value of {axis}"
            )
        assert set(start.get("show", ())) <= set(texts.get(start.get("lines"), ())), name
        assert start.get("metric", next(iter(study.metrics))) in study.metrics


def test_every_point_of_the_paper_has_a_counterpart():
    pairs = {(pair.figure, pair.quantity): pair for pair in paper_pairs(RESULTS)}
    assert len(pairs) == len(list(points())) + 3 >= 90
    error = pairs["scalable_compression", "O-VIB: mean error at k = 16"]
    claims = json.loads((RESULTS / "scalable_compression" / "claims.json").read_text())
    assert any(error.ours.text() in claim["ours"] for claim in claims) and error.paper == 9.31
    assert pairs["scalable_compression", "O-VIB: payload at k = 35"].ours.mean == pytest.approx(160 / 1024)
    rule = pairs["multi_client", "MaxWeight: edge p95, most valuable tenth, high congestion"]
    tail = json.loads((RESULTS / "multi_client" / "claims.json").read_text())[0]["ours"]
    assert rule.paper == 142.4 and rule.ours.text("ms", 1) in tail  # under the ties that the claims are judged under
    stated = pairs["real_scene", "UAV, O-VIB-8: mean"].ours
    with (RESULTS / "real_scene" / "summary.csv").open() as file:
        (row,) = [r for r in csv.DictReader(file) if (r["platform"], r["representation"]) == ("UAV", "O-VIB-8")]
    assert stated.text(digits=3) == row["mean_m"]


def test_columns_of_a_kind_become_rows():
    rows = melted([{"x": "1", "voi_mean_m": "2", "random_mean_m": "3"}], "_mean_m", "policy", "mean_m")
    assert rows == [
        {"policy": "voi", "mean_m": "2", "x": "1"},
        {"policy": "random", "mean_m": "3", "x": "1"},
    ]


def test_a_folder_with_few_figures_has_a_page(tmp_path):
    for name in ("setup", "view_rate_selection"):
        shutil.copytree(RESULTS / name, tmp_path / name)
    html = write_result_pages(tmp_path).read_text()
    assert 'id="view_rate_selection"' in html and 'id="explorer"' in html and "slots with an upload: corridor" in html
    assert "## The data" in (tmp_path / "README.md").read_text()


def test_the_committed_pages_are_of_the_committed_results(tmp_path):
    html = (RESULTS / "index.html").read_text()
    assert len(html.encode()) < 3e6
    for folder in RESULTS.glob("*/claims.json"):
        claims = json.loads(folder.read_text())
        assert len(re.findall(rf'<tr id="{folder.parent.name}-\d+"', html)) == len(claims)
    shutil.copytree(RESULTS, tmp_path / "results")
    page = (RESULTS / "README.md").read_text()
    assert write_page(tmp_path / "results", PARTS).read_text() == page
