"""What coding prefixes does to the whole system, inside its one program: what the edge receives, and what it costs.

Grids and shares are fitted on the frames of training routes, as `link.codes.tables` fits them, of all modes together.
A request's size is the mean over those frames of its mode, in whole bytes a frame: what a client can reckon with before
it has encoded.
"""

import jax
import jax.numpy as jnp

from ovibjax.link.coded_packets import CodedRequest, pack_compact
from ovibjax.link.codes.rounding import Grid, snapped
from ovibjax.link.codes.tables import CODES, LEVELS, PSEUDO_COUNT, RANGE_SHARES, fitted_step
from ovibjax.link.payload import FLOAT_BYTES, HEADER_BYTES, VIEW_ID_BYTES
from ovibjax.views import MODES

_FURTHEST = 127  # places of `entropy` to either side of zero; codes beyond saturate


def received(codes: jax.Array, known: jax.Array, code: str) -> tuple[jax.Array, jax.Array]:
    """What reaches the edge of every frame's code, and how many bytes its prefixes take.

    Args:
        codes: [A, F, K] latent means by mode.
        known: [F] bool, frames that grids and shares are fitted on.
        code: one of `link.codes.CODES` (static).

    Returns:
        [A, F, K] rounded codes, and [A, K] mean bytes of the first 1 to K coordinates.

    Raises:
        ValueError: an unknown code.
    """
    if code not in CODES:
        raise ValueError(f"code is one of {', '.join(CODES)}, not {code!r}")
    k = jnp.arange(1, codes.shape[-1] + 1)
    if code == "entropy":
        return _entropy(codes, known)
    widths = {"float32": FLOAT_BYTES * k, "int8": k, "int4": (k + 1) // 2}
    sizes_bytes = jnp.broadcast_to(widths[code].astype(jnp.float32)[None], (codes.shape[0], codes.shape[-1]))
    return (codes if code == "float32" else snapped(even_grid(codes, known, LEVELS[code]), codes)), sizes_bytes


def overhead_bytes(modes: tuple[str, ...], code: str, compact: bool) -> list[int]:
    """[A] bytes of a request of each mode beside its code: the paper's header and view indices, or a compact header.

    Args:
        modes: view modes.
        code: one of `link.codes.CODES`; `float32` always travels in the paper's packets.
        compact: whether others have a compact header.

    Returns:
        Bytes of version 1 or 2 of a packet (a code below 128 bytes), or of the compact form of a usual request.
    """
    if compact and code != "float32":
        request = CodedRequest(modes[0], code, 256, bytes(128 if code == "int4" else 256), 10.0, 500, 64, 4096)
        return [len(pack_compact(request)) - len(request.data)] * len(modes)
    return [HEADER_BYTES + VIEW_ID_BYTES * len(MODES[mode]) for mode in modes]


def even_grid(codes: jax.Array, known: jax.Array, levels: int) -> Grid:
    """The grid that `fit_table` fits to the codes [A, F, K] of known frames, with so many levels."""
    counted = known[None, :, None]
    low = jnp.min(jnp.where(counted, codes, jnp.inf), axis=(0, 1))
    high = jnp.max(jnp.where(counted, codes, -jnp.inf), axis=(0, 1))
    middle, half = (high + low) / 2, (high - low) / 2
    least = jnp.maximum(jnp.abs(middle) * 2.0**-19, 1e-20)

    def grid_of(share: jax.Array) -> Grid:
        step = jnp.maximum(2 * share * half / (levels - 2), least)
        first = jnp.floor((middle - share * half) / step).astype(jnp.int32)
        return Grid(step, first, first + jnp.int32(levels - 1))

    def lost(share: jax.Array) -> jax.Array:
        error = jnp.where(counted, snapped(grid_of(share), codes) - codes, 0.0)
        return jnp.sum(error**2, axis=(0, 1))

    shares = jnp.asarray(RANGE_SHARES, jnp.float32)
    return grid_of(shares[jnp.argmin(jax.lax.map(lost, shares), axis=0)])


def _entropy(codes: jax.Array, known: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Codes on a grid of the fitted step, and the ideal length of their prefixes in whole bytes, by smoothed shares."""
    latent, places = codes.shape[-1], 2 * _FURTHEST + 1
    weight = known.astype(jnp.float32)
    total = jnp.sum(weight) * codes.shape[0]
    counted = weight[None, :, None]
    mean = jnp.sum(codes * counted, axis=(0, 1)) / total
    variance = jnp.sum((codes - mean[None, None]) ** 2 * counted, axis=(0, 1)) / total
    step = jnp.full(latent, 1.0, jnp.float32) * fitted_step(variance, jnp)
    bound = jnp.full(latent, _FURTHEST, jnp.int32)
    coded = snapped(Grid(step, -bound, bound), codes)
    number = jnp.rint(coded / step[None, None]).astype(jnp.int32)
    of_all = jnp.tile(weight, codes.shape[0])

    def lengths(of_coordinate: jax.Array) -> jax.Array:
        """[A F] bits of one coordinate in every frame."""
        seen = jnp.zeros(places, jnp.float32).at[of_coordinate + _FURTHEST].add(of_all)
        place = jnp.arange(places, dtype=jnp.float32) - _FURTHEST
        mean = jnp.sum(seen * place) / total
        width = jnp.sqrt(jnp.sum(seen * (place - mean) ** 2) / total + 1 / 12)
        bell = jnp.exp(-0.5 * ((place - mean) / width) ** 2) + 1e-6
        share = (seen + PSEUDO_COUNT * bell / jnp.sum(bell)) / (total + PSEUDO_COUNT)
        return -jnp.log2(share)[of_coordinate + _FURTHEST]

    bits = jax.lax.map(lengths, number.reshape(-1, latent).T)  # [K, A F]
    sizes_bytes = jnp.ceil(jnp.cumsum(bits, axis=0) / 8).reshape(latent, codes.shape[0], -1)
    return coded, (jnp.sum(sizes_bytes * weight[None, None], axis=-1) / jnp.sum(weight)).T
