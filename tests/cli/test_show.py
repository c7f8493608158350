"""`ovibjax show` and `ovibjax best` on a small store with a hole, as a user types them."""

import re
import sys
import threading
import time

import numpy as np
import pytest

from ovibjax.cli.main import main
from ovibjax.sweep.engine import run
from ovibjax.sweep.grid import make_grid
from tests.cli.cases import done_here, said_of_bad_input
from tests.sweep import stores


def member(key, point, shared):
    cost = (point["x"] - 2.0) ** 2 + point["y"] + 0.1 * point["seed"].astype(np.float32)
    return {"cost": cost, "again": -cost}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "mine.zarr"
    # All but the member of the last seed at (4, 1).
    every, others = [0.5, 1.0, 2.0, 4.0], [0.5, 1.0, 2.0]
    for x, y, seed in ((every, [0.0, 1.0], [0, 1]), (others, [0.0, 1.0], [2]), ([4.0], [0.0], [2])):
        run(member, {"x": x, "y": y, "seed": seed}, units={"cost": "m"}, store=path)
    return path


@pytest.fixture
def shown(store, monkeypatch, capsys):
    def show(*arguments, command="show"):
        return done_here(monkeypatch, capsys, command, store, *arguments)

    return show


@pytest.fixture
def refused(store, monkeypatch, capsys):
    def show(*arguments):
        said = said_of_bad_input(monkeypatch, capsys, "show", store, *arguments).splitlines()
        assert len(said) == 1 and said[0].startswith("ovibjax: ")
        return said[0]

    return show


def rows(table):
    """Rows of a printed table, which begin with two numbers."""
    return [line.split() for line in table.splitlines() if re.match(r"\s*[\d.]+\s+[-\d.]+\s", line)]


def test_a_file_has_whole_headings(tmp_path, monkeypatch, capsys):
    long = "error_of_the_route_after_the_last_correction_m"
    axes = {"weight_of_the_orthogonality_penalty": [0.0, 1.0], "seed": [0, 1]}

    def many(key, point, shared):
        return {f"{long}_{i}": point["weight_of_the_orthogonality_penalty"] + i for i in range(4)}

    run(many, axes, store=tmp_path / "wide.zarr")
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setattr(sys, "argv", ["ovibjax", "show", str(tmp_path / "wide.zarr")])
    main()
    heading = next(line for line in capsys.readouterr().out.splitlines() if "penalty" in line)
    assert all(f"{long}_{i}" in heading for i in range(4)) and "…" not in heading


def test_a_hole_is_shown_as_one(shown):
    table = rows(shown("--metric", "cost"))
    assert len(table) == 8 and table[0][:5] == ["0.5", "0", "2.35", "±", "0.25"]
    assert " ".join(table[-1][5:]) == "2 of 3 seeds: 1 unfinished"


def test_filters_sorts_and_the_first_rows(shown):
    kept = rows(shown("--metric", "cost", "--where", "x>=1", "x!=2", "seed=0,1", "y=1"))
    assert [row[0] for row in kept] == ["1", "4"]
    first = rows(shown("--metric", "cost", "--top", "3"))
    assert [row[:2] for row in first] == [["2", "0"], ["1", "0"], ["2", "1"]]
    last = rows(shown("--sort", "y", "--descending", "--top", "4"))
    assert [row[:2] for row in last] == [["0.5", "1"], ["1", "1"], ["2", "1"], ["4", "1"]]
    assert len(rows(shown("--metric", "cost", "--over", "seed", "y"))) == 4


def test_files_and_pictures(shown, tmp_path):
    shown("--csv", tmp_path / "mine.csv", "--metric", "cost", "--plot", "x", "y", "--out", tmp_path / "map.png")
    assert len((tmp_path / "mine.csv").read_text().splitlines()) == 1 + 23
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    pytest.importorskip("pyarrow")
    shown("--parquet", tmp_path / "a" / "mine.parquet")
    assert (tmp_path / "a" / "mine.parquet").read_bytes().startswith(b"PAR1")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--where", "x>=9"), "--where x>=9: no value of x is; it has 0.5, 1, 2, 4"),
        (("--where", "z=1"), "no axis 'z'"),
        (("--sort", "cots"), "no metric or axis 'cots'; did you mean cost?"),
        (("--top", "0"), "--top 0 is not positive"),
        (("--top", "2"), "--top 2: say by what with --sort"),
        (("--top", "2", "--csv", "x.csv"), "--top is for the table, and --csv shows every member"),
        (("--over", "sede"), "no swept axis 'sede'; did you mean seed?"),
        (("--watch", "soon"), "--watch soon: give one positive number of seconds"),
        (("--watch", "-1"), "--watch -1: give one positive number of seconds"),
        (("--watch", "--plot", "x"), "--watch draws the table, and --plot a file once"),
        (("--plot",), "--plot : give one axis for lines, or two for a heat map"),
        (("--plot", "x", "y", "seed"), "--plot x y seed: give one axis"),
        (("--plot", "x", "y", "--hue", "seed", "--metric", "cost"), "--hue seed: a heat map of x and y has no lines"),
        (("--hue", "x"), "--hue x: it is for --plot"),
        (("--out", "x.png"), "--out x.png: it is for --plot"),
        (("--wach",), "did you mean --watch?"),
    ],
)
def test_bad_input_is_one_line(refused, arguments, named):
    assert named in refused(*arguments)


def test_help_teaches(shown):
    said = " ".join(shown("--help").split())
    for taught in ("'beta>=1e-3' --top 5", "--plot gamma --hue beta", "heat map", "[SECONDS]", "extra [parquet]"):
        assert taught in said


def test_watching_waits_for_a_store_and_ends_with_it(tmp_path, monkeypatch, capsys):
    path = tmp_path / "runs" / "new.zarr"

    def compute():
        time.sleep(0.3)
        with stores.opened(path) as kept:
            kept.announce(make_grid(stores.AXES))
            for member in range(18):
                kept.add(stores.make_rows([member]))
                time.sleep(0.02)

    running = threading.Thread(target=compute)
    running.start()
    said = done_here(monkeypatch, capsys, "show", path, "--watch", "0.05", "--metric", "error")
    running.join()
    assert f"{path}: 18 of 18 members finished, 6 diverged" in said and "error (m)" in said


def test_best_says_how_sure_it_is(shown):
    said = shown("--minimise", "cost", command="best")
    assert "x = 2, y = 0" in said and "best of 8 points that keep the bounds, of 8; means over seed" in said
    # The points differ by the same amount at every seed.
    assert "runner-up with x = 1: higher by 1 ± " in said and "m over 3 common seeds\n" in said
    assert "0 of 7 other points cannot be told apart from the best" in said
    assert "(the sweep was made from Python by tests.cli.test_show.member; no command reruns it)" in said
    said = shown("--minimise", "cost", "--where", "seed=1", command="best")
    assert "higher by 1 m; one seed each, so that nothing tells how sure that is" in said
    said = shown("--minimise", "cost", "--where", "x=4", "y=1", command="best")
    assert "means over seed (2 of 3 seeds: 1 unfinished)" in said and "runner-up" not in said


def test_best_among_equals(tmp_path, monkeypatch, capsys):
    noise = np.array([[0.3, -0.2, 0.4], [0.0, 0.0, 0.0]], np.float32)
    path = tmp_path / "mine.zarr"
    axes = {"x": [0.0, 1.0], "seed": [0, 1, 2]}
    run(lambda key, point, data: {"y": data[point["x"].astype(int), point["seed"]]}, axes, noise, store=path)
    said = done_here(monkeypatch, capsys, "best", path, "--minimise", "y")
    assert "runner-up with x = 0: higher by 0.17 ± 0.8 over 3 common seeds: the two cannot be told apart" in said
