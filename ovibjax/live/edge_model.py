"""From a received code to a position: decode, retrieve, expect a residual; compiled once, before anybody asks."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.drives import ELSEWHERE_M
from ovibjax.edge.retrieval import best_of, normalize
from ovibjax.encoder.model import Architecture, Params, decode
from ovibjax.live.edge_file import EdgeFile
from ovibjax.views import mode_mask

_DECODER = ("decoder", "completion", "principal", "descriptor")
_DECLARED = ("encoder_1_bias", "head_1_bias")  # the network asks for them whatever part of it is used


class EdgeModel:
    """The edge's half of an edge file, on the device.

    Attributes:
        file: where it comes from.
        masks: [A] views of each action.
        database: [modes] unit-norm descriptors [R, M r] of the references in the views of each mode, uncompressed.
        places_m: [R, 2] where they were taken.
    """

    def __init__(self, file: EdgeFile) -> None:
        self.file = file
        # Every array that a program is called with costs time: the encoder's and the localizer's stay behind.
        layers = file.params["params"].items()
        needed = {name: layer for name, layer in layers if name.startswith(_DECODER) or name in _DECLARED}
        self._params = {"params": jax.tree.map(jnp.asarray, needed)}
        actions, arch = file.actions, file.arch
        self._number = {(mode, k): actions.index(mode, k) for mode in actions.modes for k in actions.prefixes}
        self.masks = [mode_mask(mode, arch.n_views) for mode in actions.modes for _ in actions.prefixes]
        x = jnp.asarray(file.reference_x.reshape(len(file.reference_x), -1))
        shown = (jnp.repeat(mode_mask(mode, arch.n_views), arch.view_dim) for mode in actions.modes)
        self.database = [normalize(x * views[None]) for views in shown]
        self.places_m = jnp.asarray(file.reference_m[:, :2])

    def action_of(self, mode: str, k: int) -> int | None:
        """Number of the action with this mode and prefix length; None where the edge does not serve it."""
        return self._number.get((mode, k))

    def decoded(self, action: int, prefix: np.ndarray) -> jax.Array:
        """Descriptor [1, M r] of the code that a request carries."""
        code = np.zeros((1, self.file.arch.latent), np.float32)
        code[0, : len(prefix)] = prefix
        mask, k = self.masks[action], np.int32(len(prefix))
        return jax.block_until_ready(descriptors(self._params, code, k, mask, self.file.arch))

    def retrieved(self, action: int, descriptor: jax.Array) -> tuple[int, float]:
        """Most similar reference of a descriptor [1, M r], and how distinct it is, see `edge.retrieval.Match`."""
        database = self.database[action // len(self.file.actions.prefixes)]
        row, distinctness = np.asarray(nearest(descriptor, database, self.places_m)).tolist()
        return int(row), distinctness

    def position_m(self, row: int) -> tuple[float, float, float]:
        """Where a reference was taken."""
        x, y, z = self.file.origin_m + self.file.reference_m[row]
        return float(x), float(y), float(z)

    def residual_m(self, action: int, distinctness: float) -> float:
        """Calibrated residual of an answer as distinct as this one, see `control.calibration`; most for no number."""
        known = np.isfinite(distinctness)
        at = np.searchsorted(self.file.edges[action], np.float32(distinctness), side="right") if known else 0
        return float(self.file.risk_m[action, at])

    def warm_up(self) -> None:
        """Compile everything that a request needs."""
        for action, k in enumerate(self.file.actions.prefix):
            self.retrieved(action, self.decoded(action, np.zeros(k, np.float32)))


@partial(jax.jit, static_argnames="arch")
def descriptors(params: Params, codes: jax.Array, k: jax.Array, view_mask: jax.Array, arch: Architecture) -> jax.Array:
    """What codes stand for.

    Args:
        params: parameters of the network.
        codes: [B, K]; what is beyond the prefix does not matter.
        k: prefix length.
        view_mask: [M] views of the mode.
        arch: widths (static).

    Returns:
        [B, M r] reconstructed features, zero where a view is absent.
    """
    prefix = (jnp.arange(arch.latent) < k).astype(jnp.float32)
    return decode(params, codes, prefix, arch) * jnp.repeat(view_mask, arch.view_dim)[None]


@jax.jit
def nearest(descriptor: jax.Array, database: jax.Array, places_m: jax.Array) -> jax.Array:
    """Most similar row of a database of unit norm.

    Args:
        descriptor: [1, M r].
        database: [R, M r], R below 2^24.
        places_m: [R, 2] where its rows were taken.

    Returns:
        [2] float32 row, exact, and distinctness: one array, as fetching two takes twice as long. Equal similarities go
        to the lower row.
    """
    match = best_of(database @ normalize(descriptor)[0], places_m, ELSEWHERE_M)
    return jnp.stack([match.row.astype(jnp.float32), match.distinctness])
