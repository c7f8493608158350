"""The recipes of CONTRIBUTING.md, followed to the letter in a copy of the code, and then tried."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import features

from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set
from tests.features.images.made_images import write_table

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
RECIPES = {part.partition("\n")[0]: part for part in TEXT.partition("## Recipes")[2].split("\n### ")[1:]}
STEP = re.compile(
    r"(?:A new file, )?`([\w./]+\.py)`(?:, (before|in place of) `([^`\n]+)`)?:\n\n```python\n(.*?)```", re.DOTALL
)
MOST_LINES = 14

TRY_POLICY = """
from tests.control.cases import *
params = ControlParams(environment(), make_controller(ACTIONS))
print("asked", int(replay.replay(jax.random.key(0), make_route(1), "late", params).sent.sum()))
"""

TRY_CODEC = """
import numpy as np
from ovibjax.cards.compression_drawing import CODEC_COLOURS, CODEC_MARKERS
from ovibjax.features.images.codecs import CODECS, LADDERS, decode, encode
views = np.tile(np.linspace(0, 255, 64, dtype=np.uint8)[:, None, None], (5, 1, 48, 3))
sizes = [len(encode("avif", quality, views)) for quality in LADDERS["avif"]]
shown = decode(encode("avif", LADDERS["avif"][-1], views))
assert shown.shape == views.shape and np.abs(shown.astype(int) - views).mean() < 4
assert set(CODECS) == set(LADDERS) == set(CODEC_COLOURS) == set(CODEC_MARKERS)
print("coded", sizes)
"""


def follow(name, copy):
    """Carry out the steps of a recipe in a copy of the code."""
    for folder in ("ovibjax", "sweeps"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", copy)
    steps = STEP.findall(RECIPES[name])
    assert steps
    for file, how, anchor, code in steps:
        path = copy / file
        if not how:
            assert not path.exists()
            path.write_text(code)
            continue
        text = path.read_text()
        assert text.count(anchor) == 1, f"{file} has {text.count(anchor)} places with {anchor!r}"
        path.write_text(text.replace(anchor, code + anchor if how == "before" else code.rstrip("\n")))


@pytest.fixture
def tried(tmp_path):
    """Follows a recipe and runs Python in the copy; gives what it prints."""

    def run(name, *arguments):
        copy = tmp_path / "copy"
        follow(name, copy)
        env = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(copy), str(ROOT)]),
            "OVIBJAX_CACHE": str(tmp_path / "cache"),
        }
        done = subprocess.run(
            [sys.executable, *map(str, arguments)], cwd=copy, env=env, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr[-3000:]
        return done.stdout

    return run


@pytest.mark.slow
def test_a_request_policy(tried):
    assert int(tried("A request policy", "-c", TRY_POLICY).split()[-1]) > 0


@pytest.mark.skipif(not features.check("avif"), reason="this Pillow has no AVIF")
@pytest.mark.slow
def test_an_image_codec(tried):
    sizes = [int(size) for size in re.findall(r"\d+", tried("An image codec", "-c", TRY_CODEC))]
    assert sizes == sorted(sizes)


@pytest.mark.slow
def test_a_card(tried, tmp_path):
    rng = np.random.default_rng(0)
    place_m = rng.uniform(1, 50, (240, 3))
    save(tmp_path / "mine.npz", make_feature_set(rng.normal(size=(240, 5, 8)), place_m))
    options = ("reproduce", "--sweep", "mine.py", "--data", tmp_path / "mine.npz", "--out", tmp_path / "out")
    tried("A card", "-m", "ovibjax", *options)
    assert (tmp_path / "out" / "mine" / "figure.png").stat().st_size > 1000
    page = (tmp_path / "out" / "index.html").read_text()
    assert "Every frame is above ground" in page and "Heights" in page


@pytest.mark.slow
def test_a_backbone(tried, tmp_path):
    table = write_table(tmp_path / "images")
    options = ("--images", "images/{view}/{frame}.png", "--backbone", "colours", "--out", tmp_path / "mine.npz")
    tried("A backbone", "-m", "ovibjax", "features", table, *options)
    with np.load(tmp_path / "mine.npz") as found:
        assert found["features"].shape == (3, 5, 192)


def test_recipes_are_short_and_all_are_tried():
    assert list(RECIPES) == ["A request policy", "An image codec", "A card", "A backbone"]
    for name, text in RECIPES.items():
        code = "".join(step[3] for step in STEP.findall(text))
        assert sum(bool(line.strip()) for line in code.splitlines()) <= MOST_LINES, name
        assert text.count("```python") == len(STEP.findall(text)), name


def test_commands_and_files_that_are_named_exist():
    markers = (ROOT / "pyproject.toml").read_text()
    for marker in re.findall(r"-m (\w+)`", TEXT):
        assert f'"{marker}: ' in markers, marker
    for file in re.findall(r"`((?:ovibjax|sweeps|tests|results)/[\w./]*)`", TEXT):
        assert (ROOT / file).exists() or Path(file).name in ("colours.py", "page.png"), file
