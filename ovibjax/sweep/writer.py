"""Members on their way to the disk: those of a second in one block, so that files are few and a kill costs little."""

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

import numpy as np

from ovibjax.errors import InputError
from ovibjax.sweep.blocks import count_members, write_block
from ovibjax.sweep.disk import writing

_WAIT_S = 1.0
"""Finished members wait for others of their file at most so long: what a kill may cost."""


class Writer:
    """Writes members into the folder of a store; several threads may add them."""

    def __init__(self, path: Path) -> None:
        """Write into the store at a path, which is there."""
        self._path, self._folder = path, path / "members"
        self._waiting: list[np.ndarray] = []
        self._written = -_WAIT_S
        self._guard = threading.Lock()
        self._timer: threading.Timer | None = None

    def add(self, rows: np.ndarray) -> None:
        """Take members; they are on disk a second later at most.

        Raises:
            InputError: the disk refuses. What it refused is kept here, and tried again with the next ones.
        """
        with self._guard:
            self._waiting.append(rows)
            left_s = self._written + _WAIT_S - time.monotonic()
            if left_s <= 0:
                self._write()
            elif self._timer is None:
                self._timer = threading.Timer(left_s, self._write_in_time)
                self._timer.daemon = True
                self._timer.start()

    def flush(self) -> None:
        """Write what waits.

        Raises:
            InputError: the disk refuses.
        """
        with self._guard:
            self._write()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()

    def _write_in_time(self) -> None:
        # Refused members wait on; whoever adds the next ones, or flushes, hears of it.
        with self._guard, suppress(InputError):
            self._write()

    def _write(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._waiting:
            with writing(self._path, lambda: count_members(self._folder)):
                write_block(self._folder, np.concatenate(self._waiting))
            self._waiting = []
            self._written = time.monotonic()
