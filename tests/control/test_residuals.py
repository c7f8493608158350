"""Residuals of every action against leave-one-out retrieval written out."""

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ACTIONS
from ovibjax.control.drives import survey
from ovibjax.control.residuals import residuals_m
from ovibjax.encoder.checkpoint import train_checkpoint
from ovibjax.encoder.model import decode, encode
from ovibjax.features.basis import project
from ovibjax.views import MODES
from tests.control.cases import TINY, drive
from tests.oracles import control as oracle


def test_residuals_are_those_of_leave_one_out_retrieval():
    frames = drive(3)
    checkpoint = train_checkpoint(jax.random.key(0), frames.features, TINY)
    assert checkpoint.arch.latent == 128 and checkpoint.arch.view_dim == 8
    references = survey(frames.positions_m, frames.yaw_rad, np.zeros(120), 5.0, 360.0)
    found = residuals_m(checkpoint, frames.features, frames.positions_m, references, ACTIONS)
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
        rows = references[oracle.most_similar_other(decoded, decoded[references], own)]
        want = frames.positions_m[rows, :2] - frames.positions_m[:, :2]
        same += np.isclose(found[:, a], want, atol=1e-4).all(axis=1).mean()
        assert np.all(np.linalg.norm(found[references, a], axis=-1) > 1.0)  # never itself
    assert same / 8 > 0.98  # near ties may fall either way in float32
