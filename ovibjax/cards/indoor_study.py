"""The indoor study as data: platforms in rooms, few references and separate queries, and the errors of both methods."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from ovibjax.cards.indoor_paper import PAPER
from ovibjax.cards.job import Sweep
from ovibjax.edge.indoor import DIMS, Protocol
from ovibjax.edge.indoor_data import scene_data
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.recipe import PAPER_PREFIXES
from ovibjax.encoder.train import TrainConfig
from ovibjax.features.frames import FeatureSet
from ovibjax.link.payload import representation_bytes
from ovibjax.report.claims import Interval, interval
from ovibjax.runtime.progress import progress_bar
from ovibjax.sweep.work import Along
from ovibjax.views import MODES, full_mode, modes_for
from ovibjax.world.rooms.feature_set import rooms_features
from ovibjax.world.rooms.room import RoomConfig, platform_room

PLATFORMS = ("UAV", "UGV")
RECALL_M = 0.5
"""Errors up to this count as recalled, R@0.5."""

Scene = tuple[FeatureSet, FeatureSet]
"""References and queries of one room."""


@dataclass(frozen=True)
class PlatformResults:
    """What one platform gave.

    Attributes:
        name: one of `PLATFORMS`.
        data: outputs of the protocol over room and seed.
        scenes: references and queries per room.
        rooms: names of the rooms.
    """

    name: str
    data: xarray.Dataset
    scenes: list[Scene]
    rooms: list[int]

    @property
    def whole(self) -> str:
        """The mode with every view."""
        return full_mode(self.scenes[0][0].features.shape[1])

    @property
    def counts(self) -> str:
        """How many references and queries a room has."""
        references, queries = self.scenes[0]
        return f"{len(references.features)} references / {len(queries.features)} queries"

    def errors_m(self, method: str, k: int = 0, mode: str | None = None) -> np.ndarray:
        """[rooms, seeds, Q] errors of a method: ovib, regression (at k), raw or floor."""
        part = self.data[f"{method}_m"]
        part = part if method == "floor" else part.sel(mode=mode or self.whole)
        part = part.sel(prefix=k) if "prefix" in part.dims else part
        return part.transpose("room", "seed", "query").to_numpy()

    def mean_m(self, method: str, k: int = 0, mode: str | None = None) -> np.ndarray:
        """Mean errors of independent repetitions: rooms, or the queries of somebody's only room."""
        return repetitions(self.errors_m(method, k, mode))

    def payload_bytes(self, method: str, k: int, mode: str) -> int:
        """Bytes of one representation: header and prefix, or the kept views as float32."""
        dim = self.scenes[0][0].features.shape[2]
        return representation_bytes(k) if method == "ovib" else 4 * dim * len(MODES[mode])


def repetitions(errors: np.ndarray) -> np.ndarray:
    """Means over training seeds, and over queries where there are several rooms, of values [rooms, seeds, Q, ...]."""
    return errors.mean(axis=(1, 2)) if len(errors) > 1 else errors[0].mean(axis=0)


def spread_of(errors_m: np.ndarray) -> dict[str, Interval]:
    """Mean, 90th percentile and recall of errors [rooms, seeds, Q], with intervals over repetitions."""
    p90_m, recall = tails_of(errors_m)
    return {"mean_m": interval(repetitions(errors_m)), "p90_m": interval(p90_m), "recall": interval(recall)}


def tails_of(errors_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """90th percentile per room, and recall per repetition, of errors [rooms, seeds, Q]."""
    p90_m = np.percentile(errors_m, 90, axis=2).mean(axis=1)
    return p90_m, repetitions((errors_m <= RECALL_M).astype(float))


def platform_of(features: FeatureSet) -> str:
    """The platform that carries as many views as somebody's features have."""
    return "UAV" if features.features.shape[1] == 5 else "UGV"


def room_config(platform: str, room: int) -> RoomConfig:
    """The embedded room of a platform of `PLATFORMS`."""
    return platform_room(platform.lower(), room)


def embedded_scenes(rooms: Sequence[int]) -> dict[str, dict[int, Scene]]:
    """References and queries of every embedded room, by platform and room."""
    configs = [room_config(platform, room) for platform in PLATFORMS for room in rooms]
    with progress_bar(f"rendering {len(configs)} rooms", len(configs)) as update:
        scenes = rooms_features(configs, on_rooms=update)
    halves = scenes[: len(rooms)], scenes[len(rooms) :]
    return {name: dict(zip(rooms, half, strict=True)) for name, half in zip(PLATFORMS, halves, strict=True)}


def measure(
    sweep: Sweep,
    name: str,
    scenes: Mapping[int, Scene],
    seeds: list[int],
    steps: int,
    checkpoints: int,
    rank: int | None,
) -> PlatformResults:
    """The whole protocol of one platform over rooms and training seeds, as one sweep.

    Args:
        sweep: runs a sweep.
        name: the platform.
        scenes: references and queries by the room's name.
        seeds: training seeds.
        steps: training steps.
        checkpoints: of early stopping.
        rank: coordinates kept per view; None keeps all.

    Returns:
        The results.
    """
    prepared = [scene_data(*scene, rank) for scene in scenes.values()]
    n_views, dim = prepared[0][0].x.shape[1:]
    arch = Architecture(n_views=n_views, view_dim=dim, latent=PAPER_PREFIXES[-1], hidden=256, last_hidden=128, head=128)
    data = sweep(
        f"{name}: training and judging",
        Protocol(TrainConfig(arch=arch, steps=steps), PAPER_PREFIXES, checkpoints),
        {"room": list(scenes), "seed": seeds},
        Along("room", prepared),
        dims=DIMS,
        coords={"mode": list(modes_for(n_views)), "prefix": list(PAPER_PREFIXES)},
    )
    return PlatformResults(name, data, list(scenes.values()), list(scenes))


def table_rows(found: PlatformResults) -> Iterable[dict[str, Any]]:
    """One tidy row per room, training seed, view mode, method and prefix; retrieval has no training seed."""
    cases = [("retrieval", "raw", 0)] + [("ovib", "ovib", k) for k in PAPER_PREFIXES]
    for mode in found.data.mode.to_numpy().tolist():
        for method, field, k in cases:
            errors_m = found.errors_m(field, k, mode)
            for r, s in np.ndindex(errors_m.shape[:2]):
                if method == "retrieval" and s > 0:
                    continue
                one = errors_m[r, s]
                eta = 0.0 if method == "retrieval" else float(found.data.eta.sel(mode=mode, prefix=k)[r, s])
                yield {
                    "platform": found.name,
                    "method": method,
                    "mode": mode,
                    "k": k or found.payload_bytes(method, k, mode) // 4,
                    "room": found.rooms[r],
                    "seed": int(found.data.seed[s]) if method == "ovib" else "",
                    "payload_bytes": found.payload_bytes(method, k, mode),
                    "mean_m": float(one.mean()),
                    "p90_m": float(np.percentile(one, 90)),
                    "recall_0.5m": float((one <= RECALL_M).mean()),
                    "eta": eta,
                    "floor_m": float(found.errors_m("floor")[r, s].mean()),
                }


def summary_rows(found: PlatformResults) -> Iterable[dict[str, Any]]:
    """The paper's table: ours with 95 % intervals, and the paper's numbers."""
    for key, theirs in PAPER[found.name].table.items():
        k = key if isinstance(key, int) else 0
        method = "ovib" if k else "raw"
        spread = spread_of(found.errors_m(method, k))
        yield {
            "platform": found.name,
            "representation": f"O-VIB-{k}" if k else "retrieval",
            "kb": f"{found.payload_bytes(method, k, found.whole) / 1024:.3f}",
            "mean_m": spread["mean_m"].text(digits=3),
            "p90_m": spread["p90_m"].text(digits=3),
            "recall_0.5m": spread["recall"].text(digits=3),
            **{f"paper_{name}": value for name, value in zip(("kb", "mean", "p90", "recall"), theirs, strict=True)},
        }
