"""Over 200 malformed inputs: one line that says what is wrong, exit code 2, and nothing written anywhere."""

import stat
import sys

import pytest

from ovibjax.cli import main as cli
from ovibjax.features.backbones import by_name as backbone
from tests.features.images.made_images import tiny_backbone
from tests.features.images.malformed import cases

open_known = backbone.open_backbone


def tree(folder):
    """Every file and folder with its kind, length and time of change."""
    found = {path: path.lstat() for path in folder.rglob("*")}
    return {path: (stat.S_IFMT(about.st_mode), about.st_size, about.st_mtime_ns) for path, about in found.items()}


@pytest.fixture(scope="module")
def all_cases(tmp_path_factory):
    return cases(tmp_path_factory.mktemp("scratch"))


def refused(build, folder, monkeypatch, capsys):
    """What a command says of an input, if all goes as it should; otherwise what went wrong."""
    (folder / "out").mkdir(parents=True)
    arguments = build(folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["ovibjax", *arguments])
    monkeypatch.setattr(
        backbone, "open_backbone", lambda spec, o=None: tiny_backbone() if spec == "embedded" else open_known(spec)
    )
    before = tree(folder)
    code = None
    try:
        cli.main()
    except SystemExit as stop:
        code = stop.code
    said = capsys.readouterr()
    after = tree(folder)
    changed = sorted(path for path in {*before, *after} if before.get(path) != after.get(path))
    # Making and removing the folder of an unfinished extraction touches the folder that holds it.
    changed = [path for path in changed if path != folder / "out"]
    lines = said.err.strip().splitlines()
    assert code == 2, (code, said.err)
    assert len(lines) == 1 and lines[0].startswith("ovibjax: ") and lines[0].isprintable(), said.err
    assert "Traceback" not in said.err and said.out == "", said
    assert len(lines[0]) < 800 and not changed, (lines[0], changed)
    return lines[0]


def test_every_malformed_input_is_one_line_and_exit_code_2(all_cases, tmp_path, monkeypatch, capsys):
    assert len(all_cases) >= 200
    wrong = []
    for number, (name, build) in enumerate(all_cases.items()):
        try:
            refused(build, tmp_path / str(number), monkeypatch, capsys)
        except Exception as error:  # the list of all that fail says more than the first
            wrong.append(f"{name}: {type(error).__name__}: {str(error)[:300]}")
        except AssertionError as error:
            wrong.append(f"{name}: {str(error)[:300]}")
    assert not wrong, f"{len(wrong)} of {len(all_cases)}:\n" + "\n".join(wrong)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("image: PNG of 30000 squared", ["rgb/Front/000000.png", "pixels"]),
        ("image: GIF", ["rgb/Front/000000.png", "not a PNG"]),
        ("metadata: x is NaN", ["metadata/000000.json", "position is not finite"]),
        ("folder: no camera Left", ["no images of Left", "Back"]),
        ("folder: name not UTF-8", ["rgb/Left", "\\udcff"]),
        ("archive: path ../up.png", ["../up.png", "leads out"]),
        ("archive: symlink", ["rgb/Front/9.png", "a link"]),
        ("archive: character device", ["rgb/Front/9.png", "a device"]),
        ("archive: size of 8 GiB", ["8589934591 bytes"]),
        ("archive: member twice", ["rgb/Front/000000.png", "twice"]),
        ("table: frame twice", ["line 3", "listed twice", "line 2"]),
        ("table: x is abc", ["line 2", "x_m is 'abc'"]),
        ("table: no column yaw_deg", ["yaw_deg", "needs frame,x_m,y_m,z_m,yaw_deg"]),
        ("pattern: '../{view}/{frame}.png'", ["no usable frame", "there is no folder ../Front"]),
        ("table: frame ../0", ["line 2", "leads out of the table's folder"]),
        ("table: a heading of no kind", ["--columns yaw_deg=NAME"]),
        ("option: misspelt option", ["did you mean --strict?"]),
        ("features: objects", ["pickled", "never loaded"]),
    ],
)
def test_the_line_names_what_is_wrong(all_cases, tmp_path, monkeypatch, capsys, name, words):
    line = refused(all_cases[name], tmp_path / "case", monkeypatch, capsys)
    for word in words:
        assert word in line, (word, line)
