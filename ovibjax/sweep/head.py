"""What a store says of itself: `sweep.json`, made once, read and compared by every command."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.differences import differences, digest
from ovibjax.sweep.disk import is_abandoned, of_this_process
from ovibjax.sweep.layout import Layout, compared, described, from_description

FORMAT = 2
"""Version of the layout on disk."""

_HASHED = {
    "program": "a member's program is another one there (its function, a fixed choice or this software has changed)",
    "data": "its data are others there",
}
_HEAD = "sweep.json"
_TEMPORARY = ".tmp-"


class OtherSweep(InputError):
    """A store holds members of another sweep than the one that was asked for.

    Attributes:
        beside: a store for this one in the same folder, always the same for the same sweep.
    """

    def __init__(self, message: str, path: Path, config: dict[str, Any]) -> None:
        super().__init__(message)
        self.beside = path.with_name(f"{path.stem}-{digest(_compared(config))[:8]}{path.suffix}")


def create(real: Path, layout: Layout, config: dict[str, Any]) -> None:
    """Build an empty store aside and move it into place; another process may be first.

    Raises:
        OSError: the disk refuses.
    """
    for stale in real.parent.glob(f"{real.name}{_TEMPORARY}*"):
        if is_abandoned(stale.name.removeprefix(f"{real.name}{_TEMPORARY}")):
            shutil.rmtree(stale, ignore_errors=True)
    temporary = real.with_name(f"{real.name}{_TEMPORARY}{of_this_process()}")
    shutil.rmtree(temporary, ignore_errors=True)
    head = {"format": FORMAT, "hash": digest([config, described(layout)])}
    head |= {"config": config, "layout": described(layout)}
    try:
        (temporary / "members").mkdir(parents=True)
        with (temporary / _HEAD).open("w", encoding="utf-8") as file:
            file.write(json.dumps(head, indent=1, ensure_ascii=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        temporary.rename(real)
    except OSError:
        if not (real / _HEAD).is_file():
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def is_store(path: Path) -> bool:
    """Whether a folder says of itself that it is a store of today's format or a later one."""
    return (path / _HEAD).is_file()


def read_head(path: Path) -> tuple[Layout, dict[str, Any]]:
    """What a store holds and what its members' bits depend on.

    Raises:
        InputError: there is no store, or a damaged, edited, older or newer one.
    """
    try:
        if (path / "zarr.json").is_file():
            raise InputError(
                f"{path} has the format of before; bring it over: ovibjax sweep upgrade {path} --out NEW.zarr"
            )
        if not (path / _HEAD).exists() and (path / "members").is_dir():
            raise InputError(
                f"{path}: {_HEAD} is missing, its members are there; repeat its command with another --out, and copy "
                f"the {_HEAD} that it makes, or choose another path"
            )
        head = json.loads((path / _HEAD).read_text(encoding="utf-8"))
        if head["format"] != FORMAT:
            raise InputError(
                f"{path} has format {head['format']!r} and this version reads {FORMAT}; choose another path"
            )
        if head["hash"] != digest([head["config"], head["layout"]]):
            raise InputError(f"{path} was edited: its hash does not fit; restore it or choose another path")
        if not (path / "members").is_dir():
            raise ValueError("its folder members is missing")
        return from_description(head["layout"]), head["config"]
    except InputError:
        raise
    except Exception as error:  # foreign or damaged metadata fail anywhere
        raise InputError(
            f"{path} is no store of a sweep, or damaged ({one_line(error)}); choose another path"
        ) from error


def refuse_other(
    path: Path, there: tuple[Layout, dict[str, Any]], here: tuple[Layout, dict[str, Any]], advice: str
) -> None:
    """Refuse to mix members whose bits depend on different things, or that hold different outputs.

    Args:
        path: the store.
        there: what it says of itself.
        here: what is asked for.
        advice: what to do, in words.

    Raises:
        OtherSweep: with the first things that differ.
    """
    if there[1].get("upgraded") and not here[1].get("upgraded"):
        found = ["its members are of an older version, whose program was another one, and can only be read"]
    else:
        found = [*_told(_compared(there[1]), _compared(here[1]))]
        if there[1].get("execution") != here[1].get("execution"):  # which makes it another program
            found = [words for words in found if words != _HASHED["program"]]
        found += differences(compared(there[0]), compared(here[0]))
    if found:
        raise OtherSweep(f"{path} holds another sweep: {'; '.join(found[:3])}; {advice}", path, here[1])


def _compared(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration without the notes, on which no bit depends."""
    return {key: value for key, value in config.items() if key != "notes"}


def _told(there: dict[str, Any], here: dict[str, Any]) -> Iterator[str]:
    """What differs, hashes last and in words: they differ as well where a setting does."""
    plain = [{key: value for key, value in config.items() if key not in _HASHED} for config in (there, here)]
    yield from differences(plain[0], plain[1])
    yield from (words for key, words in _HASHED.items() if there.get(key) != here.get(key))
