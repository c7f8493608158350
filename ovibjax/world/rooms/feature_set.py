"""References and queries of the embedded rooms: driven, rendered and embedded once, then read from the cache."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.errors import InputError
from ovibjax.features.backbones.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed, embedded_backbone
from ovibjax.features.feature_files import load, save
from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.runtime.cache import cache_folder, made_folder, source_code
from ovibjax.runtime.threads import in_threads
from ovibjax.world.rooms.drive import Drive, query_drive, reference_drive
from ovibjax.world.rooms.interior import render_interior
from ovibjax.world.rooms.room import Room, RoomConfig, make_room

_CHUNK = 20  # views per call
_SOURCES = (
    *("world.rooms.room", "world.rooms.drive", "world.rooms.feature_set", "world.rooms.interior"),
    *("world.rooms.shading", "world.town.render", "world.town.shading", "features.backbones.pyramid"),
)

OnRooms = Callable[[int, int], None]


@cache
def _code() -> bytes:
    """The code that renders rooms, as it was when this process first asked."""
    return source_code(*_SOURCES)


def cache_key(config: RoomConfig) -> str:
    """Content hash of everything the features depend on: the description and the code that renders it."""
    return hashlib.sha256(repr(sorted(asdict(config).items())).encode() + _code()).hexdigest()[:20]


def rooms_features(
    configs: Sequence[RoomConfig], on_rooms: OnRooms | None = None
) -> list[tuple[FeatureSet, FeatureSet]]:
    """References and queries of several rooms, rendered side by side where the cache has none.

    Args:
        configs: the rooms.
        on_rooms: called with (done, total) as rooms are finished; not called when the cache has them all.

    Returns:
        Per room its references and its queries, d = 512, in the order given.

    Raises:
        InputError: the cache folder cannot be written.
    """
    missing = [config for config in configs if not all(path.exists() for path in _paths(config))]
    done = 0
    # The first room compiles; the rest run one per core.
    for part in (map(_make, missing[:1]), in_threads(_make, missing[1:])):
        for _ in part:
            done += 1
            if on_rooms is not None:
                on_rooms(done, len(missing))
    return [room_features(config) for config in configs]


def room_features(config: RoomConfig) -> tuple[FeatureSet, FeatureSet]:
    """References and queries of one room.

    Args:
        config: the room.

    Returns:
        References and queries; positions are the frames' poses, in metres from the middle of the floor.

    Raises:
        InputError: the cache folder cannot be written.
    """
    paths = _paths(config)
    if all(path.exists() for path in paths):
        try:
            return load(paths[0]), load(paths[1])
        except InputError:
            for path in paths:
                path.unlink(missing_ok=True)  # damaged by something else: make it again
    return _make(config)


def _paths(config: RoomConfig) -> tuple[Path, Path]:
    key = cache_key(config)
    return cache_folder() / f"room-{key}-references.npz", cache_folder() / f"room-{key}-queries.npz"


def _make(config: RoomConfig) -> tuple[FeatureSet, FeatureSet]:
    room = make_room(config)
    drives = (reference_drive(room, config), query_drive(room, config))
    features = _embed(room, drives)
    paths = _paths(config)
    made_folder(paths[0].parent)
    made = []
    for path, drive, part in zip(paths, drives, features, strict=True):
        feature_set = make_feature_set(part, drive.positions_m, yaw_rad=drive.yaw_rad, source="embedded room")
        save(path, feature_set)
        made.append(feature_set)
    return made[0], made[1]


def _embed(room: Room, drives: Sequence[Drive]) -> list[np.ndarray]:
    """[N, M, 512] unit-norm features of each drive, in chunks of one size."""
    origin, yaw, pitch = (
        np.concatenate([field.reshape(-1, *field.shape[2:]) for field in fields])
        for fields in zip(*((d.origin_m, d.view_yaw_rad, d.view_pitch_rad) for d in drives), strict=True)
    )
    arrays, backbone = jax.tree.map(jnp.asarray, (room, embedded_backbone()))
    out = []
    for start in range(0, len(yaw), _CHUNK):
        rows = np.minimum(np.arange(start, start + _CHUNK), len(yaw) - 1)
        place, heading, tilt = (jnp.asarray(field[rows]) for field in (origin, yaw, pitch))
        rgb, _ = render_interior(arrays, place, heading, tilt, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX)
        out.append(np.asarray(embed(backbone, rgb)))
    flat = np.concatenate(out)[: len(yaw)]
    counts = np.cumsum([drive.view_yaw_rad.size for drive in drives])[:-1]
    parts = np.split(flat, counts)
    return [part.reshape(*drive.view_yaw_rad.shape, -1) for part, drive in zip(parts, drives, strict=True)]
