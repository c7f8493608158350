"""References and queries of the embedded rooms: driven, rendered and embedded once, then read from the cache."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.features.backbones.pyramid import EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX, embed, embedded_backbone
from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.runtime.batches import first_then_threads, padded_batches
from ovibjax.runtime.cache import cache_folder, made_folder
from ovibjax.world.feature_cache import content_key, keep, kept
from ovibjax.world.rooms.drive import Drive, query_drive, reference_drive
from ovibjax.world.rooms.interior import render_interior
from ovibjax.world.rooms.room import Room, RoomConfig, make_room

_CHUNK = 20  # views per call
SOURCES = (
    *("world.rays", "world.patterns", "world.rooms.room", "world.rooms.furniture", "world.rooms.drive"),
    *("world.rooms.interior", "world.rooms.shading", "world.rooms.feature_set", "features.backbones.pyramid"),
)
"""Code that the features of a room depend on."""


def rooms_features(
    configs: Sequence[RoomConfig], on_rooms: Callable[[int, int], None] | None = None
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
    for config in missing:
        made_folder(_paths(config)[0].parent)  # refused before anything is rendered
    for done, _ in enumerate(first_then_threads(_make, missing), start=1):
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
    found = kept(*_paths(config))
    return (found[0], found[1]) if found else _make(config)


def _paths(config: RoomConfig) -> tuple[Path, Path]:
    key = content_key(sorted(asdict(config).items()), SOURCES)
    return cache_folder() / f"room-{key}-references.npz", cache_folder() / f"room-{key}-queries.npz"


def _make(config: RoomConfig) -> tuple[FeatureSet, FeatureSet]:
    room = make_room(config)
    drives = (reference_drive(room, config), query_drive(room, config))
    references, queries = (
        make_feature_set(part, drive.positions_m, yaw_rad=drive.yaw_rad, source="embedded room")
        for part, drive in zip(_embed(room, drives), drives, strict=True)
    )
    keep(dict(zip(_paths(config), (references, queries), strict=True)))
    return references, queries


def _embed(room: Room, drives: Sequence[Drive]) -> list[np.ndarray]:
    """[N, M, 512] unit-norm features of each drive, in chunks of one size."""
    origin, yaw, pitch = (
        np.concatenate([field.reshape(-1, *field.shape[2:]) for field in fields])
        for fields in zip(*((d.origin_m, d.view_yaw_rad, d.view_pitch_rad) for d in drives), strict=True)
    )
    arrays, backbone = jax.tree.map(jnp.asarray, (room, embedded_backbone()))
    out = []
    for _, rows in padded_batches(np.arange(len(yaw)), _CHUNK):
        place, heading, tilt = (jnp.asarray(field[rows]) for field in (origin, yaw, pitch))
        rgb, _ = render_interior(arrays, place, heading, tilt, EMBEDDED_HEIGHT_PX, EMBEDDED_WIDTH_PX)
        out.append(np.asarray(embed(backbone, rgb)))
    flat = np.concatenate(out)[: len(yaw)]
    counts = np.cumsum([drive.view_yaw_rad.size for drive in drives])[:-1]
    parts = np.split(flat, counts)
    return [part.reshape(*drive.view_yaw_rad.shape, -1) for part, drive in zip(parts, drives, strict=True)]
