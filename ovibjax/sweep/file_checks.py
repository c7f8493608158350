"""What a sweep file may define, checked name by name before hours are spent, and its errors worded."""

import inspect
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.errors import InputError, one_line
from ovibjax.runtime.python_files import told
from ovibjax.sweep.grid import Axis
from ovibjax.sweep.program import flatten
from ovibjax.sweep.staged import Staged
from ovibjax.sweep.work import Along

STAGES = {
    "begin": ("key", "point", "shared"),
    "go_on": ("key", "point", "shared", "state", "first", "last"),
    "judge": ("key", "point", "shared", "state"),
}
"""Functions of a member that can be cut, and their arguments."""


def signature_of(name: str, function: Any) -> inspect.Signature:
    """Parameters of what should be a function."""
    try:
        return inspect.signature(function)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {_kind(function)}, not a function") from None


def check_signature(name: str, function: Any, wanted: Sequence[str]) -> None:
    """Refuse a function that cannot be called with so many arguments."""
    signature = signature_of(name, function)
    try:
        signature.bind(*wanted)
    except TypeError:
        raise InputError(f"{name}{signature} takes other arguments; write {name}({', '.join(wanted)})") from None


def dictionary(name: str, value: Any) -> dict[str, Any]:
    """A dictionary by name, or a refusal."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name} is {_kind(value)}; it is a dictionary by name")
    odd = next((key for key in value if not isinstance(key, str)), None)
    if odd is not None:
        raise InputError(f"{name}: {odd!r} is not a name")
    return dict(value)


def options_of(found: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that a file may define but need not.

    Args:
        found: all that it defines, by name.

    Returns:
        `zipped`, `dims`, `coords`, `units` and `settings`, as `engine.run` takes them.

    Raises:
        InputError: one of them is of another kind.
    """
    given = {name: dictionary(name, found.get(name, {})) for name in ("dims", "coords", "units", "static", "settings")}
    for name, unit in given["units"].items():
        if not isinstance(unit, str):
            raise InputError(f"units: that of {name} is {_kind(unit)}, not text")
    for name, values in given["coords"].items():
        check_list(f"coords: {name}", values.values if isinstance(values, Axis) else values)
    settings = {**given["static"], **given["settings"]}
    try:
        json.dumps(settings)
    except (TypeError, ValueError) as error:
        raise InputError(f"settings: {one_line(error)}; they are numbers, text, lists and dictionaries") from None
    return {
        "zipped": _groups(found.get("zipped", ())),
        # One dimension may be written without a list; as a sequence its name would be one of letters.
        "dims": {name: _words(f"dims: those of {name}", value) for name, value in given["dims"].items()},
        "coords": given["coords"],
        "units": given["units"],
        "settings": settings,
    }


def staged_of(found: Mapping[str, Any]) -> Staged | None:
    """The stages that a file defines in place of a member function; None if it defines none.

    Args:
        found: all that it defines, by name.

    Returns:
        Its begin, go_on, judge, steps and every.

    Raises:
        InputError: one of them is missing or of another kind, or there is a member function as well.
    """
    functions = [name for name in STAGES if name in found]
    if not functions or ("member" in found and len(functions) < len(STAGES)):
        return None
    if "member" in found:
        raise InputError(f"there is member, and there are {', '.join(STAGES)}; define the one or the others")
    for name, arguments in STAGES.items():
        if name not in found:
            raise InputError(f"{name}({', '.join(arguments)}) is missing; there is {functions[0]}")
        check_signature(name, found[name], arguments)
    numbers = {"steps": found.get("steps"), "every": found.get("every", 1)}
    for name, number in numbers.items():
        if not isinstance(number, int) or isinstance(number, bool):
            given = "missing" if number is None else _kind(number)
            raise InputError(f"{name} is {given}; it is a whole number, of the steps that go_on counts")
    return Staged(*(found[name] for name in STAGES), **numbers)


def _words(name: str, value: Any) -> tuple[str, ...]:
    words = (value,) if isinstance(value, str) else value
    if not isinstance(words, Sequence) or not all(isinstance(word, str) for word in words):
        raise InputError(f"{name} are {_kind(value)}; they are a list of names")
    return tuple(words)


def _groups(value: Any) -> list[tuple[str, ...]]:
    """Groups of axes that advance together; a list of names is one."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        groups = [value] if value and all(isinstance(name, str) for name in value) else value
        return [_words("zipped: groups", group) for group in groups]
    raise InputError(f"zipped is {_kind(value)}; it is a list of groups of axis names")


def check_list(name: str, values: Any) -> None:
    """Refuse what is not a list of numbers or of names."""
    try:
        array = np.asarray(values)
    except ValueError:  # ragged
        array = np.asarray(None)
    if array.ndim != 1 or array.dtype.kind not in "biufU":
        raise InputError(f"{name} is {_kind(values)}; it is a list of numbers, or of names")


def check_arrays(tree: Any, where: str = "shared") -> None:
    """Refuse data that a compiled program cannot take."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        held = isinstance(leaf, np.ndarray | np.generic | jax.Array | bool | int | float)
        if not held or not (jnp.issubdtype(_dtype(leaf), np.number) or _dtype(leaf) == np.bool_):
            raise InputError(
                f"{where}{jax.tree_util.keystr(path)} is {_kind(leaf)}; data are arrays of numbers, alone or in "
                "dictionaries, lists and tuples"
            )


def check_along(along: Along, axes: Mapping[str, Axis]) -> None:
    """Refuse data along an axis that there is not, or whose entries do not fit one program."""
    if along.axis not in axes:
        raise InputError(f"shared differs along {along.axis!r}; the axes are {', '.join(axes)}")

    def form(tree: Any) -> Any:
        leaves, structure = jax.tree.flatten(tree)
        return structure, [(np.shape(leaf), _dtype(leaf)) for leaf in leaves]

    for i, entry in enumerate(along.values):
        check_arrays(entry, f"shared: entry {i} ")
        if form(entry) != form(along.values[0]):
            raise InputError(
                f"shared: entry {i} along axis {along.axis} has other shapes or types than the first; one program "
                "computes all of them and needs equal ones"
            )


def _dtype(leaf: Any) -> Any:
    return leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype


def fault(name: str, error: Exception, path: Path, axes: Sequence[str]) -> str:
    """What is wrong with a function of a file that raised.

    Args:
        name: of the function.
        error: as caught.
        path: the file.
        axes: names that a point has.

    Returns:
        One line without the file's name.
    """
    if isinstance(error, jax.errors.JAXTypeError | jax.errors.JAXIndexError):
        return (
            f"{name} cannot be traced: it branches on an array, or makes a number of Python or an array of NumPy of "
            f"one; use jax.numpy, jax.lax.cond or jax.lax.fori_loop there ({told(error, path, 110)})"
        )
    lacks = isinstance(error, KeyError) and error.args and error.args[0] not in axes
    return f"{name} fails: {told(error, path)}" + (f" (a point has {', '.join(axes)})" if lacks else "")


def check_outputs(name: str, outputs: Any) -> None:
    """Refuse outputs of a function that are not arrays by name."""
    if not isinstance(outputs, Mapping) or not outputs:
        given = "nothing" if outputs is None or isinstance(outputs, Mapping) else _kind(outputs)
        raise InputError(f"{name} returns {given}; it returns a dictionary of arrays by name, as {{'loss': loss}}")
    for output, value in flatten(outputs).items():
        try:
            jnp.asarray(value)
        except (TypeError, ValueError):
            raise InputError(f"{name} returns {_kind(value)} as {output}; outputs are arrays of numbers") from None


def _kind(value: Any) -> str:
    """What a value is, in words."""
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"
