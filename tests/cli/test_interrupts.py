"""Ctrl-C arrives wherever the main thread happens to be, and only once."""

import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import types
import weakref

import pytest

from ovibjax.cli.interrupts import watched
from tests.cli.cases import ROOT
from tests.ctrl_c import ctrl_c_interrupts, press


def kill():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):  # the handler runs between two of these
        pass


def in_a_library(*, kept: str):
    """A function of another package that presses, and keeps the exception to itself in some way."""
    library = types.ModuleType("library")
    library.kill = kill
    exec(kept, library.__dict__)
    return library.run


def collecting():
    def callback(phase, info):
        if not pressed:
            pressed.append(True)
            kill()

    pressed: list[bool] = []
    gc.callbacks.append(callback)
    try:
        gc.collect()
    finally:
        gc.callbacks.remove(callback)


def finalizing():
    class Dying:
        def __del__(self):
            kill()

    Dying()


def weakly_referred():
    class Dying:
        pass

    one = Dying()
    held = weakref.ref(one, lambda _: kill())
    del one
    return held


def called_from_c():
    ctypes.CFUNCTYPE(None)(kill)()


def importing():
    class Finder:
        def find_spec(self, *_):
            finalizing()

    sys.meta_path.insert(0, Finder())
    try:
        __import__("no_such_module_anywhere")
    except ImportError:
        pass
    finally:
        sys.meta_path.pop(0)


SWALLOWED = {
    "in the garbage collector": collecting,
    "in a finalizer": finalizing,
    "in a callback of a weak reference": weakly_referred,
    "in a callback from C": called_from_c,
    "in an import": importing,
    "by a bare except": in_a_library(kept="def run():\n try:\n  kill()\n except: pass"),
    "by a wide except": in_a_library(kept="def run():\n try:\n  kill()\n except BaseException as e: del e"),
    "by a return in finally": in_a_library(kept="def run():\n try:\n  kill()\n finally:\n  return 1"),
}


@pytest.mark.parametrize("where", SWALLOWED)
@pytest.mark.filterwarnings("ignore::SyntaxWarning")
def test_a_press_that_is_swallowed_comes_again(where, capfd):
    with ctrl_c_interrupts(), watched() as presses, pytest.raises(KeyboardInterrupt):
        SWALLOWED[where]()
        time.sleep(20)
        pytest.fail("the press was lost")
    assert presses.came
    assert "KeyboardInterrupt" not in capfd.readouterr().err  # nor is it spoken of


def test_a_press_that_ends_a_wait_ends_it_when_it_comes_again():
    lock = threading.Lock()
    with lock, ctrl_c_interrupts(), watched(), pytest.raises(KeyboardInterrupt):
        SWALLOWED["by a bare except"]()
        lock.acquire(timeout=20)
        pytest.fail("the press was lost")


def test_a_press_that_this_package_catches_is_over(monkeypatch):
    monkeypatch.setitem(globals(), "__name__", "ovibjax.somewhere")
    with ctrl_c_interrupts(), watched() as presses:
        try:
            kill()
        except KeyboardInterrupt as error:
            assert str(error) == ""
        time.sleep(0.3)  # it does not come again
    assert presses.came


def test_other_swallowed_errors_are_still_told(capfd):
    class Dying:
        def __del__(self):
            raise RuntimeError("of its own")

    with ctrl_c_interrupts(), watched():
        Dying()
    assert "of its own" in capfd.readouterr().err


def test_handlers_are_put_back():
    before, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
    with watched():
        pass
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == (before, hook)
    in_thread = []
    thread = threading.Thread(target=lambda: in_thread.extend((watched().__enter__() and [1]) or [0]))
    thread.start()
    thread.join()
    assert in_thread == [1] and signal.getsignal(signal.SIGINT) == before


def test_an_ignored_signal_stays_ignored():
    """As under `nohup`: the shell said that this program is not to be interrupted."""
    code = "from ovibjax.cli.interrupts import watched; import os, signal\nwith watched(): os.kill(os.getpid(), 2)"
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)})
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.returncode == 0


def test_an_interrupted_import_of_another_kind_is_an_interrupt(tmp_path):
    """C code may turn the exception into one of its own."""
    (tmp_path / "tyro.py").write_text(
        "import os, signal\n"
        "try:\n os.kill(os.getpid(), signal.SIGINT)\n for _ in range(1000): pass\n"
        "except BaseException as error:\n raise SystemError('initialization failed') from error\n"
    )
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    with ctrl_c_interrupts():
        done = subprocess.run([sys.executable, "-m", "ovibjax"], env=env, capture_output=True, text=True)
    assert done.returncode == 130 and done.stderr.strip() == "ovibjax: interrupted"


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.03, 0.08, 0.2, 0.5, 0.9, 1.3, 1.8, 2.5])
def test_presses_while_everything_is_loaded(tmp_path, after_s):
    """A few of `tests/benchmarks/interrupts.py`."""
    from tests.benchmarks.interrupts import FILE

    (tmp_path / "mine.py").write_text(FILE)
    arguments = ["sweep", "run", "mine.py", "--out", "a.zarr"]
    came = press(arguments, after_s, tmp_path, {"PYTHONPATH": str(ROOT), "JAX_COMPILATION_CACHE_DIR": ""}, 120)
    assert came.clean(), came
