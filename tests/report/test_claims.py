import json

import numpy as np
import pytest
import scipy.stats

from ovibjax.report.claims import (
    HELD,
    NOT_HELD,
    ON_AVERAGE,
    REPORTED,
    Claim,
    above,
    below,
    interval,
    positive,
    read_claims,
    weakest,
    write_claims,
)
from ovibjax.report.page import write_page


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


def test_page_shows_every_claim(tmp_path) -> None:
    folder = tmp_path / "one"
    folder.mkdir()
    claims = [Claim(f"claim | {verdict}", "1", "2", verdict, "rule") for verdict in (HELD, NOT_HELD, REPORTED)]
    write_claims(folder / "claims.json", claims)
    assert read_claims(folder / "claims.json") == claims
    (folder / "provenance.json").write_text(json.dumps({"title": "One", "preset": "smoke", "seeds": "0"}))
    (folder / "small.csv").write_text("a,b\n1,2\n")
    page = write_page(tmp_path).read_text()
    assert "## One" in page and "one/figure.png" in page and "| 1 | 2 |" in page
    for verdict in (HELD, NOT_HELD, REPORTED):
        assert f"claim \\| {verdict}" in page


def test_a_claim_of_several_parts_is_as_good_as_its_weakest() -> None:
    assert weakest([HELD, HELD]) == HELD
    assert weakest([HELD, ON_AVERAGE]) == ON_AVERAGE
    assert weakest(iter([ON_AVERAGE, NOT_HELD, HELD])) == NOT_HELD


def test_no_difference_at_all_is_not_held() -> None:
    assert positive(interval([0.0, 0.0, 0.0])) == NOT_HELD
    assert positive(interval([1.0, 1.1, 0.9])) == HELD
    assert positive(interval([3.0, -1.0, 0.1])) == ON_AVERAGE
    assert positive(interval([-1.0, -1.1, -0.9])) == NOT_HELD
