"""A table of a sweep that is still running, drawn again as its members are finished."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import xarray as xr
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

_WINDOW_S = 120.0
"""A rate is that of the last two minutes: chunks come in bursts, and early ones are slow."""

_SHARE = 0.2
"""Reading takes at most this share of the time: a large store is looked at more seldom."""

_AROUND = 12
"""Lines of the screen for what stands around the rows of a table."""


@dataclass(frozen=True)
class Look:
    """What one look at a sweep found.

    Attributes:
        at_s: when, on a clock that never goes back.
        finished: members that are finished.
        diverged: members of these that diverged.
        total: members in all.
    """

    at_s: float
    finished: int
    diverged: int
    total: int


def watch(
    read: Callable[[], xr.Dataset | None],
    draw: Callable[[xr.Dataset, int | None], RenderableType],
    name: str,
    every_s: float = 2.0,
    console: Console | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show a table of a sweep until every member is finished, or until Ctrl-C.

    Args:
        read: gives the results so far; None where there are none yet.
        draw: makes the table of results, with so many rows at most; with its own number for None.
        name: what is watched, as the user calls it.
        every_s: seconds between two looks, more where reading takes long.
        console: where to draw; standard output if None.
        sleep: waits for so many seconds.
    """
    console = console or Console()
    looks: list[Look] = []
    with Live(Text(f"reading {name}"), console=console, auto_refresh=False) as live:
        try:
            while True:
                start_s = time.monotonic()
                dataset = read()
                if dataset is None:
                    live.update(Text(f"{name} is not there yet; waiting for it"), refresh=True)
                else:
                    looks = [*recent(looks, start_s), _look(dataset, start_s)]
                    complete = looks[-1].finished == looks[-1].total
                    made = draw(dataset, None if complete else max(5, console.height - _AROUND))
                    live.update(Group(Text(f"{name}: {progress(looks)}", "bold"), made), refresh=True)
                    if complete:
                        return
                sleep(max(every_s, (time.monotonic() - start_s) * (1 / _SHARE - 1)))
        except KeyboardInterrupt:
            return  # the table stays on the screen


def _look(dataset: xr.Dataset, at_s: float) -> Look:
    finished = dataset["finished"]
    total = int(dataset.attrs.get("asked", finished.size))  # of a store that has grown, a hole need not be to come
    return Look(at_s, int(finished.sum()), int((finished & dataset["diverged"]).sum()), total)


def recent(looks: Sequence[Look], now_s: float) -> list[Look]:
    """The looks that a rate is taken from: those of the last two minutes, and at least the last one.

    Args:
        looks: earlier ones, in order.
        now_s: on their clock.

    Returns:
        The later part.
    """
    return [look for look in looks[:-1] if now_s - look.at_s <= _WINDOW_S] + list(looks[-1:])


def progress(looks: Sequence[Look]) -> str:
    """How far a sweep is, and how fast it was between the first look and the last.

    Args:
        looks: at least one, in order.

    Returns:
        E.g. `12 of 20 members finished, 1 diverged; 0.53 a second, 15 s to go`.

    Example:
        >>> progress([Look(0.0, 4, 0, 20), Look(4.0, 12, 1, 20)])
        '12 of 20 members finished, 1 diverged; 2 a second, 4 s to go'
    """
    first, last = looks[0], looks[-1]
    said = f"{last.finished} of {last.total} members finished"
    if last.diverged:
        said += f", {last.diverged} diverged"
    passed_s, done = last.at_s - first.at_s, last.finished - first.finished
    if last.finished == last.total or passed_s <= 0:
        return said
    if done <= 0:
        return f"{said}; no new one for {_duration(passed_s)}"
    rate = done / passed_s
    speed = f"{rate:.3g} a second" if rate >= 0.1 else f"{60 * rate:.3g} a minute"
    return f"{said}; {speed}, {_duration((last.total - last.finished) / rate)} to go"


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
