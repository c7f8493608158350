"""Members on real Ray workers: the same bits as in this process, whatever dies."""

import importlib.util
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep import cluster, worker
from ovibjax.sweep.cluster import on_ray
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import open_dataset
from tests.ctrl_c import ctrl_c_interrupts
from tests.sweep.members import with_devices

ray = pytest.importorskip("ray")

# Ray leaves files and sockets open, which shows when they are collected.
pytestmark = pytest.mark.filterwarnings(
    "ignore::ResourceWarning",
    "ignore:Exception ignored in. <(socket|_io|.*ray):pytest.PytestUnraisableExceptionWarning",
)

AXES = {"beta": [1e-3, 1e-2, 1e-1], "seed": range(4)}
DATA = {"x": np.linspace(-1, 1, 64 * 32, dtype=np.float32).reshape(64, 32), "scale": jnp.float32(0.3)}


def train(key, point, shared):
    """A small optimisation: random numbers, products, transcendental functions."""
    w = jax.random.normal(key, (32, 8))

    def step(_, w):
        gradient = jax.grad(lambda w: jnp.mean(jnp.tanh(shared["x"] @ w * shared["scale"]) ** 2))(w)
        return w - 0.1 * gradient - point["beta"] * w

    w = jax.lax.fori_loop(0, 50, step, w)
    return {"w": w, "loss": jnp.sum(jnp.sin(w))}


def noted(on_host, tag, key, point, shared):
    """The same, and a number from the worker's host; `tag` tells programs apart whose callbacks differ."""
    spec = jax.ShapeDtypeStruct((), jnp.int32)
    number = jax.pure_callback(on_host, spec, point["beta"], point["seed"], vmap_method="sequential")
    return {**train(key, point, shared), "host": number + tag}


@pytest.fixture(scope="module")
def workers():
    with cluster._connected(ray, None, 2):
        yield


def same(one, other, without=()):
    one, other = one.drop_vars(without), other.drop_vars(without)
    assert one.sizes == other.sizes and set(one) == set(other)
    for name in one.variables:
        assert one[name].dtype == other[name].dtype
        assert one[name].values.tobytes() == other[name].values.tobytes(), name


def refused(function):
    with pytest.raises(InputError) as caught:
        function()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 700, message
    return message


@pytest.mark.parametrize("options", [{"lanes": 1}, {"lanes": 2}, {}])
def test_same_bits(tmp_path, workers, options):
    here = run(train, AXES, DATA, **options)
    same(run(train, AXES, DATA, executor=on_ray(), **options), here)
    finished = []
    store = {"store": tmp_path / "a.zarr", "on_progress": lambda done, _: finished.append(done)}
    same(run(train, AXES, DATA, executor=on_ray(), **options, **store), here)
    assert open_dataset(tmp_path / "a.zarr").finished.all()
    assert (
        finished[0] == 0 and finished[-1] == 12 and finished == sorted(finished) and (len(finished) > 4 or not options)
    )


def test_workers_share_the_members(tmp_path, workers):
    def on_host(beta, seed):
        """Wait until two processes have come here, which they only do at the same time."""
        (tmp_path / str(os.getpid())).touch()
        limit = time.monotonic() + 60
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < limit:
            time.sleep(0.01)
        return np.int32(os.getpid())

    pids = run(partial(noted, on_host, 0), AXES, DATA, lanes=1, executor=on_ray()).host.values
    assert len(np.unique(pids)) == 2 and os.getpid() not in pids


def test_killed_worker(tmp_path, workers):
    def on_host(beta, seed):
        try:
            if seed == 2 and beta < 0.05:
                (tmp_path / f"killed {beta}").touch(exist_ok=False)
                os.kill(os.getpid(), signal.SIGKILL)
        except FileExistsError:
            pass
        return np.int32(os.getpid())

    fn = partial(noted, on_host, 1)
    disturbed = run(fn, AXES, DATA, lanes=1, store=tmp_path / "a.zarr", executor=on_ray())
    assert len(list(tmp_path.glob("killed*"))) == 2
    assert disturbed.finished.all()
    same(disturbed, run(fn, AXES, DATA, lanes=1), without=["host"])  # here with all marks in place


def test_deadly_member(tmp_path, workers, monkeypatch):
    """It takes no other one with it, though they begin in one task."""
    monkeypatch.setattr(cluster, "_TASKS", 1)

    def on_host(beta, seed):
        with (tmp_path / f"{beta} {seed}").open("a") as file:
            file.write("x")
        if seed == 1 and 0.005 < beta < 0.05:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.int32(0)

    fn = partial(noted, on_host, 2)
    message = refused(lambda: run(fn, AXES, DATA, lanes=1, store=tmp_path / "a.zarr", executor=on_ray()))
    assert "some members killed their worker 3 times: beta 0.01; seed 1; too little memory" in message
    kept = open_dataset(tmp_path / "a.zarr")
    assert int(kept.finished.sum()) == 11 and not kept.finished.sel(beta=0.01, seed=1)
    same(kept.drop_vars("host").isel(beta=0), run(train, {**AXES, "beta": [1e-3]}, DATA, lanes=1).isel(beta=0))


def test_exception_of_a_member(workers):
    def on_host(beta, seed):
        raise ZeroDivisionError("a member fails")

    with pytest.raises(jax.errors.JaxRuntimeError, match="a member fails") as caught:
        run(partial(noted, on_host, 3), AXES, DATA, lanes=1, executor=on_ray())
    assert not isinstance(caught.value, ray.exceptions.RayError) and caught.value.__suppress_context__


def test_card_with_helper(tmp_path, workers, monkeypatch):
    """Cards are loaded by path under a name that no worker can import; a helper lies beside."""
    (tmp_path / "my_helper.py").write_text("import jax.numpy as jnp\nWIDTH = 3\ndef f(x): return jnp.full(WIDTH, x)\n")
    path = tmp_path / "card.py"
    path.write_text("import my_helper\ndef member(key, point, shared): return {'y': my_helper.f(point['beta'])}\n")
    monkeypatch.syspath_prepend(tmp_path)
    spec = importlib.util.spec_from_file_location("ovibjax._cards.card", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    same(run(module.member, AXES, lanes=1, executor=on_ray()), run(module.member, AXES, lanes=1))
    monkeypatch.delitem(sys.modules, "my_helper")


def test_settings_of_jax(workers):
    def fn(key, point, shared):
        return {"y": jnp.sin(jax.random.normal(key, (3,)))}

    with jax.enable_x64(True):
        dataset = run(fn, AXES, lanes=1, executor=on_ray())
        assert dataset.y.dtype == "float64"
        same(dataset, run(fn, AXES, lanes=1))
    same(run(fn, AXES, lanes=1, executor=on_ray()), run(fn, AXES, lanes=1))


def test_store_that_workers_do_not_see(tmp_path, workers, monkeypatch):
    monkeypatch.chdir(tmp_path)  # workers stay where they are
    path = Path("/proc/self/cwd/a.zarr")
    message = refused(lambda: run(train, AXES, DATA, lanes=1, store=path, executor=on_ray()))
    assert "cannot open the store" in message and "all machines share" in message


def test_other_software(workers):
    assignment = worker.Assignment(None, None, (("jax", "0.4.1"),), "", ())
    assert "has jax " in refused(lambda: worker.begin(assignment))
    assignment = worker.Assignment(None, None, (("jax", jax.__version__), ("platform", "gpu")), "", ())
    assert "has platform cpu and this sweep gpu" in refused(lambda: worker.begin(assignment))
    assignment = worker.Assignment(None, None, (("threads", 7),), "", ())
    assert "has threads 1 and this sweep 7" in refused(lambda: worker.begin(assignment))


def test_bad_address(monkeypatch):
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    message = refused(lambda: run(train, AXES, DATA, executor=on_ray("127.0.0.1:1")))
    assert "no Ray cluster answers at 127.0.0.1:1" in message
    assert "positive" in refused(lambda: on_ray(workers=0))


def test_without_ray(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert refused(on_ray) == "Ray is not installed; pip install 'ovibjax[cluster]'"


SCRIPT = """
import sys
import jax, jax.numpy as jnp
from ovibjax.sweep.cluster import on_ray
from ovibjax.sweep.engine import Interrupted, run

WIDTH = 64

def member(key, point, shared):
    w = jax.random.normal(key, (WIDTH, WIDTH)) * point["beta"]
    return {"w": jax.lax.fori_loop(0, 20000, lambda _, w: jnp.tanh(w @ w + shared), w)}

def show(done, total):
    print(done, flush=True)

options = dict(axes={"beta": [0.1, 0.2, 0.3, 0.4], "seed": range(8)}, shared=jnp.float32(0.1), lanes=1)
try:
    dataset = run(member, **options, store=sys.argv[1], executor=on_ray(workers=2), on_progress=show)
except Interrupted as error:
    sys.exit(f"interrupted after {int(error.dataset.finished.sum())} of {error.dataset.finished.size}")
here = run(member, **options)
assert dataset.finished.all() and dataset.w.values.tobytes() == here.w.values.tobytes()
assert len(jax.devices()) == 2
"""


@pytest.mark.long
def test_killed_and_interrupted_driver(tmp_path):
    """A function of `__main__`, workers with two devices, a cluster of its own; the third command finishes."""
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, tmp_path / "script.py", tmp_path / "a.zarr"]
    environment = {**os.environ, "XLA_FLAGS": with_devices(2)}
    for end in (signal.SIGKILL, signal.SIGINT, None):
        with ctrl_c_interrupts():
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            process = subprocess.Popen(command, env=environment, text=True, **pipes)
        if end is not None:
            for _ in range(3):  # what was there, and two tasks more
                assert process.stdout.readline(), process.stderr.read()
            process.send_signal(end)
        _, err = process.communicate(timeout=100)
        if end is signal.SIGINT:
            assert re.fullmatch(r"interrupted after \d+ of 32\n", err), err
    assert process.returncode == 0, err
