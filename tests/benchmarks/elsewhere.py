"""The default recipe away from where it was tuned: error of O-VIB over that of PCA, on other data, by prefix.

    python -m tests.benchmarks.elsewhere            (a quarter of an hour on two cores)

The recipe was tuned on one town of 4,994 frames. Here it trains on five other towns with 1,000, 2,000 and 5,000 frames,
on frames with random headings, at full feature dimension, on features of a pyramid with other weights or of another
dimension, and on the few frames of the rooms with four and with five views; always with the library's own defaults.
Both codes are judged with the localizer of the O-VIB model that was trained on the same split, over several seeds. What
came out stands in recipe.md.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.edge.judging import Trained, judge_prefixes
from ovibjax.encoder.loss import make_hypers
from ovibjax.encoder.model import Architecture
from ovibjax.encoder.pca import fit_pca
from ovibjax.encoder.train import TrainConfig, fit
from ovibjax.encoder.training_data import member_data
from ovibjax.features.backbones.pyramid import EmbeddedBackbone, embed, embedded_backbone
from ovibjax.features.frames import FeatureSet, make_feature_set
from ovibjax.runtime.batches import first_then_threads, padded_batches
from ovibjax.runtime.precision_choice import faster_precision
from ovibjax.views import full_mode, mode_mask
from ovibjax.world.rooms.feature_set import rooms_features
from ovibjax.world.rooms.room import platform_room
from ovibjax.world.town.feature_set import town_features
from ovibjax.world.town.layout import TownConfig, make_town
from ovibjax.world.town.render import Camera, render
from ovibjax.world.town.route import make_route

KS = (8, 16, 35, 64, 128)
TOWNS = (11, 12, 13, 14, 15)
ROOMS = (20, 21, 22, 23)

_fit = jax.jit(fit, static_argnames="static")
_judge = jax.jit(judge_prefixes, static_argnames="arch")


def drive(town_seed: int, n: int, backbone: EmbeddedBackbone, random_headings: bool) -> FeatureSet:
    """A drive through a town, embedded by any pyramid, with the headings of the drive or random ones."""
    config = TownConfig(seed=town_seed)
    town = make_town(config)
    route = make_route(town, config, n, 0)
    rng = np.random.default_rng(town_seed)
    yaw = rng.uniform(-np.pi, np.pi, n).astype(np.float32) if random_headings else route.yaw_rad
    arrays, weights = jax.tree.map(jnp.asarray, (town, backbone))
    out = np.empty((n, 5, backbone.projection.shape[1]), np.float32)

    def fill(batch: tuple[int, np.ndarray]) -> None:
        count, rows = batch
        views = render(arrays, jnp.asarray(route.positions_m[rows]), jnp.asarray(yaw[rows]), Camera())
        features = np.asarray(embed(weights, views.rgb.reshape(-1, *views.rgb.shape[2:])))
        out[rows[:count]] = features.reshape(len(rows), 5, -1)[:count]

    for _ in first_then_threads(fill, list(padded_batches(np.arange(n), 8))):
        pass
    return make_feature_set(out, route.positions_m, yaw_rad=yaw, source="a town")


def wider(backbone: EmbeddedBackbone, dim: int) -> EmbeddedBackbone:
    """The pyramid projected to another dimension."""
    pooled = backbone.projection.shape[0]
    projection = np.random.default_rng(dim).standard_normal((pooled, dim)) / np.sqrt(pooled)
    return backbone._replace(projection=projection.astype(np.float32))


def room(platform: str, number: int) -> FeatureSet:
    """References and queries of a room as one set."""
    references, queries = rooms_features([platform_room(platform, number)])[0]
    parts = zip(references, queries, strict=True)
    features, positions = (np.concatenate([a, b]) for a, b in list(parts)[:2])
    return make_feature_set(features, positions, source="a room")


def worlds() -> Iterator[tuple[str, Callable[[], FeatureSet], int | None]]:
    """Name, what makes the data, and coordinates kept per view."""
    backbone = embedded_backbone()
    for seed in TOWNS:
        for n in (1000, 2000, 5000):
            yield f"town {seed}, {n} frames", partial(town_features, TownConfig(seed=seed), n), 64
    for n in (2000, 4994):
        yield f"random headings, {n} frames", partial(drive, 0, n, backbone, True), 64
    yield "all 512 coordinates per view, 2000 frames", partial(town_features, TownConfig(), 2000), None
    yield "another pyramid, 4994 frames", partial(drive, 0, 4994, embedded_backbone(7), False), 64
    yield "1280 coordinates per view, 2000 frames", partial(drive, 0, 2000, wider(backbone, 1280), False), 64
    for platform in ("uav", "ugv"):
        for number in ROOMS:
            yield f"room {number}, {platform.upper()}", partial(room, platform, number), 64


def compare(features: FeatureSet, rank: int | None, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """[seeds, prefixes] mean test errors of O-VIB and of PCA, metres."""
    found = []
    for seed in seeds:
        data, _ = member_data(features, seed, rank)
        views, dim = data.train.x.shape[1:]
        static = TrainConfig(Architecture(n_views=views, view_dim=dim), precision=faster_precision())
        params, _ = _fit(jax.random.key(seed), make_hypers(), data.train, static)
        mask, ks = mode_mask(full_mode(views), views), jnp.array(KS)
        judge = partial(_judge, Trained(data, params), static.arch, mask, ks)
        codes = judge(), judge(pca=fit_pca(data.train.x, static.arch.latent))
        found.append([np.asarray(code.test_error_m.mean(axis=1)) for code in codes])
    ovib, pca = np.swapaxes(np.array(found), 0, 1)
    return ovib, pca


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="seeds per data set, from 0 (default 3)")
    parser.add_argument("--only", default="", help="data sets whose name holds this text")
    options = parser.parse_args()
    print(f"{'O-VIB / PCA':45s}" + "".join(f"{f'k = {k}':>9s}" for k in KS) + "   O-VIB at k = 16, 128")
    worst = np.zeros(len(KS))
    for name, make, rank in worlds():
        if options.only not in name:
            continue
        print(f"{name} ...", end="\r", file=sys.stderr, flush=True)
        ovib, pca = compare(make(), rank, range(options.seeds))
        ratio = ovib.mean(axis=0) / pca.mean(axis=0)
        worst = np.maximum(worst, ratio)
        at = {k: ovib[:, KS.index(k)].mean() for k in (16, 128)}
        print(f"{name:45s}" + "".join(f"{r:9.2f}" for r in ratio) + f"   {at[16]:.2f} m, {at[128]:.2f} m", flush=True)
    print(f"{'largest':45s}" + "".join(f"{r:9.2f}" for r in worst))


if __name__ == "__main__":
    main()
