"""The embedded town on disk: frames in the folder layout of the released data set."""

import io
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ovibjax.errors import StrPath, refusal
from ovibjax.features.frames import CONTEXTS, OnFrames
from ovibjax.views import VIEWS
from ovibjax.world.rays import VIEW_YAW_DEG
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import FRAME_CAMERA, VIEW_PITCH_DEG, Views, render_frames
from ovibjax.world.town.route import Route, context_labels, make_route
from ovibjax.world.town.shading import SEMANTIC_CLASSES

FRAME_PERIOD_S = 0.5
DEPTH_FAR_CM = 65535
"""Depth of the sky and of all that is too far for 16 bits of centimetres."""

_KINDS = ("rgb", "depth", "semantic")
_CALIBRATION = Path("calibration", "camera_calibration.json")


def check_seeds(path: StrPath, config: TownConfig, seed: int) -> None:
    """Refuse numbers below zero before any work.

    Raises:
        InputError: the town's seed, its style or the drive's seed is negative.
    """
    if min(config.seed, config.style, seed) < 0:
        given = f"seeds {config.seed} and {seed}, style {config.style}"
        raise refusal(path, f"not written: {given}; use 0 or more")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; a killed run leaves one hidden file, which the next run reuses."""
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(content)
    part.replace(path)


def write_frames(
    town_config: TownConfig, out: StrPath, n_frames: int, seed: int, on_frame: OnFrames | None = None
) -> int:
    """Write a drive through the town in the folder layout of the released data set.

    Under `out` appear `rgb/`, `depth/` and `semantic/<Camera>/<frame>.png`, `metadata/<frame>.json` and
    `calibration/camera_calibration.json`, which states units, axes and classes. The metadata are
    written last; a frame that has all its files is left alone, so that an interrupted run goes on where it stopped.

    Args:
        town_config: the town.
        out: the folder, made if need be.
        n_frames: length of the drive, at least 1.
        seed: the drive, not negative; equal arguments give equal files.
        on_frame: called with (frames done, frames in all).

    Returns:
        How many frames had to be written.

    Raises:
        InputError: `out` cannot be written or holds frames of another drive, or a number is out of range.
    """
    out = Path(out)
    if n_frames < 1:
        raise refusal(out, f"not written: {n_frames} frames; use at least 1")
    check_seeds(out, town_config, seed)
    town = make_town(town_config)
    route = make_route(town, town_config, n_frames, seed)
    context = context_labels(town, route.positions_m)
    map_name = f"ovibjax-town-{town_config.seed}" + (f"-style-{town_config.style}" if town_config.style else "")
    try:
        for folder in ("calibration", "metadata", *(f"{kind}/{view}" for kind in _KINDS for view in VIEWS)):
            (out / folder).mkdir(parents=True, exist_ok=True)
        check_drive(out, town_config, n_frames, seed)
        if not (out / _CALIBRATION).exists():
            write_whole(out / _CALIBRATION, _json(_calibration(town_config, n_frames, seed)))
        todo = np.array([frame for frame in range(n_frames) if not _is_finished(out, frame)], np.int64)
        for done, (frame, views) in enumerate(render_frames(town, route, todo), n_frames - len(todo) + 1):
            for (kind, view), pixels in _images(views).items():
                write_whole(_image_file(out, kind, view, frame), png(pixels))
            about = _metadata(route, frame, CONTEXTS[context[frame]], map_name)
            write_whole(_metadata_file(out, frame), _json(about))
            if on_frame is not None:
                on_frame(done, n_frames)
    except OSError as error:
        raise refusal(out, f"cannot be written ({error.strerror or error})") from error
    return len(todo)


def _image_file(out: Path, kind: str, view: str, frame: int) -> Path:
    return out / kind / view / f"{frame:06d}.png"


def _metadata_file(out: Path, frame: int) -> Path:
    return out / "metadata" / f"{frame:06d}.json"


def _is_finished(out: Path, frame: int) -> bool:
    """Whether a frame has all its files."""
    images = (_image_file(out, kind, view, frame) for kind in _KINDS for view in VIEWS)
    return _metadata_file(out, frame).exists() and all(image.exists() for image in images)


def _images(views: Views) -> dict[tuple[str, str], NDArray[Any]]:
    """Pixels of the images of one frame, by kind and view."""
    depth_cm = np.round(np.asarray(views.depth_m, np.float64) * 100)
    pixels: dict[str, NDArray[Any]] = {
        "rgb": np.round(np.asarray(views.rgb) * 255).astype(np.uint8),
        "depth": np.minimum(depth_cm, DEPTH_FAR_CM).astype(np.uint16),
        "semantic": np.asarray(views.semantic).astype(np.uint8),
    }
    return {(kind, view): pixels[kind][m] for kind in _KINDS for m, view in enumerate(VIEWS)}


def _metadata(route: Route, frame: int, context: str, map_name: str) -> dict[str, Any]:
    """Time, place and context of one frame, in the words of the released metadata."""
    x, y, z = route.positions_m[frame].tolist()
    yaw_deg = float(np.rad2deg(route.yaw_rad[frame]))
    return {
        "frame": f"{frame:06d}",
        "timestamp": frame * FRAME_PERIOD_S,
        "map_name": map_name,
        "context": context,
        "uav_state": {
            "position": {"x": x, "y": y, "z": z},
            "rotation": {"pitch": 0.0, "yaw": yaw_deg, "roll": 0.0},
        },
    }


def png(pixels: NDArray[Any]) -> bytes:
    """Pixels as a PNG file, as the released images are stored.

    Args:
        pixels: [H, W] or [H, W, 3] of an integer type that PNG knows.

    Returns:
        The file.
    """
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "png")
    return stream.getvalue()


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=2) + "\n").encode()


def _calibration(config: TownConfig, n_frames: int, seed: int) -> dict[str, Any]:
    """What the images mean, and which drive they show."""
    width, height = FRAME_CAMERA.width_px, FRAME_CAMERA.height_px
    cameras = {
        view: {
            "width": width,
            "height": height,
            "fov_deg": 90.0,
            "intrinsic": [[width / 2, 0.0, width / 2], [0.0, width / 2, height / 2], [0.0, 0.0, 1.0]],
            "extrinsic": {"yaw_deg": yaw, "pitch_deg": pitch},
        }
        for view, yaw, pitch in zip(VIEWS, VIEW_YAW_DEG, VIEW_PITCH_DEG, strict=True)
    }
    return {
        "cameras": cameras,
        "coordinates": "right-handed, metres: x east, y north, z up; yaw counter-clockwise from x, pitch up",
        "pixels": "origin at the top left corner of the image, pixel centres at half-integers",
        "depth": f"centimetres along the optical axis; {DEPTH_FAR_CM}: sky, or too far for 16 bits",
        "semantic_classes": list(SEMANTIC_CLASSES),
        "drive": {"town": asdict(config), "seed": seed, "n_frames": n_frames, "period_s": FRAME_PERIOD_S},
    }


def check_drive(out: StrPath, town_config: TownConfig, n_frames: int, seed: int = 0) -> None:
    """Refuse a folder that holds frames of another drive, before anything is drawn into it.

    Args:
        out: folder.
        town_config: the town.
        n_frames: length of the drive.
        seed: the drive.

    Raises:
        InputError: the folder's frames are of another drive and would mix with these.
    """
    path = Path(out) / _CALIBRATION
    if path.exists() and path.read_bytes() != _json(_calibration(town_config, n_frames, seed)):
        raise refusal(path, "describes frames of another drive; name an empty folder")
