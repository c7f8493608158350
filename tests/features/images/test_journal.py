"""An extraction cut short: the same bytes in the end, however it was interrupted, and never mixed with another."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ovibjax.errors import InputError
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.extraction import extract
from tests.features.images.made_images import (
    N,
    embed,
    encode,
    listing,
    pixels,
    run,
    tiny_backbone,
    write,
    write_table,
)


def test_any_torn_state_ends_with_the_same_bytes(town, whole, tmp_path):
    """Every prefix of index and blocks that a kill or a power cut can leave behind."""
    _, expected, kept = whole
    index, blocks = (kept / "index.jsonl").read_bytes(), (kept / "blocks.f32").read_bytes()
    ends = [0, *(at + 1 for at, byte in enumerate(index) if byte == ord("\n"))]
    assert len(ends) == 7
    states = [(cut + shift, len(blocks)) for cut in ends for shift in (-1, 0, 1, 40) if 0 <= cut + shift <= len(index)]
    states += [(len(index), size) for size in (0, 1, 239, 240, 241, 700, len(blocks) - 1)]
    states += [(ends[3], 2 * 5 * 6 * 4 * 3), (ends[3], 2 * 5 * 6 * 4 * 3 + 11), (ends[3], 5)]
    for number, (index_bytes, block_bytes) in enumerate(states):
        out = tmp_path / f"{number}.npz"
        partial = shutil.copytree(kept, f"{out}.partial")
        (Path(partial) / "index.jsonl").write_bytes(index[:index_bytes])
        (Path(partial) / "blocks.f32").write_bytes(blocks[:block_bytes])
        done = run(town, out)
        assert out.read_bytes() == expected, (index_bytes, block_bytes)
        assert len(done.failed) == 1 and not Path(partial).exists()


@pytest.mark.parametrize("damage", ["no config", "no index", "flipped bit", "zeros after a power cut"])
def test_damage_is_found_and_made_good(town, whole, tmp_path, damage):
    _, expected, kept = whole
    partial = Path(shutil.copytree(kept, tmp_path / "x.npz.partial"))
    blocks = bytearray((partial / "blocks.f32").read_bytes())
    if damage == "no config":
        # A kill between making the folder and writing into it.
        for file in partial.iterdir():
            file.unlink()
    elif damage == "no index":
        (partial / "index.jsonl").unlink()
    elif damage == "flipped bit":
        blocks[500] ^= 1
        (partial / "blocks.f32").write_bytes(blocks)
    else:
        (partial / "blocks.f32").write_bytes(blocks[:480] + bytes(len(blocks) - 480))
    assert run(town, tmp_path / "x.npz").resumed == {"flipped bit": 4, "zeros after a power cut": 4}.get(damage, 0)
    assert (tmp_path / "x.npz").read_bytes() == expected


COMMAND = """
import sys, time
import ovibjax.features.backbones.by_name as backbone
from ovibjax.cli.main import main
from tests.features.images.made_images import embed, tiny_backbone

def slow(inputs):
    time.sleep(pause)
    return embed(inputs)

pause = float(sys.argv.pop())
backbone.open_backbone = lambda spec, options=None: tiny_backbone(embed=slow)
main()
"""


def test_sigkill_then_the_same_command_gives_the_identical_file(tmp_path):
    """The real command in a process of its own, killed twice while it works."""
    write_table(tmp_path, 40)
    command = [sys.executable, "-c", COMMAND, "features", "my.csv", "--images", "images/{view}/{frame}.png"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}

    def start(out, pause):
        arguments = [*command, "--out", out, "--batch", "2", pause]
        return subprocess.Popen(arguments, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)

    def finished():
        index = tmp_path / "killed.npz.partial" / "index.jsonl"
        return index.read_bytes().count(b"\n") if index.exists() else 0

    for batches in (3, 9):
        process = start("killed.npz", "0.2")
        until = time.monotonic() + 200
        while finished() < batches and time.monotonic() < until:
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL and 20 > finished() >= batches
    assert not (tmp_path / "killed.npz").exists()
    _, said = (process := start("killed.npz", "0")).communicate()
    assert process.returncode == 0, said
    assert "of them from the interrupted run" in said and "kept 40 of 40 frames" in said
    source = open_source(tmp_path / "my.csv", "images/{view}/{frame}.png")
    extract(source, tiny_backbone(), tmp_path / "whole.npz", batch=2)
    assert (tmp_path / "killed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["images", "killed.npz", "my.csv", "whole.npz"]


def test_ctrl_c_keeps_finished_batches_and_says_so(town, whole, tmp_path):
    calls = []

    def interrupted(inputs):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return embed(inputs)

    with pytest.raises(KeyboardInterrupt, match=r"6 of 11 frames are kept in .*x\.npz\.partial: repeat the command"):
        run(town, tmp_path / "x.npz", tiny_backbone(embed=interrupted))
    assert run(town, tmp_path / "x.npz").resumed == 6
    assert (tmp_path / "x.npz").read_bytes() == whole[1]
    calls[:] = [1, 1, 1]
    with pytest.raises(KeyboardInterrupt, match="nothing was written"):
        run(town, tmp_path / "y.npz", tiny_backbone(embed=interrupted))
    assert listing(tmp_path) == ["x.npz"]


def test_another_configuration_is_refused_with_what_differs(town, whole, tmp_path):
    def other_town(name, change):
        change(Path(shutil.copytree(town, tmp_path / name)))
        return tmp_path / name

    metadata = "metadata/000001.json"
    moved = other_town("moved", lambda r: write(r / metadata, (r / metadata).read_bytes().replace(b"-2.5", b"-2.6")))
    resized = other_town("resized", lambda r: write(r / "rgb/Back/000001.png", encode(pixels(1, 1, width=13))))
    fewer = other_town("fewer", lambda r: (r / metadata).unlink())
    shutil.copytree(whole[2], tmp_path / "x.npz.partial")
    before = {file: file.read_bytes() for file in (tmp_path / "x.npz.partial").iterdir()}
    cases = [
        (town, {"batch": 3}, "--batch was 2, is 3"),
        (town, {"backbone": tiny_backbone("large")}, "backbone was tiny, is large"),
        (town, {"backbone": tiny_backbone(fingerprint="01")}, "weights or preprocessing was 00, is 01"),
        (moved, {}, "images and poses was"),
        (resized, {}, "images and poses was"),
        (fewer, {}, "frames was 11, is 10"),
    ]
    for where, options, words in cases:
        with pytest.raises(InputError, match=words):
            run(where, tmp_path / "x.npz", **options)
    assert {file: file.read_bytes() for file in (tmp_path / "x.npz.partial").iterdir()} == before
    # The place of the images does not matter, nor does the order of the attempts.
    assert run(shutil.copytree(town, tmp_path / "elsewhere"), tmp_path / "x.npz").resumed == N


def test_a_folder_of_something_else_is_left_alone(town, tmp_path):
    write(tmp_path / "x.npz.partial" / "thesis.tex", b"precious")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        run(town, tmp_path / "x.npz")
    assert listing(tmp_path / "x.npz.partial") == ["thesis.tex"]
    write(tmp_path / "y.npz.partial", b"a file")
    with pytest.raises(InputError, match="cannot be written"):
        run(town, tmp_path / "y.npz")


def test_two_processes_do_not_share_a_folder(town, tmp_path):
    def again(done, total):
        with pytest.raises(InputError, match=r"process \d+ on host .* is working on it"):
            run(town, tmp_path / "x.npz")

    run(town, tmp_path / "x.npz", on_frames=again)
