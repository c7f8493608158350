"""A store to test with: its layout, values that tell the member, and processes that write to it."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, make_grid
from ovibjax.sweep.layout import Variable, layout_of
from ovibjax.sweep.members import rows_of
from ovibjax.sweep.store import Store, attach, open_dataset

CONFIG = {"model": "vib", "steps": 2000, "rates": {"beta": [0.001]}}
AXES = {"seed": range(3), "beta": [0.01, 0.1], "kind": ["mean", "max", "none of them"]}
VARIABLES = {
    "error": Variable((2,), np.dtype("float32"), ("prefix",), "m"),
    "params.encoder_1.kernel": Variable((2, 3), np.dtype("float16"), ("prefix", "width")),
    "steps": Variable((), np.dtype("int32"), ()),
    "passed": Variable((), np.dtype("bool"), ()),
}
COORDS = {"prefix": Axis((1, 4), "bytes"), "width": Axis(("x", "y", "z"))}
DIGEST = bytes(range(16))


def make_layout(axes=AXES, zipped=(), variables=VARIABLES, coords=COORDS):
    return layout_of(make_grid(axes, zipped), variables, coords)


def make_rows(members, axes=AXES, zipped=(), variables=VARIABLES, digest=DIGEST):
    """Values that tell the member."""
    members, outputs = np.asarray(members, int), {}
    for name, v in variables.items():
        values = (members + 1).reshape(-1, *[1] * len(v.shape)) * (1 + np.arange(np.prod(v.shape)).reshape(v.shape))
        outputs[name] = (values % 2 == 1 if v.dtype == bool else values).astype(v.dtype)
    return rows_of(make_grid(axes, zipped), members, [digest] * len(members), outputs, members % 3 == 1)


def opened(path, config=CONFIG, **options):
    return Store.open(path, make_layout(**options), config)


def begun(path, members, **options):
    """A closed store with some members, in one file."""
    with opened(path, **options) as store:
        if len(members):
            store.add(make_rows(members, **{k: v for k, v in options.items() if k != "coords"}))
    return path


def blocks(path):
    return sorted((Path(path) / "members").glob("*.npy"))


def members_of(path):
    """Flat indices into the grid of `AXES` of the members that are there."""
    store = attach(path)
    store.read()
    return np.flatnonzero(store.dataset(make_grid(AXES)).finished.values).tolist()


def check(path, members, axes=AXES, zipped=(), variables=VARIABLES):
    """Finished members hold their values and the rest is fill; the whole store holds nothing else."""
    grid, store = make_grid(axes, zipped), attach(path)
    store.read()
    dataset, rows = store.dataset(grid), make_rows(sorted(members), axes, zipped, variables)
    at = np.array(sorted(members), int)
    expected = {name: np.zeros((grid.size, *v.shape), v.dtype) for name, v in variables.items()}
    expected |= {"finished": np.zeros(grid.size, bool), "diverged": np.zeros(grid.size, bool)}
    for name, values in expected.items():
        values[...] = np.nan if values.dtype.kind == "f" else 0
        values[at] = True if name == "finished" else rows["diverged" if name == "diverged" else f"out.{name}"]
    assert set(dataset.data_vars) == set(expected)
    for name, values in expected.items():
        assert dataset[name].dtype == values.dtype and dataset[name].dims[: len(grid.dims)] == grid.dims
        np.testing.assert_array_equal(dataset[name].values.reshape(values.shape), values, err_msg=name)
    assert int(open_dataset(path).finished.sum()) == len(at)
    return dataset


def snapshot(path):
    return {p: p.read_bytes() for p in sorted(Path(path).rglob("*")) if p.is_file()}


def refusal(function, *args, **options):
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 500, message
    return message


WRITER = """
import sys
sys.path.insert(0, {root!r})
from tests.sweep.stores import make_rows, opened
from ovibjax.sweep import writer
writer._WAIT_S = float(sys.argv[2])
print("ready", flush=True)
sys.stdin.readline()
with opened(sys.argv[1]) as store:
    store.lock()
    print("open", flush=True)
    {work}
"""
WAIT = "sys.stdin.read()"
WRITE = """
    import time
    lacking = [k for k in range(18) if store.rows is None or k + 1 not in store.rows["out.steps"]]
    for k in lacking:
        store.add(make_rows([k]))
        time.sleep(0.01)
"""


def start(path, work, wait_s=0.0):
    """A process that has loaded everything and waits for a word to open the store."""
    code = WRITER.format(root=str(Path(__file__).parents[2]), work=work.strip())
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, "-c", code, str(path), str(wait_s)], text=True, **pipes)


def go(process, wait=True):
    line = process.stdout.readline()
    assert line == "ready\n", process.communicate()[1]
    process.stdin.write("go\n")
    process.stdin.flush()
    if wait:
        line = process.stdout.readline()
        assert line == "open\n", process.communicate()[1]


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()
