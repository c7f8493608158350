"""The house keeps its measures: no long function, module, card or test file; the map of the house is true."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE, CARDS, EXAMPLES = ROOT / "ovibjax", ROOT / "sweeps", ROOT / "examples"
MOST_LINES, MOST_PARAMETERS = 60, 7
CODE = sorted([*PACKAGE.rglob("*.py"), *CARDS.glob("*.py"), *EXAMPLES.glob("*.py")])


def lines_of(path):
    return path.read_text().splitlines()


def name_of(path):
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", CODE, ids=name_of)
def test_functions_fit_a_screen_or_say_why(path):
    text = lines_of(path)
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        names = [arg.arg for arg in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len([name for name in names if name not in ("self", "cls")])
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        long = node.end_lineno - node.lineno + 1 > MOST_LINES or count > MOST_PARAMETERS
        reason = text[first - 2].lstrip().startswith("#") if first > 1 else False
        assert not long or reason, f"{name_of(path)}: {node.name} is long and no comment above it says why"


@pytest.mark.parametrize("path", sorted(CARDS.glob("*.py")), ids=name_of)
def test_cards_fit_a_screen_and_a_half(path):
    assert len(lines_of(path)) <= 200


@pytest.mark.parametrize("path", sorted(path for path in (ROOT / "tests").rglob("test_*.py")), ids=name_of)
def test_test_files_are_short(path):
    assert len(lines_of(path)) <= 300


def test_only_views_errors_and_rooms_stand_at_the_top():
    loose = {path.name for path in PACKAGE.glob("*.py")}
    assert loose == {"__init__.py", "__main__.py", "views.py", "errors.py"}


def test_no_two_modules_share_a_name():
    """Commands are named by what the user types; town and rooms each have their own of what both have."""
    places = {}
    for path in PACKAGE.rglob("*.py"):
        room = path.parent.relative_to(PACKAGE).as_posix()
        if path.stem != "__init__" and room not in ("cli", "world/rooms", "world/town"):
            places.setdefault(path.stem, []).append(name_of(path))
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_the_map_names_files_that_exist():
    text = (PACKAGE / "README.md").read_text()
    paths = re.findall(r"`((?:\.\./|tests/)?[\w/]*(?:\.py|/))`", text)
    assert len(paths) > 60
    for path in paths:
        base = ROOT if path.startswith("tests/") else PACKAGE
        # Beside a file of the same room, the room is left out.
        found = (base / path).exists() or any(PACKAGE.glob(f"*/**/{path}"))
        assert found, f"ovibjax/README.md names {path}, which does not exist"
