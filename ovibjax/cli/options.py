"""What several commands share: typed numbers, own frames, where a sweep is computed, and how a command stops."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ovibjax.errors import InputError
from ovibjax.runtime.plain_numbers import plain_float, plain_int

if TYPE_CHECKING:
    from ovibjax.features.frames import FeatureSet
    from ovibjax.sweep.engine import Executor


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
        InputError: not a number, or an impossible one.
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
    return values


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
        InputError: not a whole number or range, or an impossible one.
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


def own_frames(data: Path | None) -> "FeatureSet | None":
    """Somebody's feature set, if one is given.

    Args:
        data: `.npz` or folder; None for embedded data.

    Returns:
        The feature set, or None.

    Raises:
        InputError: unreadable data, or too few frames.
    """
    if data is None:
        return None
    from ovibjax.features.feature_files import load
    from ovibjax.features.splits import require_frames

    own = load(data)
    require_frames(own, source=str(data))
    return own


def split_processor(devices: int) -> None:
    """Make the processor several devices; before jax starts, which is why commands import it late.

    Args:
        devices: how many.

    Raises:
        InputError: not a positive number.
    """
    if devices < 1:
        raise InputError(f"--devices {devices} is not positive")
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count={devices}".strip()


def executor_of(on: str, address: str | None) -> "Executor | None":
    """Where the chunks of a sweep are computed.

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


@contextmanager
def going_on_in(store: Path) -> Iterator[None]:
    """After Ctrl-C during a sweep, say what is kept and how to go on."""
    from ovibjax.sweep.engine import Interrupted

    try:
        yield
    except Interrupted as error:
        done = error.dataset.finished
        raise KeyboardInterrupt(
            f"interrupted; {int(done.sum())} of {done.size} members are in {store}: repeat the command to go on"
        ) from None
