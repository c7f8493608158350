"""The report's check of the lemmas and the theorem."""

import pytest

from ovibjax.encoder import bound_margins as theory


def test_the_paper_holds_on_random_models():
    checks = theory.check_bounds(models=60)
    assert [check.statement.split(":")[0] for check in checks] == ["Lemma 1", "Lemma 2", "Theorem 1"]
    for check in checks:
        assert check.deviation < 1e-4 and check.gap_nats >= 0


@pytest.mark.parametrize(
    "field", ["bound", *(pytest.param(name, marks=pytest.mark.long) for name in ("rate", "log_likelihood"))]
)
def test_a_wrong_term_is_seen(monkeypatch, field):
    right = theory.bounds

    def wrong(model, decoder, beta):
        found = right(model, decoder, beta)
        return found._replace(**{field: getattr(found, field) * 1.01})

    monkeypatch.setattr(theory, "bounds", wrong)
    assert max(check.deviation for check in theory.check_bounds(models=20)) > 1e-4
