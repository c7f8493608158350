"""The edge in plain float64 NumPy: retrieval, position estimate, error summary."""

import math

import numpy as np


def errors(est, truth):
    """Euclidean distance of each pair of rows."""
    est, truth = np.asarray(est, np.float64), np.asarray(truth, np.float64)
    return np.array([math.dist(a, b) for a, b in zip(est, truth, strict=True)])


def mix(reg, ret, eta):
    """eta * regression + (1 - eta) * retrieval."""
    return eta * np.asarray(reg, np.float64) + (1 - eta) * np.asarray(ret, np.float64)


def mean_errors(reg, ret, truth):
    """Mean error at 0, 0.05, ..., 1, as (eta, mean) pairs."""
    return [(i / 20, errors(mix(reg, ret, i / 20), truth).mean()) for i in range(21)]


def select_eta(reg, ret, truth):
    """First weight on the grid with the lowest mean error."""
    best = (None, math.inf)
    for eta, mean in mean_errors(reg, ret, truth):
        if mean < best[1]:
            best = (eta, mean)
    return best[0]


def cosines(query, db):
    """[Q, N] cosine similarity; a zero vector is similar to nothing (0)."""
    query, db = np.asarray(query, np.float64), np.asarray(db, np.float64)
    norms = np.outer(np.linalg.norm(query, axis=1), np.linalg.norm(db, axis=1))
    return np.divide(query @ db.T, norms, out=np.zeros_like(norms), where=norms > 0)


def retrieve(query, db):
    """Most similar row of each query, first of equals."""
    return np.array([int(np.argmax(row)) for row in cosines(query, db)])


def unit(rows):
    """Rows over their norms; a zero row stays zero."""
    rows = np.asarray(rows, np.float64)
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.divide(rows, norms, out=np.zeros_like(rows), where=norms > 0)


def coarse_to_fine(query, db, tile, scene, scenes, tiles):
    """Scenes by prototype, tiles of these by prototype, rows of these; lower scene, tile and row first among equals.

    `tile` and `scene` number the rows' tiles and scenes from 0. Returns rows, kept scenes and kept tiles per query.
    """
    rows, reference = unit(query), unit(db)
    prototypes = {}
    for s in sorted(set(scene.tolist())):
        members = [i for i in range(len(db)) if scene[i] == s]
        inside = {t: [i for i in members if tile[i] == t] for t in sorted({int(tile[i]) for i in members})}
        prototypes[s] = (unit([reference[members].mean(axis=0)])[0], inside)
    tile_mean = {
        t: unit([reference[r].mean(axis=0)])[0] for _, inside in prototypes.values() for t, r in inside.items()
    }
    found, kept_scenes, kept_tiles = [], [], []
    for q in rows:
        best = sorted(prototypes, key=lambda s: (-round(float(prototypes[s][0] @ q), 12), s))[:scenes]
        inside = {t: r for s in best for t, r in prototypes[s][1].items()}
        chosen = sorted(inside, key=lambda t: (-round(float(tile_mean[t] @ q), 12), t))[:tiles]
        searched = sorted(i for t in chosen for i in inside[t])
        similarity = [round(float(reference[i] @ q), 12) for i in searched]
        found.append(searched[similarity.index(max(similarity))])
        kept_scenes.append(sorted(best))
        kept_tiles.append(chosen)
    return np.array(found), kept_scenes, kept_tiles


def fused_similarity(weights, one, other):
    """Weighted sum over views of inner products."""
    return sum(w * (a @ b) for w, a, b in zip(weights, one, other, strict=True))


def surrogate(weights, features, positions, folds, temperature):
    """Softmax-averaged position error of each frame among the frames of other folds, averaged over frames."""
    features, positions = np.asarray(features, np.float64), np.asarray(positions, np.float64)
    total = 0.0
    for i in range(len(features)):
        others = [j for j in range(len(features)) if folds[j] != folds[i]]
        fused = np.array([fused_similarity(weights, features[i], features[j]) for j in others])
        share = np.exp((fused - fused.max()) / temperature)
        share /= share.sum()
        total += sum(p * math.dist(positions[i], positions[j]) for p, j in zip(share, others, strict=True))
    return total / len(features)


def fold_error(weights, features, positions, folds):
    """Mean error of retrieving each frame from the frames of other folds."""
    features = np.asarray(features, np.float64)
    total = 0.0
    for i in range(len(features)):
        others = [j for j in range(len(features)) if folds[j] != folds[i]]
        fused = [fused_similarity(weights, features[i], features[j]) for j in others]
        total += math.dist(positions[i], positions[others[int(np.argmax(fused))]])
    return total / len(features)


def nearest(query, db, block, prototype, k, probes):
    """Blocks by the inner product with their prototype, then rows of these; lower row first among equals.

    `block` numbers the rows' blocks from 0. Returns per query a list of at most k (row, similarity).
    """
    similarity, score = cosines(query, db), unit(query) @ np.asarray(prototype, np.float64).T
    found = []
    for q in range(len(score)):
        kept = sorted(range(len(prototype)), key=lambda b: (-score[q][b], b))[:probes]
        rows = [i for i in range(len(db)) if block[i] in kept]
        rows.sort(key=lambda i: (-round(similarity[q][i], 12), i))
        found.append([(i, similarity[q][i]) for i in rows[:k]])
    return found
