"""Cards run end to end: the smallest preset, somebody else's data, and what their data do not allow."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ovibjax.cards import catalog
from ovibjax.cards.catalog import card_names
from ovibjax.cards.reproduce import reproduce
from ovibjax.errors import InputError
from ovibjax.features.feature_files import save
from ovibjax.features.frames import make_feature_set
from tests.cli.cases import ovibjax

TABLE_COLUMNS = ["method", "k", "seed", "payload_bytes", "mean_m", "p90_m", "eta"]
METHODS = {"ovib", "ovib_fixed", "ovib_recoded", "vib", "pca", "pca_completed", "pca_recoded", "raw"}


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def write_set(path: Path, n: int = 240, n_views: int = 5, dim: int = 24) -> None:
    rng = np.random.default_rng(0)
    position = rng.uniform(-50, 50, (n, 3)).astype(np.float32)
    mix = rng.normal(size=(3, n_views * dim))
    features = np.tanh(position @ mix / 30).reshape(n, n_views, dim) + 0.05 * rng.normal(size=(n, n_views, dim))
    save(path, make_feature_set(features, position))


def check_outputs(folder: Path) -> list[dict[str, str]]:
    with (folder / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == TABLE_COLUMNS
    for row in rows:
        assert np.isfinite([float(row[name]) for name in ("payload_bytes", "mean_m", "p90_m", "eta")]).all()
    assert {row["method"] for row in rows} == METHODS
    assert len({(row["method"], row["k"], row["seed"]) for row in rows}) == len(rows)
    for seed in {row["seed"] for row in rows}:
        ks = [int(row["k"]) for row in rows if row["method"] == "ovib" and row["seed"] == seed]
        assert ks == list(range(1, 129))
    for name in ("overhead.csv", "claims.json", "provenance.json"):
        assert (folder / name).stat().st_size > 0
    with Image.open(folder / "figure.png") as picture:
        assert picture.width >= 1000
    assert (folder.parent / "README.md").read_text().count("scalable_compression") > 1
    return rows


GROUPS = (
    ("scalable_compression", "encoder_ablation", "single_scene_ib", "setup"),
    ("voi_predictor", "request_control", "view_rate_selection", "voi_timing", "adaptation", "multi_client", "weights"),
    ("system_grid", "walkthrough", "theorem", "retrieval", "real_scene", "bytes", "live"),
)


def test_every_card_is_in_a_group() -> None:
    assert sorted(name for group in GROUPS for name in group) == card_names()


@pytest.mark.long
@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0])
def test_smoke_preset_makes_every_figure(names: tuple[str, ...], tmp_path: Path, cache: Path) -> None:
    done = ovibjax("reproduce", "--preset", "smoke", "--only", *names, cache=cache, cwd=tmp_path, timeout=1800)
    assert done.returncode == 0, done.stderr
    for name in names:
        assert (tmp_path / "results" / name / "figure.png").exists()
    if "scalable_compression" not in names:
        return
    rows = check_outputs(tmp_path / "results" / "scalable_compression")
    raw = [row for row in rows if row["method"] == "raw"]
    assert {int(row["payload_bytes"]) for row in raw} == {4 * 5 * 512}
    with (tmp_path / "results" / "scalable_compression" / "codec.csv").open() as file:
        coded = list(csv.DictReader(file))
    assert list(coded[0]) == ["codec", "quality", "seed", "payload_bytes", "mean_m", "p90_m", "encode_ms"]
    assert {row["codec"] for row in coded} >= {"jpeg"} and min(float(row["payload_bytes"]) for row in coded) > 500
    ovib = {int(row["k"]): int(row["payload_bytes"]) for row in rows if row["method"] == "ovib"}
    assert ovib[16] == 84 and ovib[35] == 160
    facts = json.loads((tmp_path / "results" / "scalable_compression" / "provenance.json").read_text())
    assert facts["preset"] == "smoke" and facts["seeds"] == "100 101"


@pytest.mark.slow
def test_somebody_elses_feature_set(tmp_path: Path, cache: Path) -> None:
    n_views, dim = 4, 100
    write_set(tmp_path / "mine.npz", n_views=n_views, dim=dim)
    out = tmp_path / "out"
    done = ovibjax(
        *("reproduce", "--preset", "smoke", "--only", "scalable_compression", "--data", "mine.npz", "--out", str(out)),
        *("--seed", "3"),
        cache=cache,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    rows = check_outputs(out / "scalable_compression")
    assert {row["seed"] for row in rows} == {"3", "4"}
    assert {int(row["k"]) for row in rows if row["method"] == "raw"} == {n_views * dim}
    assert not (out / "scalable_compression" / "codec.csv").exists()
    facts = json.loads((out / "scalable_compression" / "provenance.json").read_text())
    assert "Image codecs are left out" in facts["caption"]


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Somebody's data, and two cards: one that the data do not allow, one that writes a file."""
    cards = tmp_path / "cards"
    cards.mkdir()
    start = "from ovibjax.errors import InputError\nTITLE = 'T'\ndef run(job):\n    "
    (cards / "a_picky.py").write_text(start + "raise InputError(f'{job.source}: no contexts')\n")
    (cards / "b_easy.py").write_text(start + "(job.out / 'made').write_text('')\n")
    monkeypatch.setattr(catalog, "cards_folder", lambda: cards)
    rng = np.random.default_rng(0)
    save(tmp_path / "mine.npz", make_feature_set(rng.normal(size=(220, 5, 8)), rng.uniform(size=(220, 3))))
    return tmp_path


def test_a_figure_that_the_data_do_not_allow_is_named_and_the_others_are_made(mine, capsys):
    reproduce("smoke", data=[mine / "mine.npz"], out=mine / "out")
    said = "".join(capsys.readouterr().err.split())  # lines may be wrapped anywhere
    assert "a_picky:leftout" in said and "mine.npz:nocontexts" in said
    assert (mine / "out" / "b_easy" / "made").exists() and not (mine / "out" / "a_picky").exists()


def test_a_figure_asked_for_by_name_is_refused(mine):
    with pytest.raises(InputError, match="no contexts"):
        reproduce("smoke", ["a_picky"], data=[mine / "mine.npz"], out=mine / "out")
    (mine / "cards" / "b_easy.py").unlink()
    with pytest.raises(InputError, match="allows no figure"):
        reproduce("smoke", data=[mine / "mine.npz"], out=mine / "out")


def test_where_time_goes_is_printed_and_kept_and_what_is_left_estimated(mine, capsys):
    text = (
        "import time\nTITLE = 'T'\ndef run(job):\n"
        "    with job.stage('draw'):\n        time.sleep(0.1)\n    job.record('T', 'text', [1], time.perf_counter())\n"
    )
    for name in ("setup", "theorem"):
        (mine / "cards" / f"{name}.py").write_text(text)
    reproduce("smoke", ["setup", "theorem"], data=[mine / "mine.npz"], out=mine / "out")
    lines = [line.strip() for line in capsys.readouterr().err.splitlines()]
    assert lines.count("draw 0.1 s") == 2 and len([line for line in lines if line.startswith("other ")]) == 2
    assert len([line for line in lines if line.startswith("features ")]) == 1  # reading the data
    (left,) = (line for line in lines if "figures" in line)
    assert left.startswith("1 of 2 figures, some ") and left.endswith(" left")
    facts = json.loads((mine / "out" / "setup" / "provenance.json").read_text())
    assert facts["stages"]["draw"] == 0.1 and set(facts["stages"]) == {"other", "draw"} and "compile" in facts


def test_figures_of_a_longer_preset_are_not_replaced_without_a_word(mine, monkeypatch, capsys):
    monkeypatch.chdir(mine)
    full = mine / "results" / "b_easy"
    full.mkdir(parents=True)
    (full / "provenance.json").write_text('{"preset": "full"}')
    options = {"only": ["b_easy"], "data": [mine / "mine.npz"]}
    reproduce(preset="quick", **options)
    assert (mine / "results-quick" / "b_easy" / "made").exists() and not (full / "made").exists()
    said = " ".join(capsys.readouterr().err.split())
    assert "results/ holds figures of the full preset; these go to results-quick/ (--out results replaces them)" in said
    reproduce(preset="full", **options)
    assert (full / "made").exists()
    (full / "made").unlink()
    reproduce(preset="quick", out=Path("results"), **options)
    assert (full / "made").exists()
