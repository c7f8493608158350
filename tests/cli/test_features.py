"""The features command: somebody's images to a feature file, and bad input in one line."""

from pathlib import Path

import numpy as np
import pytest

from ovibjax.features.backbones.by_name import open_backbone
from ovibjax.features.feature_files import load
from ovibjax.features.images.decoding import decode_image
from tests.cli.cases import done_here, ovibjax, said_of_bad_input
from tests.features.images.made_images import pack, write, write_layout, write_table


def test_a_table_becomes_a_feature_file(tmp_path: Path) -> None:
    write_table(tmp_path, 4)
    write(tmp_path / "images/Left/2.png", b"broken")
    (tmp_path / "images/Down/3.png").unlink()
    done = ovibjax(
        "features", "my.csv", "--images", "images/{view}/{frame}.png", "--out", "mine.npz", "--batch", "3", cwd=tmp_path
    )
    assert done.returncode == 0 and done.stdout == "", done.stderr
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    assert lines == [
        "poses: my.csv: table with commas, frame, x_m, y_m, z_m, yaw_deg: 4 poses",
        "skipped 1, a view is missing:",
        "3: images/Down/3.png",
        "skipped 1, an image does not decode:",
        "2: images/Left/2.png: not a PNG, JPEG, WebP or BMP image",
        "kept 2 of 4 frames; axes: as given, yaw from x towards y",
        "features: mine.npz [2, 5, 512]",
        "order: a drive of 3.606 m, 3.61 m from frame to frame (median); what was left out is passed in one step",
        "note: ovibjax reproduce needs at least 200 frames",
    ]
    made, backbone = load(tmp_path / "mine.npz"), open_backbone("embedded")
    assert made.frame_id.tolist() == ["0", "1"] and made.positions_m[1].tolist() == [3, 2, 30]
    image = decode_image((tmp_path / "images/Right/1.png").read_bytes())
    expected = backbone.embed(np.stack([backbone.preprocess(image)] * 15))[0]
    np.testing.assert_allclose(made.features[1, 3], expected, atol=1e-5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["images", "mine.npz", "my.csv"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cut.tar", "--out", "x.npz"), "cut.tar: truncated or corrupt"),
        (("town", "--out", "x.npz", "--views", "5", "--strict"), "1 frame incomplete"),
        (("town", "--out", "x.npz", "--imagse", "a"), "did you mean --images?"),
        (("town", "--out", "x.npz", "--columns", "frame=id"), "--columns, --axes or --order belongs to a table"),
        (("town", "--out", "x.npz", "--cameras", "Top=a"), "--cameras Top=a: write VIEW=NAME"),
        (("town", "--out", "x.npz", "--pool", "mean"), "takes no size, layout, mean, std, output or pool"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    write_layout(tmp_path / "town", 2)
    whole = pack(tmp_path / "town", tmp_path / "cut.tar").read_bytes()
    write(tmp_path / "cut.tar", whole[:4000])
    (tmp_path / "town/rgb/Back/000001.png").unlink()
    monkeypatch.chdir(tmp_path)
    said = said_of_bad_input(monkeypatch, capsys, "features", *arguments)
    assert words in said and len(said.strip().splitlines()) == 1, said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.tar", "town"]


def test_other_peoples_poses_become_a_feature_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(tmp_path, 2)
    (tmp_path / "images").rename(tmp_path / "pictures")
    (tmp_path / "pictures/Front").rename(tmp_path / "pictures/cam0")
    (tmp_path / "tables").mkdir()
    write(tmp_path / "tables/p.tsv", b"# ours\nid\tx\ty\tz\theading\n0\t1,5\t2\t3\t0,1\n1\t-\t2\t3\t0,1\n")
    monkeypatch.chdir(tmp_path / "tables")
    names = ("frame=id", "x_m=x", "y_m=y", "z_m=z", "yaw_rad=heading")
    arguments = ("--images", "../pictures/{view}/{frame}.png", "--cameras", "Front=cam0", "--columns", *names)
    done_here(monkeypatch, capsys, "features", "p.tsv", "--out", "a.npz", *arguments)
    made = load(tmp_path / "tables/a.npz")
    assert made.positions_m.tolist() == [[1.5, 2, 3]] and made.frame_id.tolist() == ["0"]
    np.testing.assert_allclose(made.yaw_rad, 0.1)
    done_here(monkeypatch, capsys, "features", "p.tsv", "--out", "b.npz", *arguments, "--axes", "ned")
    turned = load(tmp_path / "tables/b.npz")
    assert turned.positions_m.tolist() == [[2, 1.5, -3]]
    np.testing.assert_allclose(turned.yaw_rad, np.pi / 2 - 0.1)


def test_help_teaches(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    said = done_here(monkeypatch, capsys, "features", "--help")
    for words in ("frame,x_m,y_m,z_m,yaw_deg", "rgb/<Camera>/<frame>.png", "--strict", "images/{view}/{frame}.jpg"):
        assert words in said, words
