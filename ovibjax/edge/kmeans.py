"""Rows into clusters of bounded size: Lloyd's k-means, and cuts where a cluster is still too large.

On the host: it is done once per database, its shapes depend on the data, and a product of rows with centres is nearly
all of its time.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

ROUNDS = 8
"""Rounds of Lloyd's algorithm."""
_SCORES = 1 << 24
_SAMPLED = 128
_POWER_ROUNDS = 4

Rows = NDArray[np.float32]
Labels = NDArray[np.int64]


def kmeans(rows: Rows, count: int, rng: np.random.Generator, sampled: int | None = None) -> Labels:
    """Cluster of each row, by Lloyd's algorithm from rows drawn at random.

    Args:
        rows: [N, d], N at least 1.
        count: clusters at most; duplicates and fewer rows give fewer.
        rng: draws the first centres.
        sampled: rows that the centres are found on, drawn as well; all by default.

    Returns:
        [N] cluster of each row, below `count`; some may own none.
    """
    count = min(count, len(rows))
    if count == 1:
        return np.zeros(len(rows), np.int64)
    some = rows
    if sampled is not None and sampled < len(rows):
        some = rows[np.sort(rng.choice(len(rows), sampled, replace=False))]
    count = min(count, len(some))
    centre = some[rng.choice(len(some), count, replace=False)]
    for _ in range(ROUNDS):
        label = _nearest(some, centre)
        owned = np.bincount(label, minlength=count)
        sums = csr_array((np.ones(len(some), np.float32), (label, np.arange(len(some)))), (count, len(some))) @ some
        # A centre that owns nothing stays where it is.
        centre = np.where(owned[:, None] > 0, sums / np.maximum(owned, 1)[:, None], centre).astype(np.float32)
    return _nearest(rows, centre)


def clusters_of_at_most(size: int, mean: int, rows: Rows, group: Labels, rng: np.random.Generator) -> Labels:
    """Clusters inside of groups, none of more than so many rows.

    Args:
        size: rows of a cluster at most.
        mean: rows of a cluster on average, about; at most `size`.
        rows: [N, d].
        group: [N] group of each row; a cluster holds rows of one group.
        rng: draws the first centres.

    Returns:
        [N] cluster of each row, numbered from 0 without gaps and group by group.
    """
    order = np.argsort(group, kind="stable")
    ends = np.flatnonzero(np.diff(group[order])) + 1
    label, used = np.empty(len(rows), np.int64), 0
    for members in np.split(order, ends):
        inside = np.zeros(len(members), np.int64)
        if len(members) > size:
            some = rows[members]
            inside = _cut_large(some, kmeans(some, -(-len(members) // mean), rng), size)
        label[members] = inside + used
        used += int(inside.max()) + 1
    return label


def coarse_groups(rows: Rows, count: int, rng: np.random.Generator) -> Labels:
    """Groups for `clusters_of_at_most` where nothing else gives them, as many as make its work least.

    Args:
        rows: [N, d].
        count: clusters that will be made.
        rng: draws the rows that the groups are found on.

    Returns:
        [N] group of each row, about the square root of `count` of them.
    """
    groups = round(count**0.5)
    return kmeans(rows, groups, rng, sampled=_SAMPLED * groups)


def _nearest(rows: Rows, centre: Rows) -> Labels:
    """[N] nearest centre of each row, the first of equals."""
    label, half = np.empty(len(rows), np.int64), 0.5 * np.sum(centre**2, axis=1)
    step = max(1, _SCORES // len(centre))
    for at in range(0, len(rows), step):
        score = rows[at : at + step] @ centre.T
        score -= half
        label[at : at + step] = np.argmax(score, axis=1)
    return label


def _cut_large(rows: Rows, label: Labels, size: int) -> Labels:
    """Labels without gaps, of clusters cut into equal pieces along their longest direction where they are too large."""
    order = np.argsort(label, kind="stable")
    ends = np.flatnonzero(np.diff(label[order])) + 1
    out, used = np.empty(len(rows), np.int64), 0
    for members in np.split(order, ends):
        pieces = -(-len(members) // size)
        if pieces > 1:
            # Also duplicates, which no k-means tells apart, end up in pieces of a bounded size.
            members = members[np.argsort(_along_longest(rows[members]), kind="stable")]
        out[members] = used + np.arange(len(members)) * pieces // len(members)
        used += pieces
    return out


def _along_longest(rows: Rows) -> Rows:
    """[N] coordinate along nearly the direction of largest variance, by power iteration."""
    centred = rows - rows.mean(axis=0)
    direction = centred[np.argmax(np.sum(centred**2, axis=1))]
    for _ in range(_POWER_ROUNDS):
        direction = centred.T @ (centred @ direction)
        direction = direction / max(float(np.linalg.norm(direction)), 1e-30)
    return centred @ direction
