"""Slots planned ahead against the oracle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.planning import FOLLOW_VOI, planned_slots
from ovibjax.control.policies import POLICIES
from tests.control.cases import controller
from tests.oracles import control as oracle

planned = jax.jit(planned_slots, static_argnames="policy")


@pytest.mark.parametrize("slots", [1, 2, 60, 61])
def test_planned_slots_equal_the_oracle(slots):
    rng = np.random.default_rng(slots)
    control = controller(rules={"period_s": 2.0})
    for count in range(slots + 1):
        asked = np.sort(rng.permutation(slots)[:count])
        sent = np.zeros(slots, bool)
        sent[asked] = True
        rank = rng.permutation(slots).astype(np.int32)
        phase = np.float32(rng.random())
        for policy in POLICIES:
            found = np.flatnonzero(planned(policy, jnp.float32(0.5), rank, phase, control, sent))
            want = oracle.planned_slots(policy, slots, 0.5, 2.0, phase, rank, asked.tolist())
            assert found.tolist() == sorted(want), (policy, count)
            if policy in FOLLOW_VOI:
                assert len(found) == count
            if policy == "budgeted_periodic" and count > 1:
                gaps = np.diff(found)
                assert gaps.max() - gaps.min() <= 1
