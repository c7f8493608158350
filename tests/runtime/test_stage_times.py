"""Time by stage: every second counts once, to the innermost stage; compiling is seen, in threads as well."""

import threading

import jax
import jax.numpy as jnp
import pytest

from ovibjax.runtime import stage_times as module
from ovibjax.runtime.compile_time import _Spans, compile_seconds
from ovibjax.runtime.stage_times import Stages


@pytest.fixture
def clock(monkeypatch):
    """Sets the time, and the seconds of compiling so far."""
    now = [0.0, 0.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(module, "compile_seconds", lambda: now[1])

    def set_to(seconds, compiled=None):
        now[0] = seconds
        now[1] = now[1] if compiled is None else compiled

    return set_to


def test_a_second_counts_to_the_innermost_stage_and_once(clock):
    stages = Stages()
    clock(10.0, 5.0)
    with stages.stage("other"):
        clock(11.0)
        with stages.stage("train"):
            clock(14.0, 7.0)
            assert stages.seconds() == {"other": 1.0, "train": 3.0}
        clock(14.5)
        with pytest.raises(KeyboardInterrupt), stages.stage("draw"):
            clock(15.0)
            raise KeyboardInterrupt
        with stages.stage("train"):
            clock(16.0)
    clock(99.0, 50.0)
    assert stages.seconds() == {"other": 1.5, "train": 4.0, "draw": 0.5}
    assert stages.compiling() == {"train": 2.0}
    assert stages.lines() == ["other 1.5 s", "train 4.0 s (compile 2.0 s)", "draw 0.5 s"]


def test_stretches_of_compiling_are_a_union():
    spans = _Spans()
    for start, end, total in ((1, 2, 1), (1.5, 3, 2), (5, 6, 3), (5.2, 6, 3), (4, 7, 5), (0, 8, 8), (9, 10, 9)):
        spans.add(start, end)
        assert spans.total_s == pytest.approx(total)
    spans.note("/jax/core/compile/some_other_duration", 100.0)
    assert spans.total_s == pytest.approx(9)


def test_compiling_is_seen_and_running_is_not():
    compile_seconds()

    def compiled(salt):
        before = compile_seconds()
        program = jax.jit(lambda x: jnp.cos(x) * salt + jnp.sum(x))
        program(jnp.ones(7)).block_until_ready()
        between = compile_seconds()
        program(jnp.ones(7)).block_until_ready()
        return between - before, compile_seconds() - between

    first, second = compiled(1.234)
    assert first > 0 and second == 0
    before = compile_seconds()
    thread = threading.Thread(target=compiled, args=(5.678,))
    thread.start()
    thread.join()
    assert compile_seconds() > before
