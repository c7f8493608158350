"""Grids of the whole system as labelled datasets, for the command line, the figure and Python."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import xarray

from ovibjax.control.voi import Prices
from ovibjax.features.frames import FeatureSet
from ovibjax.sweep.engine import run
from ovibjax.system.chain import UNITS, System, dims_of
from ovibjax.system.data import FLOATS, SystemSize, make_system


def sweep_system(
    scene: tuple[list[FeatureSet], int, SystemSize],
    axes: Mapping[str, Any],
    along: tuple[Sequence[int], Sequence[float], Sequence[str]],
    policy: str = "voi",
    coding: tuple[Sequence[str], bool] = (FLOATS, False),
    prices: Prices | None = None,
    **options: Any,
) -> xarray.Dataset:
    """Run the system on a grid in one compiled program.

    Args:
        scene: drives, how many of them are for training, and how much is trained and replayed.
        axes: values of beta, gamma, seed or other `system.HYPERS`; what is trained.
        along: prefixes k, values of V, and schedulers; what a trained member is replayed with.
        policy: request policy.
        coding: how prefixes are written, and whether those that are not floats travel under a compact header.
        prices: of transmission, energy and delay, [codes, K] each where there are codes; `make_controller`'s if None.
        options: further options of `sweep.run`, such as `store`.

    Returns:
        One dimension per axis, then code unless all is sent as floats, k, V and scheduler.
    """
    data, static = make_system(*scene)
    if prices is not None:
        data = data._replace(control=data.control._replace(prices=jax.tree.map(jnp.asarray, prices)))
    prefixes, Vs, schedulers = along
    codes, compact = tuple(coding[0]), coding[1]
    static = replace(static, policy=policy, schedulers=tuple(schedulers), codes=codes, compact=compact)
    coords: dict[str, Any] = {"k": list(prefixes), "V": list(Vs), "scheduler": list(schedulers)}
    shared = (jnp.asarray(prefixes, jnp.int32), jnp.asarray(Vs, jnp.float32), data)
    return run(
        System(static),
        axes,
        shared,
        dims=dims_of(codes),
        coords=coords | ({"code": list(codes)} if codes != FLOATS else {}),
        units=UNITS,
        **options,
    )
