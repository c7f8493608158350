"""Points drawn from ranges: a search where a grid of many axes would be too large.

Values are rounded to four significant digits, so that a point can be read, typed and found again from the shell; more
digits would say nothing of a search. Points that are equal then are drawn once. The first n points are the same
whatever their number, so that a larger search goes on with a smaller one.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ovibjax.errors import InputError
from ovibjax.runtime.plain_numbers import plain_float

DIGITS = 4
"""Significant digits of a drawn value."""

_MOST = 1 << 20
"""More points than anybody trains."""

# So many times as many are drawn in search of different ones.
_PATIENCE = 64
_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Range:
    """Numbers to draw from, evenly or evenly in the logarithm.

    Attributes:
        low: smallest value.
        high: largest value.
        log: whether decades are equally likely.
        whole: whether values are whole numbers.
    """

    low: float
    high: float
    log: bool = False
    whole: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no range."""
        if not -_LARGEST <= self.low < self.high <= _LARGEST:
            raise InputError(f"{self}: a range goes from a lower to a higher number of 32 bits")
        if self.log and self.low <= 0:
            raise InputError(f"{self}: a logarithmic range begins above zero")
        if self.whole and (self.low % 1 or self.high % 1):
            raise InputError(f"{self}: a range of whole numbers goes from one of them to another")

    def __str__(self) -> str:
        return f"{'log' if self.log else 'lin'}:{self.low:g}:{self.high:g}"

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares of the range.

        Args:
            share: [n] from 0 to 1, 1 left out.

        Returns:
            [n] values as they are used: rounded, inside the range.
        """
        low, high = self.low, self.high + self.whole  # of whole numbers each is as likely as the others
        ends = np.log([low, high]) if self.log else np.array([low, high])
        values = ends[0] + share * (ends[1] - ends[0])
        values = np.exp(values) if self.log else values
        if self.whole:
            return np.clip(np.floor(values), self.low, self.high)
        rounded = np.array([float(f"{value:.{DIGITS}g}") for value in values.tolist()])
        return np.clip(rounded, self.low, self.high) + 0.0  # no -0


def parse(text: str, whole: bool = False) -> Range | None:
    """A range as it is typed.

    Args:
        text: `log:1e-5:1e-1` or `lin:0:1`.
        whole: whether values are to be whole numbers.

    Returns:
        The range; None for text that is none.

    Raises:
        InputError: a range that has no sense.

    Example:
        >>> parse("log:1e-5:1e-1")
        Range(low=1e-05, high=0.1, log=True, whole=False)
    """
    kind, _, rest = text.partition(":")
    if kind not in ("log", "lin"):
        return None
    try:
        low, high = (plain_float(part) for part in rest.split(":"))
    except ValueError:
        raise InputError(f"{text}: a range is log:LOW:HIGH or lin:LOW:HIGH, e.g. log:1e-5:1e-1") from None
    return Range(low, high, kind == "log", whole)


def sobol(ranges: Mapping[str, Range], n: int, seed: int = 0) -> dict[str, list[float]]:
    """Points of a scrambled Sobol sequence, which leave no part of the ranges empty.

    Args:
        ranges: a range per axis; their order does not matter.
        n: points; powers of two cover the ranges most evenly.
        seed: of the scrambling.

    Returns:
        n values per axis, which advance together (`zipped` of `run`); the first ones are those of a smaller n.

    Raises:
        InputError: no range, no point, or ranges that do not have so many different values.

    Example:
        >>> points = sobol({"beta": Range(1e-5, 1e-1, log=True), "share": Range(0, 1)}, 4)
        >>> points["beta"], sobol({"beta": Range(1e-5, 1e-1, log=True), "share": Range(0, 1)}, 2)["beta"]
        ([0.0004363, 0.007721, 0.04164, 7.39e-05], [0.0004363, 0.007721])
    """
    from scipy.stats import qmc

    def shares(rows: int) -> Iterator[np.ndarray]:
        engine = qmc.Sobol(len(ranges), rng=np.random.default_rng(seed))
        yield engine.random_base2(max(rows - 1, 1).bit_length())
        while True:
            yield engine.random(rows)

    return _drawn(ranges, n, seed, shares)


def random_points(ranges: Mapping[str, Range], n: int, seed: int = 0) -> dict[str, list[float]]:
    """Independent points.

    Args:
        ranges: a range per axis; their order does not matter.
        n: points.
        seed: of the draws.

    Returns:
        n values per axis, which advance together (`zipped` of `run`); the first ones are those of a smaller n.

    Raises:
        InputError: no range, no point, or ranges that do not have so many different values.

    Example:
        >>> sorted(random_points({"rate": Range(1, 3, whole=True)}, 3)["rate"])
        [1, 2, 3]
    """

    def shares(rows: int) -> Iterator[np.ndarray]:
        drawn = np.random.default_rng(seed)
        while True:
            yield drawn.random((rows, len(ranges)))

    return _drawn(ranges, n, seed, shares)


def _drawn(
    ranges: Mapping[str, Range], n: int, seed: int, shares: Callable[[int], Iterator[np.ndarray]]
) -> dict[str, list[float]]:
    """The first n different points of an endless sequence of shares [rows, axes]."""
    names = sorted(ranges)
    if not names or not 1 <= n <= _MOST:
        raise InputError(f"a search draws 1 to {_MOST} points" if names else "a search needs an axis that is a range")
    if seed < 0:
        raise InputError(f"search seed {seed} is negative")
    points: dict[tuple[float, ...], None] = {}
    for drawn, part in enumerate(shares(n), start=1):
        values = [ranges[name].at(part[:, i]).tolist() for i, name in enumerate(names)]
        points.update(dict.fromkeys(zip(*values, strict=True)))
        if len(points) >= n:
            break
        if drawn == _PATIENCE:
            said = " and ".join(f"{name} from {ranges[name]}" for name in names)
            raise InputError(
                f"{said}: there are not {n} different points of {DIGITS} digits; ask for fewer, or widen it"
            )
    table = np.array(list(points)[:n])
    columns = {name: table[:, i].tolist() for i, name in enumerate(names)}
    return {name: list(map(int, columns[name])) if drawn.whole else columns[name] for name, drawn in ranges.items()}
