"""How far off the edge's answer is, for every frame and action (paper, Section "Local Belief and Predicted Edge Gain").

The edge keeps some frames of the scene as references. Leave-one-out retrieval against them ("candidate residuals use
leave-one-out retrieval with the same-scene database") gives the realised residual of each frame and action, and how
distinct the answer is from the most similar reference in another place.

References are uncompressed, as in `edge.judging`: the database holds "reference descriptors" f_n (paper, Section
"System Architecture"), and the decoder "maps the latent representation back to the feature space. Its output is used by
the retrieval branch". References that have passed through the code of the request are there to compare with.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.drives import ELSEWHERE_M
from ovibjax.edge.retrieval import Match, leave_one_out
from ovibjax.encoder.checkpoint import Checkpoint
from ovibjax.encoder.model import Architecture, Params, decode, encode
from ovibjax.features.basis import project
from ovibjax.views import mode_mask


class Survey(NamedTuple):
    """The edge's database, and where frames that are localized stand in it.

    Attributes:
        rows: [R] frames that are references.
        own: [N] int32 a frame's position among them, or -1.
        places_m: [R, 2] where the references were taken.
    """

    rows: jax.Array
    own: jax.Array
    places_m: jax.Array


def make_survey(positions_m: np.ndarray, references: np.ndarray) -> Survey:
    """A database of some frames of a scene.

    Args:
        positions_m: [N, 2 or 3] positions of all frames.
        references: rows that the edge keeps.

    Returns:
        The database.
    """
    own = np.full(len(positions_m), -1, np.int32)
    own[references] = np.arange(len(references))
    places_m = np.asarray(positions_m, np.float32)[references, :2]
    return Survey(jnp.asarray(references, jnp.int32), jnp.asarray(own), jnp.asarray(places_m))


class Answers(NamedTuple):
    """What the edge answers for every frame and action.

    Attributes:
        residual_m: [N, A, 2] horizontal error of the retrieved position, m.
        distinctness: [N, A] see `edge.retrieval.Match`.
    """

    residual_m: np.ndarray
    distinctness: np.ndarray


def answers(
    checkpoint: Checkpoint,
    features: np.ndarray,
    positions_m: np.ndarray,
    references: np.ndarray,
    actions: ActionSet,
    recode: bool = False,
    sent: np.ndarray | None = None,
) -> Answers:
    """Leave-one-out retrieval of every frame with every action.

    Args:
        checkpoint: the encoder.
        features: [N, M, d] features of all frames of the scene.
        positions_m: [N, 3] their positions.
        references: rows that are in the edge's database.
        actions: modes and prefixes.
        recode: also pass the references through the code of the request.
        sent: [N, M, d] features that robots have of these frames, where they are not those that the edge has.

    Returns:
        Both, on the host.
    """

    def flat(features: np.ndarray) -> jax.Array:
        return jnp.asarray(project(checkpoint.basis, features).reshape(len(features), -1))

    x, asked = flat(features), None if sent is None else flat(sent)
    survey = make_survey(positions_m, references)
    found = jax.device_get(_retrieve(checkpoint.params, x, survey, checkpoint.arch, actions, recode, asked))
    places_m = np.asarray(survey.places_m)[found.row].transpose(1, 0, 2)
    return Answers((places_m - positions_m[:, None, :2]).astype(np.float32), found.distinctness.T)


@partial(jax.jit, static_argnames=("arch", "actions", "recode"))
def _retrieve(
    params: Params,
    x: jax.Array,
    survey: Survey,
    arch: Architecture,
    actions: ActionSet,
    recode: bool,
    asked: jax.Array | None,
) -> Match:
    """Leaves [A, N]; `asked` are the frames as robots see them, None for as the edge does."""
    frames = x if asked is None else asked
    masks = jnp.stack([mode_mask(mode, arch.n_views) for mode in actions.modes for _ in actions.prefixes])

    def one(action: tuple[jax.Array, jax.Array]) -> Match:
        view_mask, k = action
        return retrieve(params, x, encode_views(params, frames, view_mask, arch), (view_mask, k), survey, arch, recode)

    return jax.lax.map(one, (masks, jnp.asarray(actions.prefix)))


def encode_views(params: Params, x: jax.Array, view_mask: jax.Array, arch: Architecture) -> jax.Array:
    """Latent means [N, K] of frames x [N, M r] of which only the views of a mode [M] are seen."""
    return encode(params, x * jnp.repeat(view_mask, arch.view_dim)[None], arch)[0]


def retrieve(
    params: Params,
    x: jax.Array,
    mu: jax.Array,
    action: tuple[jax.Array, jax.Array],
    survey: Survey,
    arch: Architecture,
    recode: bool = False,
) -> Match:
    """Leave-one-out retrieval of a prefix of every frame against the survey, in the views of the request.

    Args:
        params: network parameters.
        x: [N, M r] frames.
        mu: [N, K] their latent means, see `encode_views`.
        action: [M] views of the mode, and prefix length.
        survey: the database.
        arch: widths of the network (static).
        recode: whether the references have passed through the code (static).

    Returns:
        [N] positions in the database, and how distinct they are.
    """
    view_mask, k = action
    shown = jnp.repeat(view_mask, arch.view_dim)[None]
    prefix = (jnp.arange(arch.latent) < k).astype(jnp.float32)
    descriptor = decode(params, mu, prefix, arch) * shown
    references = (descriptor if recode else x * shown)[survey.rows]
    return leave_one_out(descriptor, references, survey.own, survey.places_m, ELSEWHERE_M)
