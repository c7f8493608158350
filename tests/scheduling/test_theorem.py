"""What the theorem promises of each reading: constants recomputed, and the one-client example worked by hand."""

import jax
import numpy as np
import pytest

from ovibjax.scheduling.stationary import SlottedSystem, best_stationary, capacity, draw_system
from ovibjax.scheduling.theorem import Setting, empty_case, make_case, stack
from tests.oracles import slotted as oracle

VS = np.array([1.0, 10.0, 100.0])


def one_client():
    """A request worth 1 or 10 metres, which always fits; one request per slot is the edge."""
    ones = np.ones((2, 1), np.int32)
    return SlottedSystem(ones, ones, np.array([[1.0], [10.0]], np.float32), np.int32(1), np.int32(1))


@pytest.mark.parametrize(
    ("reading", "best", "price", "start", "lost"),
    [
        # Serving whenever possible meets every rate at no cost.
        ("proof", 5.5, 0.0, 0.0, 0.0),
        # A tenth of the slots, those worth 10; the comparison loses all the utility.
        ("pending", 1.0, -10.0, 0.0, 1.0),
        # The same with values -9 and 0: half of the slots serve at no cost, more of them at 9 each.
        ("shifted", 1.0, -10.0, 0.0, None),
    ],
)
def test_one_client(reading, best, price, start, lost):
    case, promise = make_case(one_client(), np.ones(1), Setting(reading, 0.1), VS)
    constant = 0.5 * (0.1 + 1.0)
    np.testing.assert_allclose(promise.best, best)
    np.testing.assert_allclose(promise.gap_bound, constant / VS)
    np.testing.assert_allclose(case.price, price, atol=1e-6)
    np.testing.assert_allclose(case.start, start, atol=1e-6)
    assert case.serve_empty == (reading == "proof") and case.rate == np.float32(0.1)
    assert case.offset == (10.0 if reading == "shifted" else 0.0)
    # Slacks of 0.09 and 0.891; the larger one must serve slots worth 1 as well where values are lowered by 10.
    if lost is None:
        lost = np.array([0.0, 9 * (0.1 + 0.891 - 0.5)])
    bounds = (constant + VS * np.broadcast_to(lost, 2)[:, None]) / np.array([[0.09], [0.891]])
    np.testing.assert_allclose(promise.backlog_bound, bounds.min(axis=0), rtol=1e-6)


def test_lowering_values_changes_neither_the_benchmark_nor_its_policy():
    system = draw_system(jax.random.key(0), states=32, clients=4)
    edge = capacity(system, np.ones(4)) * np.ones(4)
    pending, shifted = (make_case(system, edge, Setting(reading, 0.5), VS) for reading in ("pending", "shifted"))
    np.testing.assert_allclose(pending[1].best, shifted[1].best)
    np.testing.assert_allclose(pending[0].price, shifted[0].price, atol=1e-5)
    offset = shifted[0].offset
    np.testing.assert_array_equal(offset, system.voi.max(axis=0))
    # Lowered values leave no reason to serve more than what arrives: at least and exactly agree.
    lowered = system._replace(voi=system.voi - offset)
    at_least = best_stationary(lowered, 0.5 * edge, exactly=False)
    assert at_least.utility + float(offset @ (0.5 * edge)) == pytest.approx(pending[1].best[0], rel=1e-5)
    assert at_least.price.min() >= 0
    np.testing.assert_allclose(at_least.price, shifted[0].start, atol=1e-4)
    assert oracle.dual_value(at_least.price, 0.5 * edge, lowered) == pytest.approx(at_least.utility, rel=1e-5)


def test_labels_refusals_and_stacking():
    assert Setting("proof", 0.9).name == "proof_0.9"
    for wrong in (Setting("literal", 0.5), Setting("proof", 1.0), Setting("proof", 0.0)):
        with pytest.raises(ValueError, match=r"not one of proof, pending, shifted"):
            make_case(one_client(), np.ones(1), wrong, VS)
    cases = stack([empty_case(np.array([0.1, 0.2])), empty_case(np.array([0.3, 0.4]))])
    np.testing.assert_allclose(cases.rate, [[0.1, 0.2], [0.3, 0.4]], rtol=1e-6)
    assert cases.serve_empty.tolist() == [False, False]
    assert all(leaf.dtype == np.float32 for leaf in cases if leaf.dtype != bool)
