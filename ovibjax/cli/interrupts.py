"""Ctrl-C that is never lost.

Python turns Ctrl-C into an exception wherever the main thread happens to be. In a callback of the garbage collector, a
finaliser or a callback from C that exception is printed and dropped, and the work goes on: jax collects garbage in such
a callback often enough to lose one press in ten in the first seconds. Here a press that has been dropped is repeated
until it arrives.
"""

import gc
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import Any

_AGAIN_S = 0.05


class _Pressed(KeyboardInterrupt):
    """One press on its way; when it goes without having been caught by this package, it is pressed again."""

    def __init__(self, presses: "Presses") -> None:
        super().__init__()
        self.presses = presses

    def __del__(self) -> None:
        # The first entry is the frame that the exception came up to: where somebody caught it.
        frame = self.__traceback__.tb_frame if self.__traceback__ is not None else None
        if frame is None or not str(frame.f_globals.get("__name__")).startswith("ovibjax"):
            self.presses.again()


class Presses:
    """What has come of Ctrl-C in this process so far.

    Attributes:
        came: whether it was pressed.
    """

    def __init__(self) -> None:
        self.came = False
        self._over = False

    def on_signal(self, _: int, frame: FrameType | None) -> None:
        """Handle SIGINT: raise the exception in the main thread."""
        self.came = True
        if _must_not_raise(frame):
            self.again()
        else:
            raise _Pressed(self)  # in no variable: this frame would keep it

    def on_unraisable(self, error: Any) -> None:
        """Say nothing of a press that was dropped, as it comes again."""
        if not isinstance(error.exc_value, _Pressed):
            sys.__unraisablehook__(error)

    def again(self) -> None:
        """Press again in a moment, when whatever dropped it is over."""
        if not self._over:
            timer = threading.Timer(_AGAIN_S, self._press)
            timer.daemon = True
            timer.start()

    def over(self) -> None:
        """From here on Ctrl-C is of no interest: the program is ending."""
        self._over = True

    def _press(self) -> None:
        if self._over:
            return
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, signal.SIGINT)  # ends a wait too
        else:
            signal.raise_signal(signal.SIGINT)


def _must_not_raise(frame: FrameType | None) -> bool:
    """Whether C code that takes no exception has called what is running: it would drop it, or end the process."""
    collecting = {getattr(callback, "__code__", None) for callback in gc.callbacks}
    while frame is not None:
        if frame.f_code in collecting:
            return True
        # An extension module that is being made: nanobind, for one, ends the process.
        if frame.f_code.co_name in ("exec_module", "create_module") and isinstance(
            frame.f_locals.get("self"), ExtensionFileLoader
        ):
            return True
        frame = frame.f_back
    return False


@contextmanager
def watched() -> Iterator[Presses]:
    """Handle Ctrl-C while the block runs; where it is ignored (`nohup`, `&`) or not ours to handle, leave it so.

    Yields:
        What came of it.
    """
    presses = Presses()
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, None):
        yield presses
        return
    handler = signal.signal(signal.SIGINT, presses.on_signal)
    hook, sys.unraisablehook = sys.unraisablehook, presses.on_unraisable
    try:
        yield presses
    finally:
        presses.over()
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, handler)
