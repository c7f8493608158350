"""Coded frames: what is kept is what the codec gives, frame by frame; only what is missing is made again.

Small noise pictures stand in for the renderer, which has tests of its own.
"""

import numpy as np
import pytest

from ovibjax.errors import InputError
from ovibjax.features.backbones.by_name import open_backbone
from ovibjax.features.images.codecs import decode, encode
from ovibjax.world.town import coded as module
from ovibjax.world.town.coded import coded_town, usable
from ovibjax.world.town.layout import TownConfig
from ovibjax.world.town.render import Views

RUNGS = (("jpeg", 8), ("webp", 0))


def picture(frame):
    return np.random.default_rng(frame).integers(0, 256, (5, 30, 40, 3), np.uint8)


@pytest.fixture
def rendered(monkeypatch, tmp_path):
    """Frames that had to be rendered, in order."""
    made = []

    def render_frames(town, route, frames, camera):
        for frame in frames.tolist():
            made.append(frame)
            yield frame, Views((picture(frame) / 255).astype(np.float32), None, None)

    monkeypatch.setattr(module, "render_frames", render_frames)
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    return made


def code(frames, rungs=RUNGS, **options):
    return coded_town(TownConfig(), 60, np.array(frames), rungs, **options)


def test_features_and_payloads_are_those_of_the_codec(rendered):
    seen = []
    found = code([7, 3, 40, 3], on_frames=lambda *counts: seen.append(counts))
    backbone = open_backbone("embedded")

    def features(rgb):
        return backbone.embed(np.stack([backbone.preprocess(image) for image in rgb]))

    for row, frame in enumerate([7, 3, 40, 3]):
        np.testing.assert_allclose(found.plain[row], features(picture(frame)), atol=1e-6)
        for r, (codec, quality) in enumerate(RUNGS):
            payload = encode(codec, quality, picture(frame))
            assert found.payload_bytes[row, r] == len(payload)
            np.testing.assert_allclose(found.coded[row, r], features(decode(payload)), atol=1e-6)
    assert sorted(rendered) == [3, 7, 40] and seen[-1] == (3, 3)


def test_only_what_is_missing_is_made(rendered, tmp_path):
    first = code([1, 2, 3, 4, 5])
    assert sorted(rendered) == [1, 2, 3, 4, 5]
    rendered.clear()
    again = code([5, 9, 1])
    assert rendered == [9]
    np.testing.assert_array_equal(again.coded[[0, 2]], first.coded[[4, 0]])
    (folder,) = (tmp_path / "cache").iterdir()
    damaged = folder / "000002.npz"
    damaged.write_bytes(damaged.read_bytes()[:100])
    rendered.clear()
    np.testing.assert_array_equal(code([2]).coded, first.coded[1:2])
    assert rendered == [2]
    # Other qualities and other drives are kept apart.
    code([2], rungs=RUNGS[:1])
    code([2], route_seed=1)
    assert rendered == [2, 2, 2] and len(list((tmp_path / "cache").iterdir())) == 3


def test_an_error_keeps_what_was_finished(rendered, monkeypatch):
    whole = module.encode

    def failing(codec, quality, rgb):
        if rendered[-1] == 6:
            raise KeyboardInterrupt
        return whole(codec, quality, rgb)

    monkeypatch.setattr(module, "encode", failing)
    with pytest.raises(KeyboardInterrupt):
        code([1, 2, 6])
    monkeypatch.setattr(module, "encode", whole)
    rendered.clear()
    code([1, 2, 6])
    assert rendered == [6]


def test_without_the_extra_the_clips_are_left_out(monkeypatch):
    rungs = (*RUNGS, ("h264", 51), ("h265", 41))
    monkeypatch.setattr(module, "video_missing", lambda: "")
    assert usable(rungs) == (rungs, "")
    monkeypatch.setattr(module, "video_missing", lambda: "no av")
    assert usable(rungs) == (RUNGS, "no av")
    assert usable(RUNGS) == (RUNGS, "")


def test_cache_folder_that_cannot_be_made(rendered, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "file"))
    with pytest.raises(InputError, match="OVIBJAX_CACHE"):
        code([1])
