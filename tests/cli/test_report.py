"""`ovibjax report` on a store and on a folder of results."""

import pytest

from ovibjax.sweep.engine import run
from tests.cli.cases import done_here, said_of_bad_input
from tests.report.folders import write_results


def member(key, point, shared):
    return {"cost": point["x"] ** 2, "gain": point["x"] + 1.0}


@pytest.fixture
def store(tmp_path):
    run(member, {"x": [0.5, 1.0, 2.0], "seed": [0, 1]}, units={"cost": "m"}, store=tmp_path / "mine.zarr")
    return tmp_path / "mine.zarr"


def test_a_page_about_a_sweep(store, monkeypatch, capsys):
    done_here(monkeypatch, capsys, "report", store)
    html = store.with_suffix(".html").read_text()
    assert "<h1>mine</h1>" in html and "6 members over x, seed" in html and "cost (m)" in html
    assert "environment.jax" in html and "gain" in html


def test_part_of_it_elsewhere(store, monkeypatch, capsys, tmp_path):
    out = tmp_path / "new" / "page.html"
    done_here(monkeypatch, capsys, "report", store, "--metric", "cost", "--where", "x>=1", "--out", out)
    html = out.read_text()
    assert "4 members" in html and "Without effects here: gain" in html and "x&gt;=1" in html
    assert not store.with_suffix(".html").exists()


def test_the_pages_of_a_results_folder(tmp_path, monkeypatch, capsys):
    folder = write_results(tmp_path / "results")
    done_here(monkeypatch, capsys, "report", folder)
    assert "Figure one" in (folder / "index.html").read_text() and "## Figure one" in (folder / "README.md").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--metric", "cots"], "no metric 'cots'; did you mean cost?"),
        (["--where", "y=1"], "no axis 'y'"),
        (["--over", "z"], "no swept axis 'z'"),
        (["--outt", "a.html"], "did you mean --out?"),
    ],
)
def test_bad_options_are_one_line(store, monkeypatch, capsys, options, said):
    line = said_of_bad_input(monkeypatch, capsys, "report", store, *options)
    assert said in line and len(line.splitlines()) == 1


def test_what_is_neither_is_named(tmp_path, monkeypatch, capsys):
    assert str(tmp_path / "none") in said_of_bad_input(monkeypatch, capsys, "report", tmp_path / "none")
    folder = write_results(tmp_path / "results")
    assert "are for a sweep" in said_of_bad_input(monkeypatch, capsys, "report", folder, "--metric", "x")
