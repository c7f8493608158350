"""The card "The data" on somebody else's sets: several scenes, unknown contexts, four views."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.job import Job
from ovibjax.features.frames import make_feature_set


@pytest.mark.parametrize(
    ("scenes", "n_views", "setting"), [(1, 4, "Indoor UGV"), (1, 5, "Town05"), (14, 5, "CARLA UAV")]
)
def test_table_and_picture(tmp_path, scenes, n_views, setting):
    rng = np.random.default_rng(0)
    n = 280
    features = make_feature_set(
        rng.normal(size=(n, n_views, 9)),
        rng.uniform(-30, 30, (n, 3)),
        scene_id=np.arange(n) % scenes,
        context=rng.integers(-1, 3, n),
    )
    load_card(cards_folder() / "setup.py").run(Job("setup", "smoke", tmp_path, 100, features, "mine.npz", None))
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["scene", "quantity", "unit", "ours", "paper"]
    names = {row["scene"] for row in rows}
    assert names == ({"all"} if scenes == 1 else {"all", *map(str, range(scenes))})
    whole = {row["quantity"]: row for row in rows if row["scene"] == "all"}
    assert whole["scenes"]["ours"] == str(scenes) and whole["frames"]["ours"] == str(n)
    assert whole["views"]["ours"] == whole["views"]["paper"] == str(n_views)
    shares = [float(whole[name]["ours"]) for name in ("corridor", "intersection", "repetitive", "unknown context")]
    assert sum(shares) == pytest.approx(100, abs=0.3) and shares[3] > 0
    facts = json.loads((tmp_path / "provenance.json").read_text())
    assert facts["setting"] == setting and ("first 12 of 14" in facts["caption"]) == (scenes == 14)
    with Image.open(tmp_path / "figure.png") as picture:
        assert picture.width >= 1000
