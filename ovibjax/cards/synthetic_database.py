"""Databases of any size that are clustered like real ones: drives recombined, for timing retrieval beyond the data."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SCENE_FRAMES = 900
"""Frames of a synthetic scene, about as many as a scene of the paper's sampled benchmark has."""


class Database(NamedTuple):
    """References and queries of many scenes.

    Attributes:
        reference: [N, d] descriptors.
        position_m: [N, 2] where they were taken, in the scene's own coordinates.
        scene: [N] int32.
        query: [Q, d] descriptors of frames between the references.
        query_scene: [Q] int32, ascending.
    """

    reference: NDArray[np.float32]
    position_m: NDArray[np.float32]
    scene: NDArray[np.int32]
    query: NDArray[np.float32]
    query_scene: NDArray[np.int32]


def recombine(
    seed: int, drives: list[NDArray[np.float32]], positions_m: list[NDArray[np.float32]], n: int, queries: int
) -> Database:
    """Scenes whose views come from drives of their own: front from one, back from another, each moving frame by frame.

    A descriptor is the sum of what its views contribute, so every view is a real one and neighbours are as alike as
    real neighbours, unlike noise, in which prototypes mean nothing; yet no place is in two scenes. A scene is laid
    out along a line, at the distances that the front view moved. Every other frame is a reference, queries are drawn
    from those in between.

    Args:
        seed: the draw.
        drives: [F, M, d] what each view contributes to the descriptor of each frame, per drive, frames in order.
        positions_m: [F, 2] positions of each drive.
        n: references N.
        queries: queries Q.

    Returns:
        The database.
    """
    rng = np.random.default_rng([seed, 0xB1E])
    n_scenes, (n_views, dim) = -(-n // SCENE_FRAMES), drives[0].shape[1:]
    asked = np.bincount(rng.integers(n_scenes, size=queries), minlength=n_scenes)
    ends = np.cumsum(asked)
    made = Database(
        np.zeros((n, dim), np.float32),
        np.zeros((n, 2), np.float32),
        (np.arange(n) // SCENE_FRAMES).astype(np.int32),
        np.zeros((queries, dim), np.float32),
        np.repeat(np.arange(n_scenes), asked).astype(np.int32),
    )
    for s in range(n_scenes):
        rows = slice(s * SCENE_FRAMES, min((s + 1) * SCENE_FRAMES, n))
        kept = np.arange(0, 2 * SCENE_FRAMES, 2)[: rows.stop - rows.start]
        between = rng.choice(kept + 1, asked[s])
        for view in range(n_views):
            drive = rng.integers(len(drives))
            frames = _walk(rng, len(drives[drive]), 2 * SCENE_FRAMES)
            made.reference[rows] += drives[drive][frames[kept], view]
            made.query[ends[s] - asked[s] : ends[s]] += drives[drive][frames[between], view]
            if view == 0:
                moved_m = np.linalg.norm(np.diff(positions_m[drive][frames, :2], axis=0), axis=1)
                made.position_m[rows, 0] = np.concatenate([[0.0], np.cumsum(moved_m)])[kept]
    return made


def _walk(rng: np.random.Generator, frames: int, length: int) -> NDArray[np.int64]:
    """Consecutive frames from a random one on, in a random direction, turning round at the ends."""
    step = rng.choice([-1, 1])
    at = (rng.integers(2 * frames) + step * np.arange(length)) % (2 * frames)
    return np.where(at < frames, at, 2 * frames - 1 - at)
