"""Progress on the terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

console = Console(stderr=True)


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
