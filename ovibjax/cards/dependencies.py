"""What a figure depends on: the code that its card reaches by imports, as one hash that provenance keeps.

A figure is older than the code that draws it if the hash of today differs from the one it was made with. Comments,
docstrings and blank lines do not count, so that an edit of words makes no figure old. What a card imports decides, not
what it calls: the hash may change where the figure would not, never the other way round.
"""

import ast
import hashlib
import io
import json
import tokenize
from collections.abc import Iterator
from functools import cache
from importlib import resources
from pathlib import Path

from ovibjax.cards.catalog import card_names, card_paths

NO_NUMBERS = ("errors", "runtime.progress", "runtime.stage_times", "cards.expected_time", "cards.dependencies")
"""Modules that only tell, name or time what is done; no figure depends on them."""


def code_hash(card: Path) -> str:
    """Hash of a card and of every module of ours that it reaches by imports, those in functions included.

    Args:
        card: the card's file.

    Returns:
        16 hexadecimal digits, the same on every machine and Python version.
    """
    digest = hashlib.sha256(bare(card.read_text(encoding="utf-8")).encode())
    for name in modules_of(card):
        digest.update(f"\n# {name}\n{_read(name)[0]}".encode())
    return digest.hexdigest()[:16]


def modules_of(card: Path) -> list[str]:
    """Names below `ovibjax` of the modules that a card reaches by imports, in order of the alphabet."""
    found: set[str] = set()
    left = list(imported(card.read_text(encoding="utf-8")))
    while left:
        name = left.pop()
        if name not in found and name not in NO_NUMBERS:
            found.add(name)
            left += _read(name)[1]
    return sorted(found)


def imported(text: str) -> Iterator[str]:
    """Modules of ours that a source text imports, wherever in it; of a room, which loads its names lazily, all."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            wanted = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in wanted:
            head, _, rest = name.partition(".")
            if head == "ovibjax":
                yield from _modules_named(rest)


def bare(text: str) -> str:
    """A source text without comments, docstrings and blank lines."""
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        for part in body if isinstance(body, list) else ():
            if (
                isinstance(part, ast.Expr)
                and isinstance(part.value, ast.Constant)
                and isinstance(part.value.value, str)
            ):
                lines[part.lineno - 1 : part.end_lineno] = [""] * ((part.end_lineno or part.lineno) - part.lineno + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip())


def outdated(results: Path) -> dict[str, str]:
    """Cards whose figures in a results folder are not of today's code, and why in words.

    Args:
        results: results folder.

    Returns:
        Reason by card; cards without results are left out.
    """
    reasons = {}
    for name, card in zip(card_names(), card_paths(card_names()), strict=True):
        file = results / name / "provenance.json"
        if not file.is_file():
            continue
        made_with = json.loads(file.read_text(encoding="utf-8")).get("code")
        if made_with is None:
            reasons[name] = "do not say what code they were made with"
        elif made_with != code_hash(card):
            reasons[name] = "were made with other code"
    return reasons


@cache
def _read(name: str) -> tuple[str, list[str]]:
    """Bare source text of one of our modules, and what it imports; cards share most of them."""
    text = _file(name).read_text(encoding="utf-8")
    return bare(text), list(imported(text))


def _file(name: str) -> Path:
    """File of a module; of a package its `__init__.py`."""
    place = Path(str(resources.files("ovibjax"))).joinpath(*name.split("."))
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


def _modules_named(name: str) -> Iterator[str]:
    """The modules that a dotted name stands for: itself, the one it is a name in, or all those of a room."""
    while name:
        file = _file(name)
        if file.name == "__init__.py" and file.is_file():
            yield from (f"{name}.{path.stem}" for path in file.parent.glob("*.py") if path.stem != "__init__")
            return
        if file.is_file():
            yield name
            return
        name = name.rpartition(".")[0]
