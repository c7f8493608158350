"""Which frames of a drive the edge keeps."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ovibjax.control.drives import survey
from tests.oracles import control as oracle


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.0, 0.5, 3.0, 1e9]), st.sampled_from([20.0, 1e9]))
def test_survey(seed, spacing, turn_deg):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    position = np.cumsum(rng.exponential(size=(n, 3)), axis=0)
    drives = np.sort(rng.integers(0, 3, n))
    yaw = rng.uniform(-4, 4, n) if seed % 2 else np.cumsum(rng.normal(scale=0.2, size=n))
    kept = survey(position, yaw, drives, spacing, turn_deg)
    np.testing.assert_array_equal(kept, oracle.survey(position, yaw, drives, spacing, turn_deg))
    assert set(kept[np.r_[True, np.diff(drives[kept]) > 0]]) == {int(np.argmax(drives == d)) for d in set(drives)}
    assert spacing > 0 or len(kept) == n
