"""The retrieval card: choice of the operating point, verdicts that can fail, one scene from start to end."""

import numpy as np
import pytest

from ovibjax.cards.catalog import cards_folder, load_card
from ovibjax.cards.job import Job
from ovibjax.cards.retrieval_benchmark import Point
from ovibjax.cards.retrieval_drawing import draw
from ovibjax.cards.retrieval_study import (
    PREFIXES,
    TILE_COUNTS,
    RetrievalStudy,
    StudySize,
    choose,
    measure,
    table_rows,
)
from ovibjax.edge.pruning import Pruning
from ovibjax.errors import InputError
from ovibjax.features.frames import make_feature_set
from ovibjax.report.claims import HELD, NOT_HELD

card = load_card(cards_folder() / "retrieval.py")


def outcome(tile_hit, pruned, excess_m=2.0, kept_excess_m=0.0, scene_hit=1.0, draws=4):
    """[draw, scenes, tiles] outcomes around the given means."""
    shape = (draws, 5, len(TILE_COUNTS))
    values = {"tile_hit": tile_hit, "pruned": pruned, "kept_excess_m": kept_excess_m, "scene_hit": scene_hit}
    values |= {"error_m": 2.6 + excess_m, "brute_m": 2.6, "error_hit_m": 2.6 + kept_excess_m, "brute_hit_m": 2.6}
    noise = 1e-4 * np.arange(draws)[:, None, None]
    full = {name: np.broadcast_to(values.get(name, 0.0) + noise, shape) for name in Pruning._fields}
    return Pruning(**full | {"brute_m": np.full(shape, 2.6), "brute_hit_m": np.full(shape, 2.6)})


def found(part, **changes):
    growth = [{"n": n, "brute": n / 1e4, "fine_2": 1.0, "fine_all": n**0.5, "recall": 1.0} for n in (1e3, 1e4)]
    times = {name: [1.0, 2.0, 3.0] for name in ("brute_1", "fine_1", "brute_all", "fine_all")}
    by_prefix = {k: Pruning(*(np.asarray(field)[:, 0, 0] for field in part)) for k in PREFIXES}
    fields = {"seeds": [100, 101, 102, 103], "n_scenes": 5, "grid": {10.0: part}, "paper": Point(2, 12, 10.0)}
    fields |= {"chosen": Point(5, 12, 10.0), "by_prefix": by_prefix, "times": times, "growth": growth}
    return RetrievalStudy(**fields | changes)


def verdicts(part):
    return [claim.verdict for claim in card.judge_claims(found(part))[:7]]


def test_verdicts_can_fail():
    assert verdicts(outcome(0.99, 0.93)) == [HELD] * 7
    assert verdicts(outcome(0.95, 0.93))[:2] == [NOT_HELD, HELD]
    assert verdicts(outcome(0.99, 0.85))[0] == NOT_HELD
    # Errors that come without a miss.
    assert verdicts(outcome(0.99, 0.93, kept_excess_m=0.3))[1:3] == [NOT_HELD, NOT_HELD]
    assert verdicts(outcome(0.99, 0.93, kept_excess_m=-0.3))[1:3] == [NOT_HELD, NOT_HELD]
    assert verdicts(outcome(0.99, 0.93, excess_m=-0.1))[2] == NOT_HELD
    assert verdicts(outcome(0.99, 0.93, scene_hit=0.7))[6] == NOT_HELD


def test_the_operating_point_prunes_most_among_those_with_enough_recall():
    tuned = {5.0: outcome(0.97, 0.99), 10.0: outcome(0.99, 0.95), 20.0: outcome(0.995, 0.90)}
    assert choose(tuned, [1, 2], [8, 12])[2] == 10.0
    assert choose({5.0: tuned[5.0], 1.0: outcome(0.5, 1.0)}, [2], [12]) == (2, 12, 5.0)


def test_slopes_and_tables_and_figure(tmp_path):
    result = found(outcome(0.99, 0.93))
    assert result.slope("brute") == pytest.approx(1.0) and result.slope("fine_all") == pytest.approx(0.5)
    rows = table_rows(result)
    assert len(rows) == 5 * len(TILE_COUNTS) and rows[0]["tile_m"] == 10.0
    assert np.isfinite([value for row in rows for value in row.values()]).all()
    draw(tmp_path / "figure.png", result)
    assert (tmp_path / "figure.png").stat().st_size > 20_000


@pytest.mark.slow
def test_one_scene_of_ones_own(tmp_path):
    rng = np.random.default_rng(0)
    at = np.cumsum(rng.normal(size=(240, 3)), axis=0)
    mix = rng.normal(size=(3, 4 * 12))
    features = np.tanh(at @ mix / 8).reshape(240, 4, 12) + 0.01 * rng.normal(size=(240, 4, 12))
    sets = make_feature_set(features, at)
    job = Job("retrieval", "smoke", tmp_path, 100, sets, "mine.npz", None)
    size = StudySize(1, 0, 20, 1, 2, 20, (4.0,), (300, 600), 1)
    result = measure(job, size)
    assert result.n_scenes == 1 and result.paper.scenes == 1
    everything = result.at(Point(1, TILE_COUNTS[-1], 4.0), "same")
    assert everything.shape == (2,) and np.all(everything >= result.at(Point(1, 1, 4.0), "same"))
    assert np.all(result.at(result.chosen, "scene_hit") == 1)
    draw(tmp_path / "figure.png", result)
    few = sets._replace(scene_id=(np.arange(240) > 230).astype(np.int32))
    with pytest.raises(InputError, match="scene_id"):
        measure(Job("retrieval", "smoke", tmp_path, 100, few, "mine.npz", None), size)
