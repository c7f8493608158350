"""Where the time of a piece of work goes: seconds per named stage, and how many of them jax spent compiling."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from ovibjax.runtime.compile_time import compile_seconds


class Stages:
    """Seconds by stage; a stage inside another takes its time out of it, and one that comes again adds up.

    Example:
        >>> stages = Stages()
        >>> with stages.stage("all"):
        ...     with stages.stage("part"):
        ...         pass
        >>> list(stages.seconds())
        ['all', 'part']
    """

    def __init__(self) -> None:
        self._spent: dict[str, tuple[float, float]] = {}
        self._open: list[str] = []
        self._since = (0.0, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside to a stage.

        Args:
            name: the stage.
        """
        self._charge()
        self._open.append(name)
        self._spent.setdefault(name, (0.0, 0.0))
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def seconds(self) -> dict[str, float]:
        """Seconds by stage up to now, compiling included, in the order in which the stages began."""
        return {name: spent[0] for name, spent in self._charge().items()}

    def compiling(self) -> dict[str, float]:
        """Those of the seconds in which programs were compiled, of stages that compiled any."""
        return {name: spent[1] for name, spent in self._charge().items() if spent[1] > 0}

    def lines(self) -> list[str]:
        """One line per stage, such as "train 41.0 s (compile 12.0 s)"."""
        compiling = self.compiling()
        return [
            f"{name} {seconds:.1f} s" + (f" (compile {compiling[name]:.1f} s)" if name in compiling else "")
            for name, seconds in self.seconds().items()
        ]

    def _charge(self) -> dict[str, tuple[float, float]]:
        """Give the time since the last change to the innermost stage that is open."""
        now, compiled = time.perf_counter(), compile_seconds()
        if self._open:
            spent, compiling = self._spent[self._open[-1]]
            self._spent[self._open[-1]] = spent + now - self._since[0], compiling + compiled - self._since[1]
        self._since = (now, compiled)
        return self._spent
