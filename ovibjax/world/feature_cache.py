"""Rendered features in the cache folder, under a hash of what they depend on: the description and the code itself."""

import hashlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import FeatureSet
from ovibjax.runtime.cache import made_folder, source_code


@cache
def _code(modules: tuple[str, ...]) -> bytes:
    """The text of modules, as it was when this process first asked."""
    return source_code(*modules)


def content_key(facts: object, modules: tuple[str, ...]) -> str:
    """Hash of everything that features depend on.

    Args:
        facts: description of the data; its `repr` counts.
        modules: the project's modules that make them, such as "world.town.render".

    Returns:
        20 hexadecimal digits.
    """
    return hashlib.sha256(repr(facts).encode() + _code(modules)).hexdigest()[:20]


def kept(*paths: Path) -> list[FeatureSet] | None:
    """Feature sets from the cache folder; None if any has to be made again.

    Args:
        paths: the files of sets that belong together.

    Returns:
        The sets in the order of the paths.

    Raises:
        InputError: a set is missing, and the cache folder cannot be made.
    """
    if not all(path.exists() for path in paths):
        for path in paths:
            made_folder(path.parent)  # refused before anything is rendered
        return None
    try:
        return [load(path) for path in paths]
    except InputError:
        for path in paths:
            path.unlink(missing_ok=True)  # damaged by something else: make it again
        return None


def keep(sets: Mapping[Path, FeatureSet]) -> None:
    """Write feature sets to the cache folder.

    Args:
        sets: by the file that each goes to, all in one folder.

    Raises:
        InputError: the cache folder cannot be written.
    """
    for path, feature_set in sets.items():
        made_folder(path.parent)
        save(path, feature_set)
