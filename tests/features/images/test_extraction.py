"""Images to features: the right numbers, and the same bytes whenever and however the work was cut short."""

import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.backbones.by_name import open_backbone
from ovibjax.features.backbones.pyramid import embed as pyramid
from ovibjax.features.backbones.pyramid import embedded_backbone
from ovibjax.features.feature_files import load
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.extraction import extract
from ovibjax.runtime.threads import in_order
from tests.features.images.made_images import (
    embed,
    encode,
    pixels,
    preprocess,
    tiny_backbone,
    write,
    write_layout,
    write_table,
)

N, BATCH = 11, 2


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Eleven frames, one of which does not decode."""
    root = write_layout(tmp_path_factory.mktemp("images") / "town", N)
    broken = root / "rgb/Right/000005.png"
    broken.write_bytes(broken.read_bytes()[:60])
    return root


@pytest.fixture(scope="module")
def whole(town, tmp_path_factory):
    """The final file of an extraction that nothing disturbed, its bytes, and its partial folder."""
    out = tmp_path_factory.mktemp("whole") / "x.npz"
    kept = out.with_name("kept")

    def keep(done, total):
        if done == total:
            shutil.copytree(f"{out}.partial", kept)

    run(town, out, on_frames=keep)
    return out, out.read_bytes(), kept


def run(town, out, backbone=None, **options):
    source = open_source(town)
    try:
        return extract(source, backbone or tiny_backbone(), out, **{"batch": BATCH, **options})
    finally:
        source.close()


def listing(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_features_are_those_of_the_images(town, whole):
    made = load(whole[0])
    rows = [row for row in range(N) if row != 5]
    assert made.frame_id.tolist() == [f"{row:06d}" for row in rows]
    assert made.positions_m[3].tolist() == [9, -7.5, 30] and made.yaw_rad[3] == pytest.approx(np.pi / 4)
    for at, row in enumerate(rows):
        raw = np.concatenate([embed(preprocess(pixels(row, view))[None]) for view in range(5)])
        np.testing.assert_allclose(made.features[at], raw / np.linalg.norm(raw, axis=1, keepdims=True), atol=1e-5)


def test_what_does_not_decode_is_named_and_refused_if_strict(town, tmp_path):
    done = run(town, tmp_path / "x.npz")
    assert [(one.frame_id, one.reason) for one in done.failed] == [("000005", "an image does not decode")]
    assert done.failed[0].detail.startswith("rgb/Right/000005.png: corrupt or truncated")
    assert done.resumed == 0 and listing(tmp_path) == ["x.npz"]
    with pytest.raises(InputError, match="1 frame refused: 1 an image does not decode"):
        run(town, tmp_path / "y.npz", strict=True)
    # Finished batches are kept; without --strict the same command goes on.
    assert run(town, tmp_path / "y.npz").resumed == 4
    assert (tmp_path / "y.npz").read_bytes() == (tmp_path / "x.npz").read_bytes()


def test_the_batch_is_always_full_and_frames_keep_their_place(town, tmp_path):
    seen = []

    def watch(inputs):
        seen.append(inputs.copy())
        return embed(inputs)

    run(town, tmp_path / "x.npz", tiny_backbone(embed=watch), batch=4)
    assert [inputs.shape for inputs in seen] == [(20, 4, 4, 3)] * 3
    np.testing.assert_array_equal(seen[1][10], preprocess(pixels(6, 0)))
    assert not seen[1][5:10].any() and not seen[2][15:].any()


def test_the_embedded_backbone_sees_the_whole_image():
    backbone = open_backbone("embedded")
    y, x = np.mgrid[:96, :128]
    image = np.stack([x, y, 127 + 60 * np.sin(x / 20) * np.cos(y / 15)], axis=-1).astype(np.uint8)
    small = image.reshape(48, 2, 64, 2, 3).mean(axis=(1, 3)) / 255
    np.testing.assert_allclose(backbone.preprocess(image), small, atol=2 / 255)
    got = backbone.embed(np.stack([backbone.preprocess(image)]))
    np.testing.assert_allclose(got, pyramid(embedded_backbone(), small[None].astype(np.float32)), atol=0.02)
    assert backbone.name == "embedded" and len(backbone.fingerprint) >= 16
    with pytest.raises(InputError, match="embedded"):
        open_backbone("resnet")


# --- cut short ---------------------------------------------------------------------------------------------


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


# --- another configuration ---------------------------------------------------------------------------------


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
        with pytest.raises(InputError, match="another process is working on it"):
            run(town, tmp_path / "x.npz")

    run(town, tmp_path / "x.npz", on_frames=again)


def test_features_that_mean_nothing_leave_their_frame_out(town, tmp_path):
    def odd(inputs):
        features = embed(inputs)
        features[0], features[7] = np.nan, 0
        return features

    failed = run(town, tmp_path / "x.npz", tiny_backbone(embed=odd), batch=20).failed
    assert [one.detail for one in failed[1:]] == [
        f"rgb/{v}: zero or not finite" for v in ("Front/000000.png", "Left/000001.png")
    ]
    with pytest.raises(InputError, match="features of shape"):
        run(town, tmp_path / "y.npz", tiny_backbone(embed=lambda inputs: embed(inputs)[1:]))
    with pytest.raises(InputError, match="no usable frame"):
        run(town, tmp_path / "y.npz", tiny_backbone(embed=lambda inputs: 0 * embed(inputs)))
    assert listing(tmp_path) == ["x.npz"]


def test_in_order_keeps_order_and_bounds_what_waits():
    started, most, lock = [], 0, threading.Lock()

    def work(item):
        with lock:
            started.append(item)
        time.sleep(0.001 * (item % 3))
        return item * item

    taken = []
    for result in in_order(work, range(50), ahead=5):
        with lock:
            most = max(most, len(started) - len(taken))
        taken.append(result)
    assert taken == [item * item for item in range(50)] and most <= 6
    results = in_order(work, range(1000), ahead=4)
    next(results)
    results.close()
    assert len(started) < 70


def test_large_images_are_refused_without_a_warning(town, tmp_path):
    root = Path(shutil.copytree(town, tmp_path / "town"))
    header = bytearray(encode(pixels(0)))
    header[16:24] = struct.pack(">II", 10_000, 10_000)
    header[29:33] = struct.pack(">I", zlib.crc32(bytes(header[12:29])))
    write(root / "rgb/Front/000000.png", bytes(header))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        failed = run(root, tmp_path / "x.npz").failed
    assert "10000 x 10000 pixels" in failed[0].detail
