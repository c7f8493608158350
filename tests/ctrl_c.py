"""Processes that Ctrl-C interrupts, also where the tests themselves were started with it ignored (`&`, nohup)."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def ctrl_c_interrupts() -> Iterator[None]:
    """Processes started in here interrupt on SIGINT: they inherit an ignored signal, but no handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
