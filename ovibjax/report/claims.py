"""Claims: a statement, the paper's number, ours with its interval, and a verdict by a stated rule."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

HELD, ON_AVERAGE, NOT_HELD, REPORTED = "held", "held on average", "not held", "reported"


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

    def text(self, unit: str = "", digits: int = 2) -> str:
        """`mean ± half unit`, without the half-width where there is only one seed."""
        spread = f" ± {self.half:.{digits}f}" if np.isfinite(self.half) else ""
        return f"{self.mean:.{digits}f}{spread}{' ' + unit if unit else ''}"


def interval(values: Sequence[float] | np.ndarray) -> Interval:
    """95 % interval of the mean of independent seeds.

    Args:
        values: one number per seed.

    Returns:
        The interval.
    """
    array = np.asarray(values, np.float64)
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
        verdict: one of held, held on average, not held, reported.
        rule: how the verdict follows from the figure.
    """

    statement: str
    paper: str
    ours: str
    verdict: str
    rule: str


def below(value: Interval, limit: float) -> str:
    """Verdict on `value <= limit`: held if the whole interval lies below, held on average if the mean does."""
    if value.mean > limit:
        return NOT_HELD
    return HELD if value.high <= limit else ON_AVERAGE


def above(value: Interval, limit: float) -> str:
    """Verdict on `value >= limit`, as `below`."""
    if value.mean < limit:
        return NOT_HELD
    return HELD if value.low >= limit else ON_AVERAGE


def positive(value: Interval) -> str:
    """Verdict on `value > 0`, as `above` but strict: no difference at all is not a difference."""
    if value.mean <= 0:
        return NOT_HELD
    return HELD if value.low > 0 else ON_AVERAGE


def weakest(verdicts: Iterable[str]) -> str:
    """Verdict on a claim with several parts: as good as its weakest part."""
    return max(verdicts, key=(HELD, ON_AVERAGE, NOT_HELD).index)


def write_claims(path: Path, claims: Sequence[Claim]) -> None:
    """Write claims as JSON."""
    path.write_text(json.dumps([asdict(claim) for claim in claims], indent=1, ensure_ascii=False) + "\n")


def read_claims(path: Path) -> list[Claim]:
    """Read claims written by `write_claims`."""
    return [Claim(**entry) for entry in json.loads(path.read_text())]
