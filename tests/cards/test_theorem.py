"""The card of the scheduler's theorem on small systems: what is measured, and that its verdicts can fail."""

import csv
import dataclasses

import numpy as np
import pytest

from ovibjax import sweep
from ovibjax.cards import theorem_study
from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.report.claims import HELD, NOT_HELD
from ovibjax.report.panels import draw_panels
from ovibjax.report.rows import write_rows
from ovibjax.scheduling.slotted_replay import Horizon

card = load_card(cards_folder() / "theorem.py")


class Job:
    """Sweeps in memory."""

    def sweep(self, description, fn, axes, shared, stage, **options):
        return sweep.run(fn, axes, shared, **options).assign_attrs(resumed=0)


@pytest.fixture(scope="module")
def found():
    size = theorem_study.TheoremSize(3, 16, (1.0, 4.0, 16.0), Horizon(100, 40))
    return theorem_study.measure(Job(), size, [3, 4, 5])


def verdicts(found):
    return {claim.statement: claim.verdict for claim in card.judge_claims(found)}


def test_the_theorem_holds_where_its_proof_does(found):
    by_statement = verdicts(found)
    assert [name for name, verdict in by_statement.items() if verdict == NOT_HELD] == [
        "Serving pending requests only, light load: utility gap at most C_0 / V"
    ]
    assert len(by_statement) == 9
    gap = {setting.name: found.at(setting, "gap") for setting in theorem_study.SETTINGS}
    assert all(values.shape == (3, 3) for values in gap.values())
    assert gap["pending_0.5"].min() > 0.5 and gap["shifted_0.5"][:, -1].max() < 0.2
    # The estimate with the benchmark's prices and the plain one agree to the noise of 3,200 slots.
    plain = found.runs.best - found.runs.utility
    assert float(abs(plain - found.runs.gap).max()) < 0.5


def test_tables(found, tmp_path):
    write_rows(tmp_path / "table.csv", card.table_rows(found))
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 3 * 3 and {row["reading"] for row in rows} == {"proof", "pending", "shifted"}
    assert np.isfinite([float(row[name]) for row in rows for name in ("utility_m", "gap_m", "best_m", "backlog")]).all()
    growth = card.growth_rows(found)
    assert len(growth) == len(theorem_study.LOADS) * 3 and {row["slots"] for row in growth} == {40, 400, 4000}
    assert all(row["least_of_any_policy"] > 0.01 if row["load"] > 1 else True for row in growth)


def test_verdicts_can_fail(found):
    worse = found.runs.assign(gap=2 * found.runs.gap_bound, backlog=2 * found.runs.backlog_bound)
    flat = found.growth.assign(measured=0 * found.growth.measured + 0.3)
    failed = verdicts(dataclasses.replace(found, runs=worse, growth=flat))
    assert set(failed.values()) == {NOT_HELD}
    assert HELD in verdicts(found).values()


def test_figure(found, tmp_path):
    draw_panels(tmp_path / "figure.png", found, card.PANELS, 3)
    assert (tmp_path / "figure.png").stat().st_size > 20_000
