"""A sweep that somebody's Python file describes: read, and narrowed to the values that are asked for.

The file defines `axes` and `member(key, point, shared)`, or in its place `begin`, `go_on`, `judge` and `steps` (see
`Staged`; also `every`). It may define `shared()` or `shared(axes)` (data, also as `Along`), `zipped`, `dims`, `coords`,
`units`, and `settings` (or `static`); all mean what they mean in `engine.run`. `score` is that of `halving.halve`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax

from ovibjax.errors import InputError
from ovibjax.runtime.python_files import import_file, told
from ovibjax.sweep.file_checks import (
    STAGES,
    check_along,
    check_arrays,
    check_list,
    check_outputs,
    check_signature,
    dictionary,
    fault,
    options_of,
    signature_of,
    staged_of,
)
from ovibjax.sweep.grid import Axis, make_grid
from ovibjax.sweep.program import MemberFn
from ovibjax.sweep.staged import Staged
from ovibjax.sweep.work import Along

MODULES = "sweep_file"
"""Modules made of such files are called `sweep_file.NAME`; `report/best.py` knows their sweeps by it."""


@dataclass(frozen=True)
class SweepFile:
    """What a file says.

    Attributes:
        path: the file.
        member: its member function, `Staged` if it can be cut.
        axes: its axes.
        shared: data, or the function that gives them.
        score: the output that a halving chooses by, if the file names one.
        options: `zipped`, `dims`, `coords`, `units` and `settings`, as `engine.run` takes them.
    """

    path: Path
    member: MemberFn
    axes: dict[str, Axis]
    shared: Any
    score: str | None
    options: dict[str, Any]


def read_sweep_file(path: Path) -> SweepFile:
    """Import a file and check what it defines; data are not loaded and nothing is traced yet.

    Args:
        path: the file.

    Returns:
        What it says.

    Raises:
        InputError: it does not import, lacks something, or something in it is not what it should be.
    """
    found = vars(import_file(path, f"{MODULES}.{path.stem}"))
    with _about(path):
        staged = staged_of(found)
        for name in ("axes", "member"):
            if name not in found and (name == "axes" or staged is None):
                raise InputError(
                    f"{name} is missing; a sweep file defines axes, a dictionary of values by name, and "
                    "member(key, point, shared)"
                )
        if staged is None:
            check_signature("member", found["member"], ("key", "point", "shared"))
        score = found.get("score")
        if score is not None and not isinstance(score, str):
            raise InputError("score is no name; it names the output that a halving chooses by")
        options = options_of(found)
        given = dictionary("axes", found["axes"])
        for name, values in given.items():
            if isinstance(values, Axis):
                check_list(f"axes: {name}", values.values)
        axes = make_grid(given, options["zipped"]).axes
        return SweepFile(path, staged or found["member"], axes, found.get("shared"), score, options)


def data_of(file: SweepFile, axes: Mapping[str, Axis]) -> Any:
    """The data of a sweep file for the axes asked for.

    Args:
        file: what the file says.
        axes: the file's axes, with other values perhaps.

    Returns:
        A pytree of arrays, or `Along` with an entry per value.

    Raises:
        InputError: `shared` raises, gives what is no array, or has no data for a value.
    """
    shared, told_axes = file.shared, False
    with _about(file.path):
        if callable(shared):
            told_axes = "axes" in signature_of("shared", shared).parameters
            check_signature("shared", shared, ("axes",) if told_axes else ())
            try:
                values = {name: list(axis.values) for name, axis in axes.items()}
                shared = shared(axes=values) if told_axes else shared()
            except (Exception, SystemExit) as error:
                raise InputError(f"shared fails: {told(error, file.path)}") from error
        if not isinstance(shared, Along):
            check_arrays(shared)
            return shared
        check_along(shared, axes)
        return shared if told_axes else _entries_of(shared, file.axes, axes)


def member_of(file: SweepFile) -> MemberFn:
    """The file's member function as `engine.run` wants it.

    Args:
        file: what the file says.

    Returns:
        A member function of the file's module and of its name, whose errors are one line; `Staged` if it can be cut.
    """
    fn = file.member
    if not isinstance(fn, Staged):
        return _guarded("member", fn, file.path)
    begin, go_on, judge = (_guarded(name, getattr(fn, name), file.path) for name in STAGES)
    return replace(fn, begin=begin, go_on=go_on, judge=judge, name=f"{MODULES}.{file.path.stem}.member")


def _guarded(name: str, fn: Callable[..., Any], path: Path) -> Callable[..., Any]:
    """A function of a file, whose errors are one line."""

    def guarded(key: jax.Array, point: dict[str, jax.Array], shared: Any, *more: Any) -> Any:
        with _about(path):
            try:
                outputs = fn(key, point, shared, *more)
            except Exception as error:
                raise InputError(fault(name, error, path, list(point))) from error
            if name in ("member", "judge"):
                check_outputs(name, outputs)
        return outputs

    # The store names the function by these. It travels to workers whole, as the module's own is another.
    guarded.__module__, guarded.__qualname__ = f"{MODULES}.{path.stem}", name
    return guarded


@contextmanager
def _about(path: Path) -> Iterator[None]:
    """Name the file in what is refused."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from (error.__cause__ or error)


def _entries_of(along: Along, whole: Mapping[str, Axis], asked: Mapping[str, Axis]) -> Along:
    """The entries of the values asked for, of data that were made for every value of the file."""
    name, there = along.axis, list(whole[along.axis].values)
    if len(there) != len(along.values):
        raise InputError(f"shared has {len(along.values)} entries along axis {name}, which has {len(there)} values")
    missing = [value for value in asked[name].values if value not in there]
    if missing:
        raise InputError(
            f"shared() has no data for {name} {missing[0]}; add the value to axes, or write shared(axes), which is "
            "given the values asked for"
        )
    return Along(name, [along.values[there.index(value)] for value in asked[name].values])
