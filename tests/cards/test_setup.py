"""The card "The data" on somebody else's sets: several scenes, unknown contexts, four views."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.job import Job
from ovibjax.cards.workloads import sizes_claim, workload_rows, workloads
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


def test_all_seven_workloads_stand_beside_the_papers():
    rows = workloads(seed=100)
    assert [row.setting for row in rows if not row.equal] == ["Raw multi-scene data"] and len(rows) == 7
    assert all("," not in text for row in workload_rows(rows) for text in row.values())
    for row in rows:
        # Every number that is compared stands in what the reader sees.
        assert all(f"{size:g}" in row.paper.replace(".0", "") for size in row.paper_sizes), row.setting
        assert all(f"{size:g}" in row.ours.replace(".0", "") for size in row.our_sizes), row.setting
    assert sizes_claim(rows).ours == "6 of 7; not: Raw multi-scene data"
    smaller = [rows[0]._replace(our_sizes=(400, 280, 60, 60, 5)), *rows[1:]]
    assert sizes_claim(smaller).ours.startswith("5 of 7; not: Single-scene split")


def test_the_embedded_town_has_the_table_of_workloads_and_other_data_do_not(tmp_path, monkeypatch):
    card = load_card(cards_folder() / "setup.py")
    monkeypatch.setattr(card, "draw", lambda *args: None)
    rng = np.random.default_rng(0)
    features = make_feature_set(rng.normal(size=(240, 5, 9)), rng.uniform(-30, 30, (240, 3)))
    card.run(Job("setup", "smoke", tmp_path, 100, features, "embedded", None))
    with (tmp_path / "workloads.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 7
    assert "workloads.csv" in (tmp_path / "provenance.json").read_text()
    card.run(Job("setup", "smoke", tmp_path, 100, features, "mine.npz", None))
    assert not (tmp_path / "workloads.csv").exists()
    assert "workloads.csv" not in (tmp_path / "provenance.json").read_text()
