"""Imports run downward only: the order of the rooms, written once, held against every import in the code."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "ovibjax"

# From the ground up. A room may import rooms of lower lines, and itself.
ORDER = (
    ("views", "errors"),
    ("runtime",),
    ("sweep", "report"),
    ("link",),
    ("features",),
    ("world",),
    ("encoder",),
    ("edge",),
    ("control",),
    ("scheduling",),
    ("system",),
    ("live",),
    ("cards",),
    ("cli",),
    ("_sweeps",),
)
"""Rooms by storey; `_sweeps` are the cards of the checkout's `sweeps/`."""

GENERAL = ("sweep", "report")
"""Tools that are of use without this paper: they know nothing of it, nor of each other."""

GROUND = ("views", "errors")
STOREY = {room: number for number, rooms in enumerate(ORDER) for room in rooms}


def modules():
    """Every module with its dotted name below the package."""
    found = {path: ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in PACKAGE.rglob("*.py")}
    cards = (PACKAGE.parent / "sweeps").glob("*.py")
    return found | {path: f"_sweeps.{path.stem}" for path in cards}


def imports(path, name):
    """Names below the package that a module imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (
                alias.name.removeprefix("ovibjax.") for alias in node.names if alias.name.startswith("ovibjax.")
            )
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            if node.module == "ovibjax":
                yield from (alias.name for alias in node.names if not alias.name.startswith("__"))
            elif node.module and node.module.startswith("ovibjax."):
                yield node.module.removeprefix("ovibjax.")


ALL = modules()


def is_room(name):
    return name not in ("__init__", "__main__")


@pytest.mark.parametrize("path", sorted(ALL), ids=lambda path: ALL[path])
def test_imports_run_downward(path):
    room = ALL[path].partition(".")[0]
    if not is_room(room):
        return
    for name in imports(path, ALL[path]):
        target = name.partition(".")[0]
        assert target in STOREY, f"{ALL[path]} imports {name}, which is in no room"
        if target == room:
            continue
        assert STOREY[target] < STOREY[room], f"{ALL[path]} imports {name}: {target} is not below {room}"
        if room in GENERAL:
            assert target in (*GROUND, "runtime"), f"{ALL[path]} imports {name}: a general tool knows no domain"


def test_every_room_has_its_place():
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert rooms == set(STOREY) - set(GROUND) - {"_sweeps"}


def test_no_circles_inside_a_room():
    graph = {name: {target for target in imports(path, name) if target in ALL.values()} for path, name in ALL.items()}
    done, open_ = set(), []

    def visit(name):
        if name in done:
            return
        assert name not in open_, f"circle: {' -> '.join([*open_[open_.index(name) :], name])}"
        open_.append(name)
        for target in graph.get(name, ()):
            visit(target)
        open_.pop()
        done.add(name)

    for name in graph:
        visit(name)
