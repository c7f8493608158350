"""Numbers, names and payloads of the actions."""

import numpy as np

from ovibjax.control.actions import ACTIONS
from tests.oracles import control as oracle


def test_actions():
    listed = oracle.action_list()
    np.testing.assert_array_equal(ACTIONS.payload_bytes, [size for _, _, size in listed])
    np.testing.assert_array_equal(ACTIONS.prefix, [k for _, k, _ in listed])
    assert ACTIONS.names == ("F-C", "F-R", "FS-C", "FS-R", "H4-C", "H4-R", "A5-C", "A5-R")
    assert [ACTIONS.index(mode, k) for mode, k, _ in listed] == list(range(len(ACTIONS)))
