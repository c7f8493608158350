"""Which points of the whole system's grid are outlined."""

import numpy as np

from ovibjax.cards.system_drawing import pareto


def test_the_front_holds_what_nothing_beats() -> None:
    points = np.array([[0.0, 2.0], [1.0, 1.0], [2.0, 0.0], [1.0, 2.0], [2.0, 2.0]])
    np.testing.assert_array_equal(pareto(points), [True, True, True, False, False])


def test_equal_points_are_both_on_the_front() -> None:
    assert pareto(np.array([[1.0, 1.0], [1.0, 1.0]])).all()
