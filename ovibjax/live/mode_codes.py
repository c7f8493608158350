"""Codes of frames as robots would send them, in the views of every mode."""

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.residuals import encode_views
from ovibjax.encoder.model import Architecture, Params
from ovibjax.views import mode_mask


def mode_codes(params: Params, arch: Architecture, x: np.ndarray, actions: ActionSet) -> np.ndarray:
    """Encode frames once per mode.

    Args:
        params: parameters of the network.
        arch: its widths.
        x: [N, M, r] frames in the network's basis.
        actions: the modes.

    Returns:
        [modes, N, K] codes.
    """
    flat = jnp.asarray(x.reshape(len(x), -1))
    encode = jax.jit(encode_views, static_argnames="arch")
    masks = [mode_mask(mode, arch.n_views) for mode in actions.modes]
    return np.stack([np.asarray(encode(params, flat, mask, arch)) for mask in masks])
