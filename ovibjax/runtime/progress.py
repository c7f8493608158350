"""Progress on the terminal, and how wide what is no terminal may be taken."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_UNBOUNDED = 10_000


def width_of(stream: TextIO) -> int | None:
    """Columns to print in: None, for a terminal to say; without bound for files and pipes, where lines are not cut.

    Args:
        stream: standard output or error.

    Returns:
        The width; `COLUMNS`, where it is set, is left to rich.
    """
    return None if "COLUMNS" in os.environ or stream.isatty() else _UNBOUNDED


console = Console(stderr=True, width=width_of(sys.stderr))


@contextmanager
def progress_bar(description: str, total: int, transient: bool = False) -> Iterator[Callable[..., None]]:
    """A bar that appears on its first update.

    Args:
        description: what is being done.
        total: steps in all.
        transient: whether the bar goes away in the end, and leaves the screen to what is said then.

    Yields:
        A function that takes the number of finished steps, and the number of all if that was not known before.
    """
    text = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    bar = Progress(*text, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=transient)
    task = bar.add_task(description, total=total)
    started = False

    def update(done: int, all_steps: int = total) -> None:
        nonlocal started
        if not started:
            bar.start()
            started = True
        bar.update(task, completed=done, total=all_steps)

    try:
        yield update
    finally:
        if started:
            bar.stop()
