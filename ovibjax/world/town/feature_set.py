"""The default data: a drive through the embedded town, rendered and embedded once, then read from the cache."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.errors import InputError
from ovibjax.features.backbones.pyramid import (
    EMBEDDED_DIM,
    EMBEDDED_HEIGHT_PX,
    EMBEDDED_WIDTH_PX,
    embed,
    embedded_backbone,
)
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.runtime.cache import cache_folder, made_folder, source_code
from ovibjax.runtime.threads import in_threads
from ovibjax.world.town.layout import Town, TownConfig, make_town
from ovibjax.world.town.render import Camera, render
from ovibjax.world.town.route import context_labels, make_route

PAPER_FRAMES = 4994
"""Frames of the paper's single-scene split."""

_CHUNK = 32  # frames per call: large enough to fill the vector units, small enough for the second-level cache
SOURCES = (
    *("world.town.layout", "world.town.route", "world.town.render", "world.town.shading", "world.town.feature_set"),
    "features.backbones.pyramid",
)
"""Code that the features of the town depend on."""

OnFrames = Callable[[int, int], None]


def cache_key(config: TownConfig, n_frames: int, route_seed: int) -> str:
    """Content hash of everything the features depend on: the description and the code that renders it."""
    facts = repr((sorted(asdict(config).items()), n_frames, route_seed)).encode()
    return hashlib.sha256(facts + source_code(*SOURCES)).hexdigest()[:20]


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
    path = cache_folder() / f"town-{cache_key(config, n_frames, route_seed)}.npz"
    if path.exists():
        try:
            return load(path)
        except InputError:
            path.unlink(missing_ok=True)  # damaged by something else: make it again
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
    made_folder(path.parent)
    save(path, made)
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
    n = len(positions_m)
    out = np.empty((n, 5, EMBEDDED_DIM), np.float32)

    def chunk(start: int) -> int:
        rows = np.minimum(np.arange(start, start + _CHUNK), n - 1)
        views = render(arrays, jnp.asarray(positions_m[rows]), jnp.asarray(yaw_rad[rows]), camera)
        flat = views.rgb.reshape(-1, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, 3)
        count = min(_CHUNK, n - start)
        out[start : start + count] = np.asarray(embed(backbone, flat)).reshape(_CHUNK, 5, -1)[:count]
        return count

    done = 0
    # The first chunk compiles; the rest run one per core, which fills the gaps between XLA's own parallel parts.
    for counts in (map(chunk, [0]), in_threads(chunk, range(_CHUNK, n, _CHUNK))):
        for count in counts:
            done += count
            if on_frames is not None:
                on_frames(done, n)
    return out
