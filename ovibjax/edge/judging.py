"""How good a compressed frame is: the position error when one fixed edge localizer works on what was decoded.

This is the paper's frozen-localizer protocol (Section "Experimental Setup"). The localizer (regression head and
database of uncompressed reference descriptors) is fixed after training; a codec only changes the descriptor that
reaches it. The mixing weight is chosen on validation frames per prefix.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ovibjax.edge.localize import errors, mix, select_eta
from ovibjax.edge.retrieval import brute_force
from ovibjax.encoder.bits import code_of
from ovibjax.encoder.model import Architecture, Params, decode, locate
from ovibjax.encoder.pca import PCA, pca_coordinates, pca_decode
from ovibjax.encoder.training_data import MemberData
from ovibjax.link.codes.rounding import Grid, snapped


class Trained(NamedTuple):
    """A trained network with the data of its seed: the frozen localizer that codes are judged by.

    Attributes:
        data: data of the split; its training features are the database.
        params: parameters of the network: encoder, decoder and localizer. One trained for bits rounds its codes.
        grid: what the coordinates of `judge_prefixes` are rounded to besides, the network's or those of PCA.
    """

    data: MemberData
    params: Params
    grid: Grid | None = None


class Judged(NamedTuple):
    """Outcome of one code, with leading axes of whatever was mapped.

    Attributes:
        eta: mixing weight chosen on validation.
        val_error_m: [V] validation errors.
        test_error_m: [T] test errors.
        reg_mean_m: mean test error of regression alone.
        ret_mean_m: mean test error of retrieval alone.
    """

    eta: jax.Array
    val_error_m: jax.Array
    test_error_m: jax.Array
    reg_mean_m: jax.Array
    ret_mean_m: jax.Array


Codec = Callable[[jax.Array], jax.Array]
"""From masked features [B, M r] to the descriptors [B, M r] that reach the localizer."""


def judge(trained: Trained, arch: Architecture, view_mask: jax.Array, codec: Codec, recode: bool = False) -> Judged:
    """Localize validation and test frames whose descriptors have passed through a codec.

    Args:
        trained: the frozen localizer and the data of its seed.
        arch: widths of the network.
        view_mask: [M] mask of the view mode.
        codec: maps masked features [B, M r] to descriptors [B, M r].
        recode: also pass the database through the codec, so that both sides of the comparison are coded.

    Returns:
        Errors in metres and the chosen mixing weight.
    """
    mask = jnp.repeat(view_mask, arch.view_dim)[None]
    asked, database = _frames(trained, arch, view_mask)
    database = codec(database) * mask if recode else database
    return _localized(trained, arch, codec(asked) * mask, database)


def _frames(trained: Trained, arch: Architecture, view_mask: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Masked features of the frames that are localized, validation before test, and of the database: [B, M r] each."""
    data, mask = trained.data, jnp.repeat(view_mask, arch.view_dim)[None]
    asked = jnp.concatenate([data.val_x, data.test_x])
    return asked.reshape(asked.shape[0], -1) * mask, data.train.x.reshape(data.train.x.shape[0], -1) * mask


def _localized(trained: Trained, arch: Architecture, descriptor: jax.Array, database: jax.Array) -> Judged:
    """Localize the frames of `_frames` from the descriptors [B, M r] that reached the edge."""
    data, params = trained.data, trained.params
    n_val = data.val_x.shape[0]
    truth = jnp.concatenate([data.val_m, data.test_m])
    standardized = locate(params, descriptor, arch)
    reg = data.standardizer.mean_m[None] + data.standardizer.scale_m * standardized
    ret = data.train_m[brute_force(descriptor, database)]
    eta = select_eta(reg[:n_val], ret[:n_val], truth[:n_val])
    error = errors(mix(reg, ret, eta), truth)
    return Judged(
        eta=eta,
        val_error_m=error[:n_val],
        test_error_m=error[n_val:],
        reg_mean_m=jnp.mean(errors(reg, truth)[n_val:]),
        ret_mean_m=jnp.mean(errors(ret, truth)[n_val:]),
    )


def judge_prefixes(
    trained: Trained,
    arch: Architecture,
    view_mask: jax.Array,
    prefixes: jax.Array,
    pca: PCA | None = None,
    recode: bool = False,
    order: jax.Array | None = None,
) -> Judged:
    """Judge every prefix length of one nested code; jitted once, all prefixes are one call.

    Args:
        trained: network with frozen localizer, and the data of its seed.
        arch: widths of the network (static).
        view_mask: [M] mask of the view mode.
        prefixes: [P] int32 prefix lengths.
        pca: use this linear code instead of the network's; the localizer stays the same.
        recode: also pass the database through the codec.
        order: [K] coordinates in the order in which they are kept; the learned order by default.

    Returns:
        `Judged` with leading axis P.
    """
    position = jnp.arange(arch.latent) if order is None else jnp.argsort(order)
    mask = jnp.repeat(view_mask, arch.view_dim)[None]
    asked, database = _frames(trained, arch, view_mask)

    # Encoding does not depend on the prefix, and is done once.
    def code(x: jax.Array) -> jax.Array:
        coordinates = pca_coordinates(pca, x) if pca is not None else code_of(trained.params, x, arch)
        return snapped(trained.grid, coordinates)

    def received(coded: jax.Array, prefix: jax.Array) -> jax.Array:
        if pca is not None:
            return pca_decode(pca, coded, prefix) * mask
        return decode(trained.params, coded, prefix, arch) * mask

    of_asked, of_database = code(asked), code(database) if recode else None

    def one(k: jax.Array) -> Judged:
        prefix = (position < k).astype(jnp.float32)
        references = database if of_database is None else received(of_database, prefix)
        return _localized(trained, arch, received(of_asked, prefix), references)

    return jax.lax.map(one, prefixes)


def judge_raw(trained: Trained, arch: Architecture, view_mask: jax.Array) -> Judged:
    """Judge uncompressed features of a view mode; arguments as in `judge`."""
    return _localized(trained, arch, *_frames(trained, arch, view_mask))


def one_standard_error_choice(val_error_m: jax.Array, prefixes: jax.Array) -> jax.Array:
    """Shortest prefix whose validation error is within one standard error of the best one's.

    On a flat curve the plain minimum is a coin toss among long prefixes; this rule takes the cheapest of them.

    Args:
        val_error_m: [P, V] validation errors per prefix.
        prefixes: [P] ascending prefix lengths.

    Returns:
        The chosen prefix length, int32 scalar.
    """
    mean = jnp.mean(val_error_m, axis=1)
    best = jnp.argmin(mean)
    allowance = jnp.std(val_error_m[best], ddof=1) / jnp.sqrt(jnp.float32(val_error_m.shape[1]))
    return prefixes[jnp.argmax(mean <= mean[best] + allowance)]
