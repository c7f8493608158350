"""Answers of every action against leave-one-out retrieval written out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ovibjax.control.actions import ACTIONS
from ovibjax.control.drives import ELSEWHERE_M, survey
from ovibjax.control.residuals import answers
from ovibjax.encoder.checkpoint import train_checkpoint
from ovibjax.encoder.model import decode, encode
from ovibjax.features.basis import project
from ovibjax.views import MODES
from tests.control.cases import TINY, drive
from tests.oracles import control as oracle


@pytest.mark.parametrize("recode", [False, True])
def test_residuals_are_those_of_leave_one_out_retrieval(recode):
    frames = drive(3)
    checkpoint = train_checkpoint(jax.random.key(0), frames.features, TINY)
    assert checkpoint.arch.latent == 128 and checkpoint.arch.view_dim == 8
    references = survey(frames.positions_m, frames.yaw_rad, np.zeros(120), 5.0, 360.0)
    found = answers(checkpoint, frames.features, frames.positions_m, references, ACTIONS, recode)
    places = frames.positions_m[references, :2]
    x = project(checkpoint.basis, frames.features)
    same = 0
    for a, (mode, k, _) in enumerate(oracle.action_list()):
        mask = np.zeros((5, 1), np.float32)
        mask[list(MODES[mode])] = 1
        shown = jnp.asarray((x * mask).reshape(120, -1))
        mu, _ = encode(checkpoint.params, shown, checkpoint.arch)
        kept = jnp.asarray(np.arange(128) < k, jnp.float32)
        decoded = np.asarray(decode(checkpoint.params, mu, kept, checkpoint.arch))
        decoded = (decoded.reshape(120, 5, -1) * mask).reshape(120, -1)
        own = [list(references).index(i) if i in references else -1 for i in range(120)]
        # References are as the edge has them: in the views of the request, uncompressed unless said.
        database = decoded if recode else (x * mask).reshape(120, -1)
        rows, distinctness = oracle.most_similar_other(decoded, database[references], own, places, ELSEWHERE_M)
        want = places[rows] - frames.positions_m[:, :2]
        equal = np.isclose(found.residual_m[:, a], want, atol=1e-4).all(axis=1)
        np.testing.assert_allclose(found.distinctness[equal, a], distinctness[equal], atol=1e-5)
        same += equal.mean()
        assert np.all(np.linalg.norm(found.residual_m[references, a], axis=-1) > 1.0)  # never itself
    assert same / 8 > 0.98  # near ties may fall either way in float32
