"""The cards: where they lie, what they are called, and how one is imported from its file."""

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import ovibjax
from ovibjax.errors import InputError
from ovibjax.runtime.python_files import import_file


def cards_folder() -> Path:
    """Folder of the cards: `sweeps/` of a checkout, or the copy inside an installed wheel."""
    package = Path(ovibjax.__file__).parent
    checkout = package.parent / "sweeps"
    return checkout if (package.parent / "pyproject.toml").exists() and checkout.is_dir() else package / "_sweeps"


def card_names() -> list[str]:
    """Names of the cards that come with the software."""
    return sorted(path.stem for path in cards_folder().glob("*.py") if not path.stem.startswith("_"))


def card_paths(names: Iterable[str]) -> list[Path]:
    """Files of cards by name."""
    return [cards_folder() / f"{name}.py" for name in names]


def load_card(path: Path) -> ModuleType:
    """Import a card from its file, without putting its name where other packages could meet it.

    Args:
        path: a Python file with `TITLE` and `run(job)`.

    Returns:
        The module.

    Raises:
        InputError: the file is missing, does not import, or is no card.
    """
    module = import_file(path, f"ovibjax._cards.{path.stem}")
    for name in ("TITLE", "run"):
        if not hasattr(module, name):
            raise InputError(f"{path}: a sweep file defines TITLE and run(job); {name} is missing")
    return module


def takes_queries(card: ModuleType) -> bool:
    """Whether a card works on references and queries of its own instead of one feature set."""
    return bool(getattr(card, "TAKES_QUERIES", False))
