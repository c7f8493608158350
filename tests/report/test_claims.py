import numpy as np
import pytest
import scipy.stats

from ovibjax.report.claims import (
    HELD,
    NOT_HELD,
    ON_AVERAGE,
    REPORTED,
    SILENT,
    Claim,
    above,
    below,
    interval,
    near_zero,
    positive,
    read_claims,
    weakest,
    write_claims,
)


@pytest.mark.parametrize("n", [2, 3, 5, 10, 16])
def test_interval_is_students(n: int) -> None:
    values = np.random.default_rng(n).normal(3.0, 2.0, n)
    ours = interval(values)
    low, high = scipy.stats.t.interval(0.95, n - 1, loc=values.mean(), scale=scipy.stats.sem(values))
    np.testing.assert_allclose([ours.low, ours.high], [low, high], rtol=2e-4)


def test_one_seed_proves_nothing() -> None:
    single = interval([1.0])
    assert np.isinf(single.half)
    assert below(single, 2.0) == ON_AVERAGE
    assert single.text("m") == "1.00 m"


def test_verdicts_follow_the_interval() -> None:
    tight, wide = interval([1.0, 1.01, 0.99]), interval([0.5, 1.5, 1.0])
    assert below(tight, 1.2) == HELD and below(wide, 1.2) == ON_AVERAGE and below(tight, 0.9) == NOT_HELD
    assert above(tight, 0.9) == HELD and above(wide, 0.9) == ON_AVERAGE and above(tight, 1.2) == NOT_HELD


def test_claims_come_back_as_they_were_written(tmp_path) -> None:
    claims = [Claim("a | b", "1", "2 ± 3", HELD, "rule").as_own(), Claim.silent("premise", "-", "2", "rule")]
    write_claims(tmp_path / "claims.json", claims)
    assert read_claims(tmp_path / "claims.json") == claims


def test_a_claim_of_several_parts_is_as_good_as_its_weakest() -> None:
    assert weakest([HELD, HELD]) == HELD
    assert weakest([HELD, ON_AVERAGE]) == ON_AVERAGE
    assert weakest(iter([ON_AVERAGE, NOT_HELD, HELD])) == NOT_HELD


def test_no_difference_at_all_is_not_held() -> None:
    assert positive(interval([0.0, 0.0, 0.0])) == NOT_HELD
    assert positive(interval([1.0, 1.1, 0.9])) == HELD
    assert positive(interval([3.0, -1.0, 0.1])) == ON_AVERAGE
    assert positive(interval([-1.0, -1.1, -0.9])) == NOT_HELD


SEEDS = np.array([1.0, 1.1, 0.9])


def claim(constructor: str, *numbers, **options) -> str:
    return getattr(Claim, constructor)("statement", "paper", "ours", *numbers, **options).verdict


def test_less_is_judged_on_paired_differences() -> None:
    noise = np.array([-5.0, 0.0, 5.0])
    assert claim("less", noise, noise + SEEDS) == HELD
    assert claim("less", SEEDS, SEEDS + noise + 0.1) == ON_AVERAGE
    assert claim("less", SEEDS, SEEDS + noise + 0.1, strict=True) == NOT_HELD
    assert claim("less", SEEDS, SEEDS) == NOT_HELD
    assert claim("less", noise, noise + SEEDS, noise + 1.0, noise - 1.0) == NOT_HELD, "below every one of them"
    assert claim("above_zero", SEEDS, SEEDS + noise) == ON_AVERAGE


def test_limits_and_ratios() -> None:
    assert claim("at_most", 1.3, SEEDS, rule="r") == HELD and claim("at_most", 1.05, SEEDS, rule="r") == ON_AVERAGE
    assert claim("at_least", 0.7, SEEDS, rule="r") == HELD and claim("at_least", 1.2, SEEDS, rule="r") == NOT_HELD
    ratio = Claim.ratio_at_least("s", "p", "o", 10.0, 11.0 * SEEDS, SEEDS)
    assert (ratio.verdict, ratio.rule) == (HELD, "interval of the paired ratio at least 10")
    ratio = Claim.ratio_at_most("s", "p", "o", 1.15, 1.2 * SEEDS, SEEDS)
    assert (ratio.verdict, ratio.rule) == (NOT_HELD, "interval of the paired ratio at most 1.15")


def test_within_looks_both_ways() -> None:
    assert claim("within", 0.5, SEEDS - 1.0, rule="r") == HELD
    assert claim("within", 0.1, SEEDS - 1.0, rule="r") == ON_AVERAGE
    assert claim("within", 0.1, SEEDS, rule="r") == NOT_HELD == near_zero(interval(-SEEDS), 0.1)


@pytest.mark.parametrize("nothing", [[], [np.nan, np.nan, np.nan]])
def test_what_was_not_measured_is_not_held(nothing) -> None:
    values = np.array(nothing)
    assert claim("above_zero", values) == NOT_HELD
    assert claim("at_most", 1.0, values, rule="r") == NOT_HELD == claim("at_least", 1.0, values, rule="r")
    assert claim("within", 1.0, values, rule="r") == NOT_HELD


def test_facts_and_reports() -> None:
    assert claim("true", True, "r") == HELD and claim("true", False, "r") == NOT_HELD
    assert claim("reported", "r") == REPORTED and claim("silent", "r") == SILENT
    assert interval([1.0]).cap == 0.0 and interval(SEEDS).cap == interval(SEEDS).half


def test_rising_looks_at_every_step_and_at_the_ends() -> None:
    level, unsure = np.zeros(3), np.array([0.2, 0.1, -0.1])
    assert claim("rising", level, level, SEEDS, rule="r") == HELD
    assert claim("rising", level, unsure, SEEDS, rule="r") == ON_AVERAGE
    assert claim("rising", level, -unsure, SEEDS, rule="r") == NOT_HELD, "a step down"
    assert claim("rising", level, level, rule="r") == NOT_HELD, "no rise"
    assert claim("rising", level, unsure, rule="r") == NOT_HELD, "a rise that seeds do not agree on"
