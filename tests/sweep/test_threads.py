"""Bits depend on the number of threads of a program, which a store keeps, and on no number of cores."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.basis import fit_basis, project
from ovibjax.sweep.engine import run
from ovibjax.sweep.store import config_of
from tests.sweep.members import finish, same, snapshot_of, start


def long_sums(key, point, shared):
    """What is split among threads where there are some: sums, products, decompositions."""
    x = jax.random.normal(key, (3000, 64)) * point["rate"]
    covariance = x.T @ x
    return {
        "sum": jnp.exp(x).sum(axis=0),
        "std": x.std(axis=1)[:50],
        "product": covariance,
        "vectors": jnp.linalg.eigh(covariance)[1],
    }


AXES = {"rate": [0.5, 1.0], "seed": range(2)}

CODE = """
import os, sys
if sys.argv[2]:
    os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])  # before jax, NumPy and SciPy look
import numpy as np
from ovibjax.features.basis import fit_basis, project
from ovibjax.sweep.engine import run
from tests.sweep.test_threads import AXES, frames, long_sums
dataset = run(long_sums, AXES)
assert dataset.attrs["config"]["environment"]["threads"] == int(os.environ["NPROC"])
basis = fit_basis(frames(), 20)
np.savez(sys.argv[1], axes=basis.axes, x=project(basis, frames()), **{n: v.values for n, v in dataset.items()})
"""


def frames():
    return np.random.default_rng(0).normal(size=(700, 2, 256)).astype(np.float32)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be taken away here")
def test_cores_change_nothing(tmp_path):
    """In particular none of the data that a member sees."""
    names = [(threads, one_core) for threads in (1, 2) for one_core in ("", "one core")]
    processes = [start(CODE, tmp_path / f"{i}.npz", name[1], threads=name[0]) for i, name in enumerate(names)]
    found = []
    for i, process in enumerate(processes):
        finish(process)
        with np.load(tmp_path / f"{i}.npz") as file:
            found.append(dict(file))
    assert found[0].keys() == {"sum", "std", "product", "vectors", "finished", "diverged", "axes", "x"}
    for one, other in (found[:2], found[2:]):
        for name in one:
            assert one[name].tobytes() == other[name].tobytes(), name
    basis = fit_basis(frames(), 20)
    assert found[0]["x"].tobytes() == found[2]["x"].tobytes() == project(basis, frames()).tobytes()
    here = run(long_sums, AXES)
    for name in ("sum", "std", "product", "vectors"):
        assert found[0][name].tobytes() == here[name].values.tobytes(), name


BEGIN = """
import sys
from ovibjax.sweep.engine import run
from tests.sweep.test_threads import AXES, long_sums
run(long_sums, AXES, store=sys.argv[1])
"""


def test_a_store_keeps_its_number_of_threads(tmp_path):
    path = tmp_path / "a.zarr"
    finish(start(BEGIN, path, threads=3))
    assert config_of(path)["environment"]["threads"] == 3
    before = snapshot_of(path)
    assert run(long_sums, {**AXES, "seed": [1]}, store=path).finished.all(), "reading needs no program"
    with pytest.raises(InputError) as caught:
        run(long_sums, {**AXES, "seed": range(3)}, store=path)
    message = str(caught.value)
    assert str(path) in message and "programs of 3 threads" in message and "here are 1" in message
    assert "NPROC=3" in message and "--threads 3" in message and "\n" not in message
    assert snapshot_of(path) == before
    finish(start(BEGIN.replace("AXES, store", "{**AXES, 'seed': range(3)}, store"), path, threads=3))
    assert run(long_sums, {**AXES, "seed": range(3)}, store=path).finished.all()
    same(run(long_sums, AXES), run(long_sums, {**AXES, "seed": range(3)}).isel(seed=slice(2)))
