"""Recurring panels: what stands where, in data coordinates."""

import numpy as np
import pytest

from ovibjax.report import panels
from ovibjax.report.claims import Interval
from ovibjax.report.figures import BLUE, ORANGE, band, spread
from ovibjax.report.figures import panels as grid


@pytest.fixture
def ax():
    return grid(1)[1][0]


def test_a_sheet_is_written_when_the_block_ends(tmp_path) -> None:
    path = tmp_path / "figure.png"
    with panels.sheet(path, 2, 2) as axes:
        assert len(axes) == 4 and not path.exists()
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_panels_are_titled_in_reading_order(tmp_path) -> None:
    drawn = {}

    def panel(name):
        return lambda ax, found: drawn.setdefault(name, (ax, found))

    panels.draw_panels(tmp_path / "figure.png", 7, {name: panel(name) for name in ("one", "two", "three")}, columns=2)
    assert {name: found for name, (_, found) in drawn.items()} == {"one": 7, "two": 7, "three": 7}
    titles = [ax.get_title(loc="left") for ax, _ in drawn.values()]
    assert [title.split()[-1] for title in titles] == ["one", "two", "three"]
    assert ["(a" in titles[0].replace("{", ""), "(c" in titles[2].replace("{", "")] == [True, True]


def test_bars_stand_from_the_top_with_caps_ticks_and_texts(ax) -> None:
    rows = [
        panels.Bar("a", Interval(2.0, 0.5), BLUE, paper=3.0, text="2.0"),
        panels.Bar("b", Interval(1.0, np.inf), BLUE),
    ]
    panels.bars(ax, rows)
    assert [bar.get_width() for bar in ax.patches] == [2.0, 1.0]
    assert ax.yaxis_inverted() and [label.get_text() for label in ax.get_yticklabels()] == ["a", "b"]
    assert ax.texts[0].xy == (3.0, 0), "to the right of the paper's tick"
    assert len(ax.collections) == 1, "no cap where there is no interval"
    assert ax.get_legend_handles_labels()[1] == ["paper"]


def test_columns_stand_side_by_side(ax) -> None:
    values = [Interval(1.0, 0.1), Interval(2.0, 0.1)]
    places = panels.columns(ax, ["x", "y"], [("one", BLUE, values), ("two", ORANGE, values)])
    assert places.shape == (2, 2)
    np.testing.assert_allclose(places.mean(axis=0), [0, 1])
    assert len(ax.patches) == 4 and ax.get_legend_handles_labels()[1] == ["one", "two"]


def test_a_heat_map_writes_white_on_dark(ax) -> None:
    panels.heat(ax, np.array([[0.0, 1.0]]), [["low", "high"]], "Blues", (0.0, 1.0))
    assert [text.get_color() for text in ax.texts] == ["black", "white"]


def test_a_distribution_stays_between_nothing_and_all(ax) -> None:
    shares = np.array([[0.0, 0.5, 1.0], [0.1, 0.9, 1.0]] * 2)
    panels.distribution(ax, np.arange(3.0), shares, BLUE, "d")
    low, high = ax.collections[0].get_paths()[0].get_extents().intervaly
    assert (low, high) == (0.0, 1.0)
    panels.headroom(ax, 2.0)
    assert ax.get_ylim()[1] > 2.0


def test_few_seeds_are_thin_lines_and_many_a_band(ax) -> None:
    x, curves = np.arange(3.0), np.array([[1.0, 2.0, 3.0], [1.5, 2.5, 3.5], [1.0, 2.0, 4.0]])
    band(ax, x, curves, BLUE, "three")
    assert len(ax.collections) == 0 and len(ax.lines) == 4
    assert [line.get_label() for line in ax.lines].count("three") == 1
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), curves[1])
    assert spread(3).startswith("Thin lines are the 3 seeds")
    band(ax, x, np.vstack([curves, curves[:1]]), BLUE, "four")
    assert len(ax.collections) == 1 and len(ax.lines) == 5
    assert spread(4, "trials") == "Bands and caps are 95 % intervals over 4 trials"
