"""A table of a running sweep: what it says on the way, and when it ends."""

import io

import pytest
from rich.console import Console

from ovibjax.report import live
from ovibjax.report.live import Look, progress, recent, watch
from ovibjax.report.show import table
from tests.report.cases import made_results


class Clock:
    """Time that passes where somebody sleeps."""

    def __init__(self) -> None:
        self.now_s, self.slept = 0.0, []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(live, "time", clock)
    return clock


def watched(clock: Clock, states: list, every_s: float = 2.0) -> tuple[str, list]:
    """What the screen holds in the end, and what was drawn on the way."""
    console, drawn, left = Console(file=io.StringIO(), width=120, height=30), [], list(states)

    def read():
        clock.now_s += 1.0
        state = left.pop(0)
        if isinstance(state, BaseException):
            raise state
        return state

    def draw(dataset, rows):
        drawn.append((int(dataset["finished"].sum()), rows))
        return table(dataset, "latency", max_rows=rows or 40)

    watch(read, draw, "mine.zarr", every_s, console, clock.sleep)
    return console.file.getvalue(), drawn


def results(finished: int):
    """The first members of the results, in the order of the grid."""
    data = made_results()
    data["finished"][:] = False
    data["finished"].values.reshape(-1)[:finished] = True
    return data


def test_a_table_is_drawn_until_all_is_finished(clock) -> None:
    said, drawn = watched(clock, [None, None, results(10), results(30), results(60)], every_s=8.0)
    assert drawn == [(10, 18), (30, 18), (60, None)]
    assert clock.slept == [8.0] * 4, "a look takes a second, and there is a pause of eight"
    assert "mine.zarr: 60 of 60 members finished, 6 diverged" in said and "latency (ms)" in said


def test_a_store_that_takes_long_to_read_is_read_more_seldom(clock) -> None:
    watched(clock, [results(10), results(60)], every_s=0.1)
    assert clock.slept == [pytest.approx(4.0)]


def test_ctrl_c_leaves_the_table_on_the_screen(clock) -> None:
    said, drawn = watched(clock, [results(10), results(30), KeyboardInterrupt()])
    assert len(drawn) == 2 and "30 of 60 members finished; 4 a second, 8 s to go" in " ".join(said.split())
    said, drawn = watched(clock, [None, KeyboardInterrupt()])
    assert not drawn and "mine.zarr is not there yet; waiting for it" in said


def test_other_errors_are_not_swallowed(clock) -> None:
    with pytest.raises(ValueError, match="damaged"):
        watched(clock, [results(10), ValueError("damaged")])


@pytest.mark.parametrize(
    ("looks", "said"),
    [
        ([Look(0, 0, 0, 9)], "0 of 9 members finished"),
        ([Look(0, 2, 0, 9), Look(30, 3, 1, 9)], "3 of 9 members finished, 1 diverged; 2 a minute, 3 min to go"),
        ([Look(0, 3, 0, 9), Look(90, 3, 0, 9)], "3 of 9 members finished; no new one for 90 s"),
        ([Look(0, 3, 0, 9000), Look(9, 30, 0, 9000)], "30 of 9000 members finished; 3 a second, 50 min to go"),
        ([Look(0, 3, 0, 9), Look(9, 9, 0, 9)], "9 of 9 members finished"),
    ],
)
def test_progress_in_words(looks: list[Look], said: str) -> None:
    assert progress(looks) == said


def test_the_rate_is_that_of_the_last_minutes() -> None:
    looks = [Look(at_s, int(at_s), 0, 999) for at_s in (0.0, 100.0, 200.0)]
    assert [look.at_s for look in recent(looks, 210.0)] == [100.0, 200.0]
    assert [look.at_s for look in recent(looks, 900.0)] == [200.0], "the last one, however old"
    assert recent([], 0.0) == []
