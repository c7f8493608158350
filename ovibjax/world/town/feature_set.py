"""The default data: a drive through the embedded town, rendered and embedded once, then read from the cache."""

from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.features.backbones.pyramid import (
    EMBEDDED_DIM,
    EMBEDDED_HEIGHT_PX,
    EMBEDDED_WIDTH_PX,
    embed,
    embedded_backbone,
)
from ovibjax.features.frames import FeatureSet, OnFrames, make_feature_set
from ovibjax.runtime.batches import first_then_threads, padded_batches
from ovibjax.runtime.cache import cache_folder
from ovibjax.world.feature_cache import content_key, keep, kept
from ovibjax.world.town.layout import Town, TownConfig, make_town
from ovibjax.world.town.render import Camera, render
from ovibjax.world.town.route import context_labels, make_route

PAPER_FRAMES = 4994
"""Frames of the paper's single-scene split."""

_CHUNK = 8  # frames per call: what a stage hands to the next stays in the cache of the processor
SOURCES = (
    *("world.rays", "world.patterns", "world.town.layout", "world.town.route", "world.town.render", "world.town.hits"),
    *("world.town.pieces", "world.town.shading", "world.town.style", "world.town.feature_set"),
    "features.backbones.pyramid",
)
"""Code that the features of the town depend on."""


def town_features(
    config: TownConfig | None = None,
    n_frames: int = PAPER_FRAMES,
    route_seed: int = 0,
    on_frames: OnFrames | None = None,
) -> FeatureSet:
    """Features of a drive through the embedded town.

    Args:
        config: the town; the default town if None.
        n_frames: frames along the drive.
        route_seed: the drive.
        on_frames: called with (done, total) as frames are finished; not called when the cache has them.

    Returns:
        The feature set, d = 512, with contexts from the town's geometry.

    Raises:
        InputError: the cache folder cannot be written.
    """
    config = config or TownConfig()
    facts = (sorted(asdict(config).items()), n_frames, route_seed)
    path = cache_folder() / f"town-{content_key(facts, SOURCES)}.npz"
    if found := kept(path):
        return found[0]
    town = make_town(config)
    route = make_route(town, config, n_frames, route_seed)
    features = render_features(town, route.positions_m, route.yaw_rad, on_frames)
    made = make_feature_set(
        features,
        route.positions_m,
        yaw_rad=route.yaw_rad,
        context=context_labels(town, route.positions_m),
        source="embedded town",
    )
    keep({path: made})
    return made


def render_features(
    town: Town, positions_m: np.ndarray, yaw_rad: np.ndarray, on_frames: OnFrames | None = None
) -> np.ndarray:
    """Render and embed poses in equal chunks, so that one size is compiled.

    Args:
        town: a `Town`.
        positions_m: [N, 3] camera positions.
        yaw_rad: [N] headings.
        on_frames: called with (done, total).

    Returns:
        [N, 5, 512] float32 unit-norm features.
    """
    camera = Camera(EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX)
    arrays = jax.tree.map(jnp.asarray, town)
    backbone = jax.tree.map(jnp.asarray, embedded_backbone())
    n, done = len(positions_m), 0
    out = np.empty((n, 5, EMBEDDED_DIM), np.float32)

    def fill(batch: tuple[int, np.ndarray]) -> int:
        count, rows = batch
        views = render(arrays, jnp.asarray(positions_m[rows]), jnp.asarray(yaw_rad[rows]), camera)
        flat = views.rgb.reshape(-1, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, 3)
        out[rows[:count]] = np.asarray(embed(backbone, flat)).reshape(_CHUNK, 5, -1)[:count]
        return count

    for count in first_then_threads(fill, list(padded_batches(np.arange(n), _CHUNK))):
        done += count
        if on_frames is not None:
            on_frames(done, n)
    return out
