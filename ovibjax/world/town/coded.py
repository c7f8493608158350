"""Features of the embedded town's frames after an image codec: render at 400 x 300, encode, decode, Φ.

Each frame is kept on its own in the cache folder: an interrupted run goes on, and seeds share frames.
"""

from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError
from ovibjax.features.backbones.by_name import Backbone, open_backbone
from ovibjax.features.frames import OnFrames
from ovibjax.features.images.codecs import CLIPS, decode, encode, video_missing
from ovibjax.features.npz import read_npz, write_npz
from ovibjax.runtime.batches import first_then_threads
from ovibjax.runtime.cache import cache_folder, made_folder
from ovibjax.world.feature_cache import content_key
from ovibjax.world.town.feature_set import SOURCES
from ovibjax.world.town.layout import Town, TownConfig, make_town
from ovibjax.world.town.render import FRAME_CAMERA, Camera, render_frames
from ovibjax.world.town.route import Route, make_route

Rung = tuple[str, int]
"""A codec and a quality."""

_CHUNK = 2  # frames rendered together
# The size of the released images, with the buildings and trees that the database's small pictures show: against the
# limits for pictures to look at, bytes differ by 0.02 %, and compiling and rendering take two thirds.
_CAMERA = Camera(FRAME_CAMERA.height_px, FRAME_CAMERA.width_px)
_SOURCES = (
    *SOURCES,
    *("world.town.coded", "features.images.codecs", "features.backbones.image_encoder", "features.backbones.embedded"),
)


class CodedViews(NamedTuple):
    """Frames as they reach the edge, for R rungs.

    Attributes:
        plain: [n, 5, d] float32 features of the images before coding.
        coded: [n, R, 5, d] float32 features of the decoded images.
        payload_bytes: [n, R] int64.
    """

    plain: NDArray[np.float32]
    coded: NDArray[np.float32]
    payload_bytes: NDArray[np.int64]


def coded_town(
    config: TownConfig,
    n_frames: int,
    frames: NDArray[np.int64],
    rungs: Sequence[Rung],
    route_seed: int = 0,
    on_frames: OnFrames | None = None,
) -> CodedViews:
    """Code frames of a drive and embed what a receiver decodes.

    Args:
        config: the town.
        n_frames: length of the drive.
        frames: [n] frames wanted.
        rungs: codecs and qualities.
        route_seed: the drive.
        on_frames: called with (done, total) over the frames that the cache lacks.

    Returns:
        Features and payloads of the wanted frames, in their order.

    Raises:
        InputError: a codec is missing, or the cache folder cannot be written.
    """
    town = make_town(config)
    route = make_route(town, config, n_frames, route_seed)
    backbone = open_backbone("embedded")
    folder = made_folder(cache_folder() / f"codecs-{_key(config, n_frames, rungs, route_seed, backbone)}")

    def work(chunk: NDArray[np.int64]) -> int:
        return _code_chunk(town, route, chunk, rungs, backbone, folder)

    missing = np.array([f for f in np.unique(frames).tolist() if _read(folder, f) is None], np.int64)
    done, chunks = 0, [missing[i : i + _CHUNK] for i in range(0, len(missing), _CHUNK)]
    for count in first_then_threads(work, chunks):
        done += count
        if on_frames is not None:
            on_frames(done, len(missing))
    found = [_read(folder, frame) for frame in frames.tolist()]
    kept = [views for views in found if views is not None]
    if len(kept) < len(found):
        raise InputError(f"{folder}: frames vanished while they were being read; repeat the command")
    return CodedViews(*(np.stack(field) for field in zip(*kept, strict=True)))


def usable(rungs: Sequence[Rung]) -> tuple[tuple[Rung, ...], str]:
    """Rungs whose codec is installed, and why the others are left out (empty if none is)."""
    reason = video_missing() if any(codec in CLIPS for codec, _ in rungs) else ""
    return tuple(rung for rung in rungs if not reason or rung[0] not in CLIPS), reason


def _key(config: TownConfig, n_frames: int, rungs: Sequence[Rung], route_seed: int, backbone: Backbone) -> str:
    """Content hash of what the features depend on: description, code, backbone and codec libraries."""
    facts = (sorted(asdict(config).items()), n_frames, route_seed, tuple(rungs), backbone.fingerprint)
    libraries = [("pillow", metadata.version("pillow"))]
    if any(codec in CLIPS for codec, _ in rungs):
        libraries.append(("av", metadata.version("av")))
    return content_key((facts, libraries), _SOURCES)


def _read(folder: Path, frame: int) -> CodedViews | None:
    path = folder / f"{frame:06d}.npz"
    if not path.exists():
        return None
    try:
        return CodedViews(**read_npz(path, CodedViews._fields))
    except InputError:
        return None  # damaged by something else: make it again


def _code_chunk(
    town: Town, route: Route, chunk: NDArray[np.int64], rungs: Sequence[Rung], backbone: Backbone, folder: Path
) -> int:
    for frame, views in render_frames(town, route, chunk, _CAMERA):
        rgb = np.round(np.asarray(views.rgb) * 255).astype(np.uint8)
        payloads = [encode(codec, quality, rgb) for codec, quality in rungs]
        images = np.concatenate([rgb, *(decode(payload) for payload in payloads)])
        features = backbone.embed(np.stack([backbone.preprocess(image) for image in images]))
        features = features.reshape(1 + len(rungs), len(rgb), -1)
        sizes = np.array([len(payload) for payload in payloads], np.int64)
        write_npz(folder / f"{frame:06d}.npz", CodedViews(features[0], features[1:], sizes)._asdict())
    return len(chunk)
