"""How long image codecs take to encode the five views of a frame on this machine."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ovibjax.features.images.codecs import Images, encode
from ovibjax.world.town.coded import Rung
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import FRAME_CAMERA, Camera, render_frames
from ovibjax.world.town.route import make_route

_REPEATS = 2


def town_pictures(n_frames: int, frames: Sequence[int]) -> list[Images]:
    """Frames of the default drive as codecs get them, 400 x 300 px.

    Args:
        n_frames: length of the drive.
        frames: which of its frames.

    Returns:
        Per frame, [5, 300, 400, 3] RGB.
    """
    config = TownConfig()
    town = make_town(config)
    route = make_route(town, config, n_frames, 0)
    camera = Camera(FRAME_CAMERA.height_px, FRAME_CAMERA.width_px)
    rendered = render_frames(town, route, np.array(frames), camera)
    return [np.round(np.asarray(views.rgb) * 255).astype(np.uint8) for _, views in rendered]


def encode_times_ms(pictures: Sequence[Images], rungs: Sequence[Rung]) -> NDArray[np.float64]:
    """Time to encode a frame, one at a time and on one core as a client would.

    Args:
        pictures: frames, [M, H, W, 3] each.
        rungs: codecs and qualities.

    Returns:
        [R] milliseconds, median over frames and repetitions.
    """
    return np.array([np.median([_encode_ms(rung, p) for p in pictures for _ in range(_REPEATS)]) for rung in rungs])


def _encode_ms(rung: Rung, picture: Images) -> float:
    started_ns = time.perf_counter_ns()
    encode(*rung, picture)
    return (time.perf_counter_ns() - started_ns) * 1e-6
