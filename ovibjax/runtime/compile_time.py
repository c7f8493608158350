"""How long jax has been compiling, as it reports itself: tracing, lowering, and making or reading machine code."""

import threading
import time
from functools import cache

import jax

_EVENTS = ("jaxpr_trace_duration", "jaxpr_to_mlir_module_duration", "backend_compile_duration")


class _Spans:
    """Stretches of time, as a union: programs are traced inside programs, and threads compile side by side."""

    def __init__(self) -> None:
        self._spans: list[tuple[float, float]] = []
        self._lock = threading.Lock()
        self.total_s = 0.0

    def note(self, event: str, duration_secs: float, **_: str | int) -> None:
        """An event of `jax.monitoring`, which ends as it is reported."""
        if not event.endswith(_EVENTS):
            return
        with self._lock:
            end = time.perf_counter()
            self.add(end - duration_secs, end)

    def add(self, start: float, end: float) -> None:
        """A stretch that ends after all others."""
        while self._spans and self._spans[-1][1] >= start:
            earlier = self._spans.pop()
            self.total_s -= earlier[1] - earlier[0]
            start = min(start, earlier[0])
        self._spans.append((start, end))
        self.total_s += end - start


@cache
def _listening() -> _Spans:
    spans = _Spans()
    jax.monitoring.register_event_duration_secs_listener(spans.note)
    return spans


def compile_seconds() -> float:
    """Seconds in which this process was compiling since the first call; stretches in several threads count once."""
    return _listening().total_s
