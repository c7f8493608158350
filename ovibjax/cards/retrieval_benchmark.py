"""The multi-scene retrieval benchmark: five towns, queries coded by a label-free encoder, draws of held-out queries.

A fixed 30 % of the frames is the pool that queries are drawn from; the encoder is trained on the others, by masked
reconstruction alone, as one code serves every scene. A draw takes its queries out of the pool, and all other frames are
the database: uncompressed descriptors. So a query is off its references by about the spacing of the drive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.index import build_index
from ovibjax.edge.pruning import Asked, Pruning, judge_pruning
from ovibjax.encoder.checkpoint import CheckpointConfig, train_checkpoint
from ovibjax.encoder.model import decode, encode
from ovibjax.encoder.recipe import PAPER_PREFIXES
from ovibjax.features.basis import project
from ovibjax.features.frames import FeatureSet
from ovibjax.features.places import from_origin, origin_of
from ovibjax.world.town.feature_set import town_features
from ovibjax.world.town.layout import TownConfig

TOWNS = (5, 6, 7, 8, 9)
SIZE_M = 220.0
FRAMES, QUERIES = 4593, 400
"""The paper's sampled benchmark: frames in five scenes, queries among them."""
TILE_M = 30.0
"""Tiles of the paper's operating point. "93.3% of fine-search descriptors pruned" leaves twelve tiles 6.7 % of 4,193
descriptors (frames less queries), 23.4 each. Tiles of 30 m hold 24.1 on our drives, of 20 m 15.0, of 40 m 35.2."""
POOL = 0.3
RAW = 0
"""Stands for a query that is not coded, in place of its prefix length."""
_PREFIXES = tuple(sorted({*PAPER_PREFIXES, 35}))

_judge = jax.jit(judge_pruning)


class Point(NamedTuple):
    """How far the search is narrowed: scenes kept, tiles kept, tile edge in metres."""

    scenes: int
    tiles: int
    tile_m: float


@dataclass(frozen=True)
class Benchmark:
    """Frames of all scenes, described.

    Attributes:
        descriptor: [N, d] uncompressed descriptors of all views, in the basis fitted on training frames.
        coded: per prefix length, [N, d] what the edge decodes; `RAW` gives `descriptor`.
        position_m: [N, 2] positions; every scene has coordinates of its own.
        scene: [N] int32 scene numbers.
        pool: frames that queries are drawn from.
        views: per scene, [F, M, d] what each view adds to the descriptor of each frame.
    """

    descriptor: np.ndarray
    coded: dict[int, np.ndarray]
    position_m: np.ndarray
    scene: np.ndarray
    pool: np.ndarray
    views: list[np.ndarray]

    def draw(self, seed: int, queries: int) -> tuple[np.ndarray, np.ndarray]:
        """Frames that a draw asks about, and those in its database, both ascending."""
        asked = np.sort(np.random.default_rng([seed, 0xCF]).choice(self.pool, queries, replace=False))
        return asked, np.setdiff1d(np.arange(len(self.scene)), asked)


def town_of(scene: int) -> TownConfig:
    """The town of a scene: the paper's scenes are different CARLA towns, and so each of ours has a style of its own.

    Args:
        scene: its number, from 0.

    Returns:
        The town's description.
    """
    return TownConfig(seed=TOWNS[scene], size_m=SIZE_M, style=1 + scene)


def five_towns(frames: int, towns: int = len(TOWNS), on_frames: Callable[[int, int], None] | None = None) -> FeatureSet:
    """A drive through each town, as one set.

    Args:
        frames: frames in all, shared out equally.
        towns: how many towns.
        on_frames: called with (done, total) as frames are rendered.

    Returns:
        The set; `scene_id` is the town's number.
    """
    parts = [len(part) for part in np.array_split(np.arange(frames), towns)]
    sets = []
    for i, count in enumerate(parts):

        def report(done: int, _: int, before: int = sum(parts[:i])) -> None:
            if on_frames is not None:
                on_frames(before + done, frames)

        sets.append(town_features(town_of(i), count, on_frames=report))
    joined = FeatureSet(*(np.concatenate(fields) for fields in zip(*sets, strict=True)))
    return joined._replace(scene_id=np.repeat(np.arange(towns, dtype=np.int32), parts))


def make_benchmark(features: FeatureSet, ks: Sequence[int], rank: int | None, steps: int) -> Benchmark:
    """Train the code on the frames outside the pool, and describe all frames.

    Args:
        features: frames of all scenes.
        ks: prefix lengths at which queries are coded.
        rank: coordinates kept per view; None keeps all.
        steps: training steps.

    Returns:
        The benchmark.
    """
    n, n_views, dim = features.features.shape
    order = np.random.default_rng(0xCF).permutation(n)
    pool, training = np.sort(order[: round(POOL * n)]), np.sort(order[round(POOL * n) :])
    config = CheckpointConfig(rank=rank or dim, steps=steps, prefixes=_PREFIXES, mixed=0, hidden=512, last_hidden=256)
    checkpoint = train_checkpoint(jax.random.key(0), features.features[training], config)
    x = project(checkpoint.basis, features.features)
    flat = x.reshape(n, -1)

    @jax.jit
    def code(x: jax.Array, k: jax.Array) -> jax.Array:
        mu, _ = encode(checkpoint.params, x, checkpoint.arch)
        kept = (jnp.arange(checkpoint.arch.latent) < k).astype(jnp.float32)
        return decode(checkpoint.params, mu, kept, checkpoint.arch)

    scene = np.unique(features.scene_id, return_inverse=True)[1].ravel().astype(np.int32)
    blocks = np.zeros((n, n_views, *x.shape[1:]), np.float32)
    blocks[:, np.arange(n_views), np.arange(n_views)] = x
    blocks = blocks.reshape(n, n_views, -1)
    return Benchmark(
        descriptor=flat,
        coded={k: flat if k == RAW else np.asarray(code(jnp.asarray(flat), jnp.int32(k))) for k in ks},
        position_m=from_origin(features.positions_m, origin_of(features.positions_m))[:, :2],
        scene=scene,
        pool=pool,
        views=[blocks[scene == s] for s in range(scene.max() + 1)],
    )


def judge_draw(
    benchmark: Benchmark, seed: int, queries: int, k: int, tile_m: float, scenes: Sequence[int], tiles: Sequence[int]
) -> Pruning:
    """Judge a grid of scenes and tiles kept on one draw of queries.

    Args:
        benchmark: the frames.
        seed: the draw.
        queries: how many.
        k: prefix length of the coded queries, or `RAW`.
        tile_m: edge of a tile.
        scenes: scene prototypes kept.
        tiles: tile prototypes kept.

    Returns:
        Means over the queries, [scenes, tiles], on the host.
    """
    asked, kept = benchmark.draw(seed, queries)
    index = build_index(benchmark.descriptor[kept], benchmark.position_m[kept], benchmark.scene[kept], tile_m)
    queried = (benchmark.coded[k][asked], benchmark.position_m[asked], benchmark.scene[asked])
    truth = Asked(*map(jnp.asarray, queried))
    grid = (jnp.asarray(scenes, jnp.int32), jnp.asarray(tiles, jnp.int32))
    judged: Pruning = jax.device_get(_judge(truth, index, jnp.asarray(benchmark.position_m[kept]), *grid))
    return judged
