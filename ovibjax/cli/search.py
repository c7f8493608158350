"""Options of a search: points drawn from axes that are ranges, and halving, in place of every combination in full."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ovibjax.cli.options import require_positive
from ovibjax.errors import InputError
from ovibjax.sweep.sampling import Range, parse, random_points, sobol

if TYPE_CHECKING:
    import xarray

STEPS = "steps"
"""The axis of a halving that says how long a member was trained."""


@dataclass(frozen=True)
class SearchOptions:
    """How points are drawn where an axis is a range."""

    sobol: int | None = None
    """Draw so many points from the axes that are ranges (log:1e-5:1e-1, lin:0:1), spread by a scrambled Sobol sequence
    (powers of two are best); the other axes cross with them. More of them later add to the same store."""
    random: int | None = None
    """The same with independent points."""
    search_seed: int = 0
    """Another one draws other points."""


@dataclass(frozen=True)
class HalvingOptions:
    """Whether only the best points are trained to the end."""

    halving: int | None = None
    """Train all points for a part of the steps only; one in so many (3 is usual) goes on, by the mean over its seeds,
    and so on in --rungs. Those that are trained to the end have the bits of a whole training."""
    rungs: int | None = None
    """How often points are judged; by default so often that the first rung is about a ninth of the steps."""

    def check(self, shard: str | None, on: str) -> None:
        """Refuse what does not go together.

        Args:
            shard: the option.
            on: the option.

        Raises:
            InputError: rungs without halving, halving of shards or on a cluster, or an impossible number.
        """
        if self.halving is None:
            if self.rungs is not None:
                raise InputError(f"--rungs {self.rungs}: it is for --halving")
            return
        if self.halving < 2:
            raise InputError(f"--halving {self.halving}: one point in so many goes on, so give 2 or more")
        require_positive(self, "rungs")
        if shard is not None:
            raise InputError(f"--shard {shard}: --halving compares all points; leave one of the two out")
        if on != "local":
            raise InputError(f"--on {on}: --halving runs on this machine; leave one of the two out")


def halved_line(dataset: "xarray.Dataset", store: Path) -> str:
    """What a halving did, and how to look at it.

    Args:
        dataset: its results.
        store: where they are.

    Returns:
        Two lines.
    """
    rungs = dataset.attrs["rungs"]
    seeds = dataset.finished.size // sum(rung["points"] for rung in rungs)
    counts, steps = ([str(rung[name]) for rung in rungs] for name in ("points", "steps"))
    diverged = int(dataset.diverged.sum())
    line = f"{_listed(counts)} points of {seeds} {'seeds' if seeds > 1 else 'seed'} trained for {_listed(steps)} steps"
    line += f", {diverged} diverged" if diverged else ""
    line += f"; {dataset.attrs['spent']:.0%} of the steps of all of them: {store}"
    return f"{line}\nlook at the last: ovibjax show {store} --where {STEPS}={steps[-1]}"


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def range_or_none(
    option: str, items: Sequence[str], valid: Callable[[float], bool], rule: str, whole: bool = False
) -> Range | None:
    """The range that stands in place of an axis' values.

    Args:
        option: what stands before the items, `--beta ` or `--axis beta=`.
        items: what was typed after it.
        valid: whether a value is possible.
        rule: what possible values are, in words.
        whole: whether values are whole numbers.

    Returns:
        The range; None if there is none among the items.

    Raises:
        InputError: a range beside values, one without sense, or of impossible values.
    """
    try:
        found = [drawn for drawn in (parse(item, whole) for item in items) if drawn is not None]
    except InputError as error:
        raise InputError(f"{option}{error}") from None
    if not found:
        return None
    if len(items) > 1:
        raise InputError(f"{option}{' '.join(items)}: give one range, or values")
    if not (valid(found[0].low) and valid(found[0].high)):
        raise InputError(f"{option}{items[0]}: values are {rule}")
    return found[0]


def searched(
    axes: Mapping[str, Any], search: SearchOptions, named: Callable[[str], str] = "--{} ".format
) -> tuple[dict[str, Any], list[tuple[str, ...]]]:
    """Axes with points in place of ranges.

    Args:
        axes: values, or a `Range`, by name.
        search: the options.
        named: what stands before the values of an axis, see `range_or_none`.

    Returns:
        Values by name, and the group of axes that advance together; no group where nothing is a range.

    Raises:
        InputError: a range without a number of points, or the reverse.
    """
    require_positive(search, "sobol", "random")
    ranges = {name: axis for name, axis in axes.items() if isinstance(axis, Range)}
    if search.sobol is not None and search.random is not None:
        raise InputError(f"--sobol {search.sobol} and --random {search.random}: choose one of the two")
    n = search.sobol if search.random is None else search.random
    option = "--sobol" if search.random is None else "--random"
    if n is None:
        if ranges:
            name, drawn = next(iter(ranges.items()))
            raise InputError(
                f"{named(name)}{drawn} is a range: add --sobol N, the number of points to draw, or --random N"
            )
        if search.search_seed != 0:
            raise InputError(f"--search-seed {search.search_seed}: it is for --sobol and --random")
        return dict(axes), []
    if not ranges:
        raise InputError(f"{option} {n}: no axis is a range; give one as {named(next(iter(axes)))}log:1e-5:1e-1")
    try:
        points = (sobol if search.random is None else random_points)(ranges, n, search.search_seed)
    except InputError as error:
        raise InputError(f"{option} {n}: {error}") from None
    return {name: points.get(name, values) for name, values in axes.items()}, [tuple(ranges)]
