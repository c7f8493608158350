"""The card of the motion-capture protocol on somebody's own references and queries, and what it refuses."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ovibjax.cards.loading import load_pair
from ovibjax.cards.reproduce import reproduce
from ovibjax.errors import InputError
from ovibjax.features.feature_files import save
from tests.edge.cases import some_frames


def write_pair(folder: Path, n_views: int = 4, references: int = 24, queries: int = 8) -> list[Path]:
    paths = [folder / "ref.npz", folder / "query.npz"]
    save(paths[0], some_frames(references, 1, n_views))
    save(paths[1], some_frames(queries, 2, n_views))
    return paths


@pytest.mark.parametrize("n_views", [4, pytest.param(5, marks=pytest.mark.long)])
def test_somebodys_references_and_queries(tmp_path, monkeypatch, n_views):
    monkeypatch.setenv("OVIBJAX_CACHE", str(tmp_path / "cache"))
    pair = write_pair(tmp_path, n_views)
    reproduce("smoke", only=["real_scene"], out=tmp_path / "out", data=pair, seed=7)
    folder = tmp_path / "out" / "real_scene"
    with (folder / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    modes = ["F", "FS", "H4", "A5"][: n_views - 1]
    assert {row["mode"] for row in rows} == set(modes) and {row["seed"] for row in rows} == {"", "7"}
    assert len(rows) == len(modes) * 8
    raw = {row["mode"]: int(row["payload_bytes"]) for row in rows if row["method"] == "retrieval"}
    assert raw[modes[-1]] == 4 * 10 * n_views and raw["F"] == 40
    assert {row["k"]: row["payload_bytes"] for row in rows if row["method"] == "ovib"}["32"] == "148"
    for row in rows:
        values = [float(row[name]) for name in ("mean_m", "p90_m", "recall_0.5m", "eta", "floor_m")]
        assert np.isfinite(values).all()
        if row["method"] == "retrieval":
            assert values[0] >= values[4] - 1e-5  # retrieval cannot beat the nearest reference
    claims = json.loads((folder / "claims.json").read_text())
    assert len(claims) == 7 and all(claim["statement"].startswith(("UGV", "UAV")) for claim in claims)
    with Image.open(folder / "figure.png") as picture:
        assert picture.width > 1000
    facts = json.loads((folder / "provenance.json").read_text())
    assert facts["data"] == "ref.npz" and "24 references / 8 queries" in facts["frames"]


def test_data_that_do_not_fit_are_refused_in_one_line(tmp_path):
    ref, query = write_pair(tmp_path)
    save(tmp_path / "five.npz", some_frames(9, 2, 5))
    save(tmp_path / "few.npz", some_frames(19, 2))
    save(tmp_path / "three.npz", some_frames(3, 2))
    out = tmp_path / "out"
    for data, only, word in (
        ([ref], ["real_scene"], "REF QUERY"),
        ([ref, query], [], "--only real_scene"),
        ([ref, query], ["theorem"], "--only real_scene"),
        ([ref, query], ["real_scene", "theorem"], "--only real_scene"),
        ([ref, query, query], ["real_scene"], "3 were given"),
        ([ref, tmp_path / "absent.npz"], ["real_scene"], "absent.npz"),
        ([ref, tmp_path / "five.npz"], ["real_scene"], "5 views"),
        ([tmp_path / "few.npz", query], ["real_scene"], "20 frames"),
        ([ref, tmp_path / "three.npz"], ["real_scene"], "5 frames"),
    ):
        with pytest.raises(InputError, match=word) as refused:
            reproduce("smoke", only=only, out=out, data=data)
        assert "\n" not in str(refused.value)
    assert not out.exists()


def test_a_pair_is_read_as_it_is(tmp_path):
    references, queries = load_pair(write_pair(tmp_path), seed=0)
    assert queries is not None
    np.testing.assert_array_equal(references.features, some_frames(24, 1).features)
    np.testing.assert_array_equal(queries.positions_m, some_frames(8, 2).positions_m)
