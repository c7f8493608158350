"""Python files of somebody's own as modules: cards and sweep files. What goes wrong in them is told on one line."""

import sys
import traceback
from pathlib import Path
from types import ModuleType

from ovibjax.errors import InputError, one_line


def import_file(path: Path, name: str) -> ModuleType:
    """Run a Python file and keep it as a module, without writing anything beside it.

    Args:
        path: the file.
        name: what to call it; with a prefix that no package has, so that nobody imports it by accident.

    Returns:
        The module.

    Raises:
        InputError: there is no such file, or it raises (or exits) as it is run.
    """
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder, not a Python file' if path.is_dir() else 'no such file'}")
    module = ModuleType(name)
    module.__file__ = str(path.absolute())
    # Known while it runs: dataclasses look their module up by name.
    sys.modules[name] = module
    try:
        exec(compile(path.read_bytes(), module.__file__, "exec"), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{path}: does not import: {told(error, path)}") from error
    return module


def told(error: BaseException, path: Path, at_most: int = 300) -> str:
    """An error that somebody's file raised: where, of what type, and what it says, on one line.

    Args:
        error: as caught.
        path: the file; a place in another file of its folder is told as well.
        at_most: characters of what it says.

    Returns:
        For example `mine.py, line 12: KeyError: 'gamma'`.
    """
    said = f"{type(error).__name__}: {one_line(error, at_most)}"
    folder = path.absolute().parent
    places = [place for place in traceback.extract_tb(error.__traceback__) if Path(place.filename).parent == folder]
    if not places or isinstance(error, SyntaxError):  # which says itself where
        return said
    return f"{Path(places[-1].filename).name}, line {places[-1].lineno}: {said}"
