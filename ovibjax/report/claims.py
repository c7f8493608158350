"""Claims: a statement, the paper's number, ours with its interval, and a verdict by a stated rule.

A card states a claim with one of the constructors of `Claim`: each knows its verdict and words its rule, so that what
is left to say is the statement, the numbers and their text.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

HELD, ON_AVERAGE, NOT_HELD, REPORTED = "held", "held on average", "not held", "reported"
SILENT = "says nothing here"
PAIRED = "the whole interval of the paired difference above zero"

Seeds = ArrayLike
"""[S] one number per seed."""


@dataclass(frozen=True)
class Interval:
    """A mean over seeds with its 95 % interval.

    Attributes:
        mean: mean over seeds.
        half: half-width of the interval (Student's t); infinite for a single seed.
    """

    mean: float
    half: float

    @property
    def low(self) -> float:
        """Lower end."""
        return self.mean - self.half

    @property
    def high(self) -> float:
        """Upper end."""
        return self.mean + self.half

    @property
    def cap(self) -> float:
        """Half-width as it is drawn: zero for a single seed, whose interval has no end."""
        return self.half if np.isfinite(self.half) else 0.0

    def text(self, unit: str = "", digits: int = 2) -> str:
        """`mean ± half unit`, without the half-width where there is only one seed."""
        spread = f" ± {self.half:.{digits}f}" if np.isfinite(self.half) else ""
        return f"{self.mean:.{digits}f}{spread}{' ' + unit if unit else ''}"


def interval(values: Seeds) -> Interval:
    """95 % interval of the mean of independent seeds.

    Args:
        values: one number per seed.

    Returns:
        The interval; its mean is not a number where there is no seed, and every verdict on that is "not held".
    """
    array = np.asarray(values, np.float64)
    if len(array) == 0:
        return Interval(float("nan"), float("inf"))
    if len(array) < 2:
        return Interval(float(array.mean()), float("inf"))
    t = float(stdtrit(len(array) - 1, 0.975))
    return Interval(float(array.mean()), float(t * array.std(ddof=1) / np.sqrt(len(array))))


@dataclass(frozen=True)
class Claim:
    """One judged statement.

    Attributes:
        statement: what is claimed, in one sentence.
        paper: the paper's figure, or "-" where the paper makes none.
        ours: our figure.
        verdict: one of held, held on average, not held, reported, says nothing here.
        rule: how the verdict follows from the figure.
        own: whether the statement is ours and not the paper's.
    """

    statement: str
    paper: str
    ours: str
    verdict: str
    rule: str
    own: bool = False

    @property
    def text(self) -> str:
        """The statement, with a mark where it is ours."""
        return f"{self.statement} (ours)" if self.own else self.statement

    def as_own(self) -> Self:
        """The same claim, marked as ours: an expectation of this project that the paper does not state."""
        return replace(self, own=True)

    @classmethod
    def less(
        cls,
        statement: str,
        paper: str,
        ours: str,
        smaller: Seeds,
        *larger: Seeds,
        rule: str = PAIRED,
        strict: bool = False,
    ) -> Self:
        """A quantity is below another on paired seeds, or below every one of several others.

        Args:
            statement: what is claimed.
            paper: the paper's figure.
            ours: our figure.
            smaller: [S] the quantity.
            larger: [S] each, on the same seeds.
            rule: how the rule is worded.
            strict: whether a mean alone counts for nothing.

        Returns:
            The claim; held if every paired interval of the difference lies above zero, held on average if the means do.
        """
        differences = [interval(np.asarray(other) - np.asarray(smaller)) for other in larger]
        return cls(statement, paper, ours, _judged(differences, positive, strict), rule)

    @classmethod
    def above_zero(
        cls, statement: str, paper: str, ours: str, *values: Seeds, rule: str = PAIRED, strict: bool = False
    ) -> Self:
        """A quantity, or every one of several, is positive: `less` with the differences at hand."""
        return cls(statement, paper, ours, _judged(map(interval, values), positive, strict), rule)

    @classmethod
    def at_least(cls, statement: str, paper: str, ours: str, limit: float, *values: Seeds, rule: str) -> Self:
        """A quantity, or every one of several, is at least a limit; held if the whole interval is."""
        return cls(statement, paper, ours, weakest(above(interval(value), limit) for value in values), rule)

    @classmethod
    def at_most(cls, statement: str, paper: str, ours: str, limit: float, *values: Seeds, rule: str) -> Self:
        """A quantity, or every one of several, is at most a limit; held if the whole interval is."""
        return cls(statement, paper, ours, weakest(below(interval(value), limit) for value in values), rule)

    @classmethod
    def ratio_at_least(
        cls, statement: str, paper: str, ours: str, limit: float, numerator: Seeds, denominator: Seeds
    ) -> Self:
        """A ratio on paired seeds is at least a limit; held if the whole interval of the ratio is."""
        ratio = np.asarray(numerator) / np.asarray(denominator)
        return cls.at_least(
            statement, paper, ours, limit, ratio, rule=f"interval of the paired ratio at least {limit:g}"
        )

    @classmethod
    def ratio_at_most(
        cls, statement: str, paper: str, ours: str, limit: float, numerator: Seeds, denominator: Seeds
    ) -> Self:
        """A ratio on paired seeds is at most a limit; held if the whole interval of the ratio is."""
        ratio = np.asarray(numerator) / np.asarray(denominator)
        return cls.at_most(statement, paper, ours, limit, ratio, rule=f"interval of the paired ratio at most {limit:g}")

    @classmethod
    def within(cls, statement: str, paper: str, ours: str, tolerance: float, difference: Seeds, *, rule: str) -> Self:
        """A difference on paired seeds is no larger than a tolerance, either way; held if its whole interval is not."""
        return cls(statement, paper, ours, near_zero(interval(difference), tolerance), rule)

    @classmethod
    def rising(cls, statement: str, paper: str, ours: str, *values: Seeds, rule: str) -> Self:
        """A quantity does not fall from any setting to the next, and is larger at the last than at the first.

        Args:
            statement: what is claimed.
            paper: the paper's figure.
            ours: our figure.
            values: [S] the quantity at each setting, in order, on the same seeds.
            rule: how the rule is worded.

        Returns:
            The claim; held if every paired interval says so, held on average if the means of the steps do.
        """
        at = [np.asarray(value) for value in values]
        steps = [above(interval(after - before), 0.0) for before, after in pairwise(at)]
        end = _judged([interval(at[-1] - at[0])], positive, strict=True)
        return cls(statement, paper, ours, weakest([*steps, end]), rule)

    @classmethod
    def true(cls, statement: str, paper: str, ours: str, condition: bool, rule: str) -> Self:
        """A fact without an interval: held if the condition is true."""
        return cls(statement, paper, ours, HELD if condition else NOT_HELD, rule)

    @classmethod
    def reported(cls, statement: str, paper: str, ours: str, rule: str) -> Self:
        """A figure that is shown and not judged; the rule says why, or how it was made."""
        return cls(statement, paper, ours, REPORTED, rule)

    @classmethod
    def silent(cls, statement: str, paper: str, ours: str, rule: str) -> Self:
        """A statement whose premise is not met here, so that it can be neither confirmed nor refuted."""
        return cls(statement, paper, ours, SILENT, rule)


def below(value: Interval, limit: float) -> str:
    """Verdict on `value <= limit`: held if the whole interval lies below, held on average if the mean does."""
    if not value.mean <= limit:
        return NOT_HELD
    return HELD if value.high <= limit else ON_AVERAGE


def above(value: Interval, limit: float) -> str:
    """Verdict on `value >= limit`, as `below`."""
    if not value.mean >= limit:
        return NOT_HELD
    return HELD if value.low >= limit else ON_AVERAGE


def positive(value: Interval) -> str:
    """Verdict on `value > 0`, as `above` but strict: no difference at all is not a difference."""
    if not value.mean > 0:
        return NOT_HELD
    return HELD if value.low > 0 else ON_AVERAGE


def near_zero(value: Interval, tolerance: float) -> str:
    """Verdict on `-tolerance <= value <= tolerance`, as `below`."""
    return weakest([below(value, tolerance), above(value, -tolerance)])


def weakest(verdicts: Iterable[str]) -> str:
    """Verdict on a claim with several parts: as good as its weakest part."""
    return max(verdicts, key=(HELD, ON_AVERAGE, NOT_HELD).index)


def _judged(values: Iterable[Interval], rule: Callable[[Interval], str], strict: bool) -> str:
    verdict = weakest(map(rule, values))
    return NOT_HELD if strict and verdict == ON_AVERAGE else verdict


def write_claims(path: Path, claims: Sequence[Claim]) -> None:
    """Write claims as JSON."""
    path.write_text(json.dumps([asdict(claim) for claim in claims], indent=1, ensure_ascii=False) + "\n")


def read_claims(path: Path) -> list[Claim]:
    """Read claims written by `write_claims`."""
    return [Claim(**entry) for entry in json.loads(path.read_text())]
