"""What several commands share: typed numbers, own frames, where a sweep is computed, and how a command stops."""

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from ovibjax.errors import InputError
from ovibjax.runtime.plain_numbers import plain_float, plain_int
from ovibjax.runtime.progress import console

if TYPE_CHECKING:
    import xarray

    from ovibjax.features.frames import FeatureSet
    from ovibjax.sweep.engine import Executor


Number = TypeVar("Number", int, float)


def numbers(name: str, items: Sequence[str], valid: Callable[[float], bool], rule: str) -> list[float]:
    """Values of a real axis.

    Args:
        name: the axis.
        items: what was typed.
        valid: whether a value is possible.
        rule: what possible values are, in words.

    Returns:
        The values, in the order given.

    Raises:
        InputError: not a number, an impossible one, or one that is there already, to float32 accuracy.
    """
    values = []
    for item in items:
        try:
            value = plain_float(item)
        except ValueError:
            raise InputError(f"--{name} {item}: not a number; values are {rule}{_spaces(name, item)}") from None
        if not valid(value) or value in (float("inf"), float("-inf")):
            raise InputError(f"--{name} {item}: values are {rule}")
        values.append(value)
    if not values:
        raise InputError(f"--{name} has no value; values are {rule}")
    return _once(name, values, [struct.pack("f", value) if abs(value) < 3e38 else value for value in values])


def integers(name: str, items: Sequence[str], low: int, high: int) -> list[int]:
    """Values of a whole-number axis; FROM:TO stands for FROM ... TO-1.

    Args:
        name: the axis.
        items: what was typed.
        low: smallest possible value.
        high: largest possible value.

    Returns:
        The values, in the order given.

    Raises:
        InputError: not a whole number or range, an impossible one, or one that is there already.
    """
    values: list[int] = []
    for item in items:
        first, colon, last = item.partition(":")
        try:
            found = range(plain_int(first), plain_int(last)) if colon else [plain_int(item)]
        except ValueError:
            hint = _spaces(name, item)
            raise InputError(f"--{name} {item}: not a whole number or a range such as 0:5{hint}") from None
        if not found:
            raise InputError(f"--{name} {item}: the range is empty")
        if min(found) < low or max(found) > high:
            raise InputError(f"--{name} {item}: values are {low} to {high}")
        values.extend(found)
    if not values:
        raise InputError(f"--{name} has no value")
    return _once(name, values, values)


def _once(name: str, values: list[Number], keys: Sequence[object]) -> list[Number]:
    """The values, each of which must be there once."""
    seen = set[object]()
    for value, key in zip(values, keys, strict=True):
        if key in seen:
            raise InputError(f"--{name}: {value} is given twice")
        seen.add(key)
    return values


def _spaces(name: str, item: str) -> str:
    """How several values are written, where it was a comma that did not read."""
    parts = [part.strip() for part in item.split(",")]
    return f"; write several with spaces: --{name} {' '.join(parts)}" if len(parts) > 1 and all(parts) else ""


def require_positive(command: object, *names: str) -> None:
    """Refuse a count that is not one or more; None, where a command has it, stands for a default.

    Args:
        command: the parsed command.
        names: options of it.

    Raises:
        InputError: one of them is zero or negative.
    """
    for name in names:
        value = getattr(command, name)
        if value is not None and value < 1:
            raise InputError(f"--{name} {value} is not positive")


def own_drive(data: Path | None, order: str | None) -> "FeatureSet | None":
    """Somebody's frames along a drive, if some are given.

    Args:
        data: `.npz` or folder; None for embedded data.
        order: what somebody said that the frames are, one of `features.sequence.ORDERS`; None as they look.

    Returns:
        The feature set, or None.

    Raises:
        InputError: unreadable data, too few frames, or places in no order.
    """
    if data is None:
        return None
    from ovibjax.features.feature_files import load
    from ovibjax.features.sequence import require_drive
    from ovibjax.features.splits import require_frames

    own = load(data)
    require_frames(own, source=str(data))
    return require_drive(own, data, order)


def executor_of(on: str, address: str | None) -> "Executor | None":
    """Where the members of a sweep are computed.

    Args:
        on: `local` or `ray`.
        address: a running Ray cluster; None starts a local one.

    Returns:
        The executor of `sweep.engine.run`; None for this process.

    Raises:
        InputError: an address without Ray, or Ray is not installed.
    """
    if on == "ray":
        from ovibjax.sweep.cluster import on_ray

        return on_ray(address)
    if address is not None:
        raise InputError("--address is for --on ray")
    return None


def shard_of(given: str | None) -> tuple[int, int] | None:
    """Which members of a sweep to compute.

    Args:
        given: `3/16`, or None for all of them.

    Returns:
        3 and 16, or None.

    Raises:
        InputError: something else was typed.
    """
    if given is None:
        return None
    found = re.fullmatch(r"(\d+)/(\d+)", given)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise InputError(f"--shard {given}: give i/n with i from 1 to n, e.g. 3/16")
    return int(found[1]), int(found[2])


def require_store(out: Path) -> None:
    """Refuse a store that cannot be made or gone on with, before the data are prepared.

    Args:
        out: a store, or where one is to be.

    Raises:
        InputError: it holds something else, or nothing can be written there.
    """
    from ovibjax.runtime.outputs import require_place
    from ovibjax.sweep.store import config_of

    require_place(out)
    config_of(out)


@contextmanager
def going_on_in(store: Path) -> Iterator[None]:
    """After Ctrl-C during a sweep, say what is kept and how to go on."""
    from ovibjax.sweep.engine import Interrupted

    try:
        yield
    except Interrupted as error:
        done, total = error.dataset.finished, error.dataset.attrs.get("asked", error.dataset.finished.size)
        raise KeyboardInterrupt(
            f"interrupted; {int(done.sum())} of {total} members are in {store}: repeat the command to go on"
        ) from None


def kept_in(out: Path, keep_both: bool, compute: "Callable[[Path], xarray.Dataset]") -> "tuple[xarray.Dataset, Path]":
    """Run a sweep into its store, or into one beside it if that one holds another sweep and both are to be kept.

    Args:
        out: the store that was asked for.
        keep_both: whether a second sweep gets a store of its own in the same folder.
        compute: runs the sweep into a store.

    Returns:
        The results, and the store they are in.
    """
    from ovibjax.sweep.head import OtherSweep

    try:
        with going_on_in(out):
            return compute(out), out
    except OtherSweep as error:
        if not keep_both:
            raise
        beside = error.beside
    console.print(f"{out} holds another sweep, which stays; this one is kept in {beside}", highlight=False)
    with going_on_in(beside):
        return compute(beside), beside


class Counted:
    """Progress of a sweep that also knows how many members were there before.

    Attributes:
        before: members that were not computed; None until the sweep begins.
    """

    def __init__(self, update: Callable[[int, int], None]) -> None:
        self.before: int | None = None
        self._update = update

    def __call__(self, done: int, total: int) -> None:
        """Note the first number, and hand on."""
        self.before = done if self.before is None else self.before
        self._update(done, total)


def finished_line(dataset: "xarray.Dataset", counted: Counted, note: str) -> str:
    """How many members of a grid are there, all or the shards so far, what was there before, and a note on them."""
    there, size, before = int(dataset.finished.sum()), dataset.finished.size, counted.before or 0
    counts = f"{size} members" if there == size else f"{there} of {size} members"
    return f"{counts}{f' ({before} of them were there)' if before else ''}{note}"
