"""Processes that Ctrl-C interrupts, also where the tests themselves were started with it ignored (`&`, nohup)."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple


class Pressed(NamedTuple):
    """What came of one press: exit code, what the process said, and seconds until it ended."""

    code: int
    said: str
    took_s: float

    def lost(self) -> bool:
        """Whether the work went on to its end, or to its time limit."""
        return self.code in (0, -signal.SIGKILL)

    def clean(self) -> bool:
        """Whether it ended as it should: one line, and the exit code of Ctrl-C."""
        last = " ".join(self.said.strip().splitlines()[-3:])
        return self.code == 130 and "Traceback" not in self.said and "interrupted" in last


@contextmanager
def ctrl_c_interrupts() -> Iterator[None]:
    """Processes started in here interrupt on SIGINT: they inherit an ignored signal, but no handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def press(arguments: Sequence[str], after_s: float, cwd: Path, env: Mapping[str, str], limit_s: float = 60) -> Pressed:
    """Start `ovibjax`, and press Ctrl-C so many seconds after its first own line ran.

    Args:
        arguments: of the command.
        after_s: when to press.
        cwd: folder to run in.
        env: environment.
        limit_s: when to give up, and take the press for lost.

    Returns:
        What came of it.
    """
    # Before that it is Python that ends on Ctrl-C, in words of its own.
    begun = "from ovibjax.cli.main import main; print('+', end='', flush=True); main()"
    with ctrl_c_interrupts():
        running = subprocess.Popen(
            [sys.executable, "-c", begun, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=cwd,
            env={**os.environ, **env},
        )
    with running:
        assert running.stdout is not None
        said = running.stdout.read(1)
        time.sleep(after_s)
        pressed_s = time.monotonic()
        running.send_signal(signal.SIGINT)
        try:
            said += running.communicate(timeout=limit_s)[0]
        except subprocess.TimeoutExpired:
            running.kill()
            said += running.communicate()[0]
    return Pressed(running.returncode, said.decode(errors="replace"), time.monotonic() - pressed_s)
