"""A store to test with: its schema, values that tell the member, and processes that write to it."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.sweep.grid import Axis, make_chunks, make_grid
from ovibjax.sweep.schema import Schema, Variable
from ovibjax.sweep.store import open_dataset

CONFIG = {"model": "vib", "steps": 2000, "axes": {"beta": {"values": [0.001]}}}
AXES = {"seed": range(3), "beta": [0.1, 0.01], "kind": ["mean", "max", "none of them"]}
VARIABLES = {
    "error": Variable((2,), np.dtype("float32"), ("prefix",), "m"),
    "params.encoder_1.kernel": Variable((2, 3), np.dtype("float16"), ("prefix", "width")),
    "steps": Variable((), np.dtype("int32"), ()),
    "passed": Variable((), np.dtype("bool"), ()),
}
COORDS = {"prefix": Axis((1, 4), "bytes"), "width": Axis(("x", "y", "z"))}


def make_schema(axes=AXES, zipped=(), outer=0, rows=2, columns=4, variables=VARIABLES, coords=COORDS):
    grid = make_grid(axes, zipped)
    return Schema(grid, make_chunks(grid, outer, rows, columns), variables, coords)


def block(schema, chunk):
    """Values that tell the member, flat; padding holds something else."""
    members = schema.chunks.members[chunk].reshape(-1)
    arrays = {}
    for name, v in schema.variables.items():
        values = (members + 1).reshape(-1, *[1] * len(v.shape)) * (1 + np.arange(np.prod(v.shape)).reshape(v.shape))
        arrays[name] = (values % 2 == 1 if v.dtype == bool else values).astype(v.dtype)
    return arrays, members % 3 == 1


def fill(store, chunks):
    for chunk in chunks:
        store.write(chunk, *block(store.schema, chunk))


def check(path, schema, chunks):
    """Finished members hold their values and the rest is fill."""
    dataset = open_dataset(path)
    expected = {name: np.zeros((schema.grid.size, *v.shape), v.dtype) for name, v in schema.variables.items()}
    expected |= {"finished": np.zeros(schema.grid.size, bool), "diverged": np.zeros(schema.grid.size, bool)}
    for values in expected.values():
        values[...] = np.nan if values.dtype.kind == "f" else 0
    for chunk in chunks:
        members = schema.chunks.members[chunk].reshape(-1)
        arrays, diverged = block(schema, chunk)
        for name, values in {**arrays, "diverged": diverged, "finished": members >= 0}.items():
            expected[name][members[members >= 0]] = values[members >= 0]
    assert set(dataset.data_vars) == set(expected)
    for name, values in expected.items():
        assert dataset[name].dtype == values.dtype
        assert dataset[name].dims[: len(schema.grid.dims)] == schema.grid.dims
        np.testing.assert_array_equal(dataset[name].values.reshape(values.shape), values, err_msg=name)
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
from ovibjax.sweep.store import Store
from tests.sweep.stores import CONFIG, fill, make_schema
print("ready", flush=True)
sys.stdin.readline()
with Store.open(sys.argv[1], make_schema(rows=1, columns=2), CONFIG) as store:
    print("open", flush=True)
    {work}
"""
WAIT = "sys.stdin.read()"
WRITE = """
    while True:
        fill(store, [int(k) for k in (~store.finished()).nonzero()[0]] or sys.exit())
"""


def start(path, work):
    """A process that has loaded everything and waits for a word to open the store."""
    code = WRITER.format(root=str(Path(__file__).parents[2]), work=work.strip())
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, "-c", code, str(path)], text=True, **pipes)


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
