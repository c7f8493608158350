"""Member functions and helpers that the tests share with the processes they start."""

import hashlib
import os
import subprocess
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.sweep.engine import run
from ovibjax.sweep.store import open_dataset
from ovibjax.sweep.work import Along
from tests.ctrl_c import ctrl_c_interrupts

ROOT = Path(__file__).parents[2]


def train(key, point, shared, steps):
    """A recursion with random numbers, about 3.5 us a step; `rate` beyond 1 diverges."""

    def body(i, w):
        return point["rate"] * w + shared["gain"] * jnp.tanh(jax.random.normal(jax.random.fold_in(key, i), (64,)))

    w = jax.lax.fori_loop(0, steps, body, jnp.zeros(64))
    return {"weights": w, "loss": (w * w).mean(), "steps": jnp.int32(steps), "positive": w[0] > 0}


RATES = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99]


def sweep(store, steps=9000, rates=RATES, seeds=8, **options):
    """64 members, each alone; about 30 ms a member."""
    axes = {"rate": list(rates), "seed": range(seeds)}
    return run(partial(train, steps=steps), axes, {"gain": np.float32(0.1)}, store=store, **{"lanes": 1, **options})


def small(key, point, shared):
    """Instant; all kinds of outputs."""
    noise = jax.random.normal(key, (3,))
    wave = jnp.sin(point["rate"] * noise) + shared["offset"]
    return {"wave": wave, "sum": {"all": wave.sum(), "first": wave[0]}, "n": jnp.int32(point["rate"] * 10)}


AXES = {"rate": [0.1, 0.2, 0.3], "seed": range(2)}
DATA = {"offset": np.float32(1)}


def in_order(work, lots, path):
    """Members one batch after another."""
    for lot in lots:
        rows = work.compute(lot)
        yield len(rows), rows


def begun_store(path):
    """A store with three of six members."""

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    options = {"store": path, "settings": {"model": "wave"}, "lanes": 1, "executor": in_order}
    with suppress(KeyboardInterrupt):
        run(small, AXES, DATA, on_progress=stop, **options)
    assert int(open_dataset(path).finished.sum()) == 3
    return path


def cases():
    """Sweeps that are to give the same on any number of devices."""
    offset = {"offset": np.float32(0.25)}
    along = [{"offset": np.float32(i)} for i in range(5)]

    def only_seed(key, point, shared):
        return {"draw": jax.random.normal(key, (2,)) + point["seed"].astype(jnp.float32)}

    rates = np.linspace(0.1, 1.0, 7)
    return {
        "padded": lambda: run(small, {"rate": rates, "seed": range(3)}, offset, lanes=2),
        "no seed": lambda: run(small, {"rate": rates}, offset, lanes=1),
        "seeds": lambda: run(only_seed, {"seed": range(5)}),
        "seeds padded": lambda: run(only_seed, {"seed": range(7)}, lanes=1),
        "one member": lambda: run(only_seed, {"seed": [3]}),
        "along rows": lambda: run(small, {"rate": rates[:5]}, Along("rate", along)),
        "along columns": lambda: run(small, {"scene": range(5), "rate": rates}, Along("scene", along), lanes=4),
        "along zipped": lambda: run(
            small,
            {"scene": range(5), "seed": range(5), "rate": rates[:2]},
            Along("scene", along),
            zipped=[["scene", "seed"]],
        ),
    }


def tree_hash(folder):
    """Names and bytes of every file below a folder."""
    digest = hashlib.sha256()
    for path in sorted(Path(folder).rglob("*")):
        digest.update(f"{path.relative_to(folder)}{path.is_dir()}".encode())
        digest.update(path.read_bytes() if path.is_file() else b"")
    return digest.hexdigest()


def snapshot_of(folder):
    """Bytes of every file below a folder but of locks."""
    return {
        path: path.read_bytes() for path in sorted(Path(folder).rglob("*")) if path.is_file() and path.name != "lock"
    }


def same(one, other):
    """Bit-identical variables and coordinates."""
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        left, right = one[name].values, other[name].values
        assert left.dtype == right.dtype and left.shape == right.shape, name
        assert left.tobytes() == right.tobytes(), name


def with_devices(count):
    """This process's compiler flags, with another number of devices."""
    return f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}".strip()


def start(code, *arguments, devices=1, threads=1, hash_seed="random"):
    """A Python process with the package, `tests` and `arguments` at hand."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "XLA_FLAGS": with_devices(devices),
        "NPROC": str(threads),
        "PYTHONHASHSEED": hash_seed,
    }
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with ctrl_c_interrupts():
        return subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)], text=True, env=environment, cwd=ROOT, **pipes
        )


def finish(process):
    """Its output; fails with its errors."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, f"{out}\n{err}"
    return out
