"""How far off the edge's answer is, for every frame and action (paper, Section "Local Belief and Predicted Edge Gain").

The edge keeps some frames of the scene as references, encoded by the same checkpoint, prefix and views as the request:
not the frozen localizer of `edge.judging`, whose references are uncompressed. Leave-one-out retrieval against them
gives the realised residual of each frame and action.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.edge.retrieval import leave_one_out
from ovibjax.encoder.checkpoint import Checkpoint
from ovibjax.encoder.model import Architecture, Params, decode, encode
from ovibjax.features.basis import project
from ovibjax.views import mode_mask


def residuals_m(
    checkpoint: Checkpoint, features: np.ndarray, positions_m: np.ndarray, references: np.ndarray, actions: ActionSet
) -> np.ndarray:
    """Realised residual of every frame and action: error of leave-one-out retrieval.

    Args:
        checkpoint: the encoder.
        features: [N, M, d] features of all frames of the scene.
        positions_m: [N, 3] their positions.
        references: rows that are in the edge's database.
        actions: modes and prefixes.

    Returns:
        [N, A, 2] horizontal error of the retrieved position, m.
    """
    x = jnp.asarray(project(checkpoint.basis, features).reshape(len(features), -1))
    own = np.full(len(features), -1, np.int32)
    own[references] = np.arange(len(references))
    found = np.asarray(
        _retrieve(checkpoint.params, x, jnp.asarray(references), jnp.asarray(own), checkpoint.arch, actions)
    )
    places = positions_m[references][:, :2]
    return (places[found].transpose(1, 0, 2) - positions_m[:, None, :2]).astype(np.float32)


@partial(jax.jit, static_argnames=("arch", "actions"))
def _retrieve(
    params: Params, x: jax.Array, references: jax.Array, own: jax.Array, arch: Architecture, actions: ActionSet
) -> jax.Array:
    """[A, N] retrieved rows of the database."""
    masks = jnp.stack([mode_mask(mode, arch.n_views) for mode in actions.modes for _ in actions.prefixes])

    def one(action: tuple[jax.Array, jax.Array]) -> jax.Array:
        view_mask, k = action
        return retrieve(params, encode_views(params, x, view_mask, arch), view_mask, k, references, own, arch)

    return jax.lax.map(one, (masks, jnp.asarray(actions.prefix)))


def encode_views(params: Params, x: jax.Array, view_mask: jax.Array, arch: Architecture) -> jax.Array:
    """Latent means [N, K] of frames x [N, M r] of which only the views of a mode [M] are seen."""
    return encode(params, x * jnp.repeat(view_mask, arch.view_dim)[None], arch)[0]


def retrieve(
    params: Params,
    mu: jax.Array,
    view_mask: jax.Array,
    k: jax.Array,
    references: jax.Array,
    own: jax.Array,
    arch: Architecture,
) -> jax.Array:
    """Leave-one-out retrieval of a prefix of every frame against the survey, encoded alike.

    Args:
        params: network parameters.
        mu: [N, K] latent means, see `encode_views`.
        view_mask: [M] views of the mode.
        k: prefix length.
        references: [R] rows that are in the database.
        own: [N] a frame's position in the database, or -1.
        arch: widths of the network (static).

    Returns:
        [N] int32 retrieved positions in the database.
    """
    prefix = (jnp.arange(arch.latent) < k).astype(jnp.float32)
    descriptor = decode(params, mu, prefix, arch) * jnp.repeat(view_mask, arch.view_dim)[None]
    return leave_one_out(descriptor, descriptor[references], own)
