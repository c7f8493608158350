"""Tables of members on disk: read as they were written, or named as damaged."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ovibjax.sweep.blocks import count_members, read_blocks, remove_abandoned, write_block
from tests.sweep.stores import refusal, snapshot

COLUMNS = {"out.y": (np.dtype(np.float32), (2,))}


def table(count=3, **more):
    fields = {"value.x": np.linspace(0, 1, count), "out.y": np.arange(2 * count, dtype=np.float32).reshape(count, 2)}
    fields |= more
    rows = np.empty(count, [(name, values.dtype, values.shape[1:]) for name, values in fields.items()])
    for name, values in fields.items():
        rows[name] = values
    return rows


def same(one, other):
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"value.kind": np.array(["a", "bcd", "ä"])},
        {"out.β": np.ones(3, np.float16)},
        {f"out.a_long_name_of_an_output_{i}": np.ones(3, np.int8) for i in range(1500)},
    ],
    ids=["numbers", "names", "a Greek column", "header beyond 65,535 bytes"],
)
def test_round_trip(tmp_path, more):
    rows = table(**more)
    write_block(tmp_path, rows)
    (found,) = read_blocks(tmp_path, COLUMNS)
    assert same(found, rows)


def test_equal_blocks_are_one_file_and_others_are_apart(tmp_path):
    one, again = write_block(tmp_path, table()), write_block(tmp_path, table())
    other = write_block(tmp_path, table(**{"out.z": np.zeros(3)}))
    longer = write_block(tmp_path, table(5))
    assert one == again and len({one, other, longer}) == 3
    assert len(list(tmp_path.iterdir())) == 3 and count_members(tmp_path) == 11
    assert sorted(len(rows) for rows in read_blocks(tmp_path, COLUMNS)) == [3, 3, 5]


def spoil(path, how):
    data = path.read_bytes()
    if how == "folder":
        path.unlink()
        path.mkdir()
    else:
        kinds = {"flip": data[:-5] + bytes([data[-5] ^ 1]) + data[-4:], "cut": data[:-1], "empty": b"", "text": b"text"}
        path.write_bytes(kinds[how])


@pytest.mark.parametrize("how", ["flip", "cut", "empty", "text", "folder"])
def test_a_damaged_block_is_named_and_can_be_removed(tmp_path, how):
    write_block(tmp_path, table())
    path = write_block(tmp_path, table(4))
    spoil(path, how)
    message = refusal(lambda: list(read_blocks(tmp_path, COLUMNS)))
    assert "is damaged" in message and "to compute its members again" in message
    named = Path(message.split(" is damaged")[0])
    assert named == path
    named.rmdir() if named.is_dir() else named.unlink()
    assert [len(rows) for rows in read_blocks(tmp_path, COLUMNS)] == [3]


def test_a_block_of_another_table_is_refused(tmp_path):
    write_block(tmp_path, table())
    for columns in ({"out.z": (np.dtype(np.float32), ())}, {"out.y": (np.dtype(np.float64), (2,))}):
        assert "another table than the store says" in refusal(
            lambda columns=columns: list(read_blocks(tmp_path, columns))
        )


def test_objects_are_never_unpickled(tmp_path):
    rows = np.array([({},)], [("out.y", object)])
    with pytest.raises(ValueError):
        write_block(tmp_path, rows)
    assert not list(tmp_path.iterdir())


def test_what_is_half_written_is_not_read_and_goes_with_its_process(tmp_path):
    host = socket.gethostname()
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = {
        "of a process that is no more": f"3-{'0' * 24}.npy.{host}-{dead.pid}.partial",
        "of one that lives": f"3-{'0' * 24}.npy.{host}-{os.getpid()}.partial",
        "of another machine": f"3-{'0' * 24}.npy.elsewhere-{dead.pid}.partial",
        "of a machine whose name ends like this one's": f"3-{'0' * 24}.npy.far-{host}-{dead.pid}.partial",
        "somebody's notes": "notes.txt",
    }
    for name in names.values():
        (tmp_path / name).write_bytes(b"half")
    write_block(tmp_path, table())
    assert len(list(read_blocks(tmp_path, COLUMNS))) == 1 and count_members(tmp_path) == 3
    before = set(snapshot(tmp_path))
    remove_abandoned(tmp_path)
    assert before - set(snapshot(tmp_path)) == {tmp_path / names["of a process that is no more"]}
