"""A small data set and what an undisturbed extraction makes of it."""

import shutil

import pytest

from tests.features.images.made_images import N, run, write_layout


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
