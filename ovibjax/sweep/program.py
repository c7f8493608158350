"""The compiled program of a sweep: one batch of members, of one size whatever the grid.

A batch is `lanes` members side by side on every device. On a CPU its size follows from the member alone: a large member
gains nothing from company and loses the cache, so that it runs alone, and small ones share a batch, whatever their
points. An accelerator is filled: as many members as fit and as the grid has, of one outer value (its data and random
numbers are there once) where it has that many. A store keeps the size that it was begun with. The grid of a later
command, its shard and the memory that happens to be free change nothing: a member is computed by the same program
whoever asks for it, and gives the same bits.
"""

import hashlib
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from ovibjax.errors import InputError
from ovibjax.sweep.memory import live_bytes, subprograms

MemberFn = Callable[[jax.Array, dict[str, jax.Array], Any], Mapping[str, Any]]
"""`fn(key, point, shared) -> dict of arrays`, pure."""

SEED = "seed"
"""The axis that random numbers follow."""

# Members that keep less alive than a core's cache share it; a larger one has it for itself.
_CACHE_BYTES = 1 << 20
# Places of a batch that stay empty cost as much as full ones: beyond this many, starting a program costs no more.
_MOST_LANES_CPU = 64
# What a batch may keep alive on an accelerator; not what is free today.
_DEVICE_BYTES = 8 << 30
_LEAST_LANES, _MOST_LANES = 8, 1024
# Data that the members of a batch bring along on a CPU.
_OWN_BYTES = 64 << 20

_compiled: dict[str, Any] = {}
_compiling = threading.Lock()
compilations = 0
"""Programs compiled by this process, counted."""


@dataclass(frozen=True)
class Batch:
    """How members are put together: what their bits depend on beside the member function.

    Attributes:
        lanes: members vmapped together on one device.
        grouped: whether all of them have the same outer value.
    """

    lanes: int
    grouped: bool


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one level, names joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        more = flatten(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
        if flat.keys() & more.keys():
            raise InputError(f"the member function has two outputs {min(flat.keys() & more.keys())!r}")
        flat |= more
    return flat


def member(
    fn: Callable[..., Mapping[str, Any]], point: dict[str, jax.Array], shared: Any, *common: Any
) -> dict[str, jax.Array]:
    """One member: its key depends on its seed alone, so members of equal seed share their random numbers."""
    key = jax.random.key(point.get(SEED, 0))
    return {name: jnp.asarray(value) for name, value in flatten(fn(key, point, shared, *common)).items()}


def trace_member(fn: MemberFn, point: dict[str, Any], shared: Any) -> tuple[dict[str, Any], int]:
    """Look at one member without running it.

    Args:
        fn: the member function.
        point: a value per axis.
        shared: data.

    Returns:
        Shape and type of each output; bytes that it keeps alive while it runs, outputs included (no bound if it calls
        a function of the host, which need not know batches and gains nothing from them).
    """
    traced = jax.make_jaxpr(lambda p, s: member(fn, p, s), return_shape=True)
    jaxpr, outputs = traced(point, shared)
    size = sum(int(np.prod(aval.shape)) * aval.dtype.itemsize for aval in jaxpr.out_avals)
    return outputs, sys.maxsize if _calls_host(jaxpr.jaxpr) else live_bytes(jaxpr) + size


def _calls_host(jaxpr: Any) -> bool:
    return any("callback" in eqn.primitive.name or any(map(_calls_host, subprograms(eqn))) for eqn in jaxpr.eqns)


def choose_batch(alive_bytes: int, own_bytes: int, members: int, inner: int | None) -> Batch:
    """How members are put together, from what one keeps alive and the kind of device.

    Args:
        alive_bytes: see `trace_member`.
        own_bytes: size of the data that each outer value has for itself; 0 where they do not differ.
        members: members of the grid.
        inner: members of each outer value; None without an outer dimension.

    Returns:
        The batch; its lanes are a power of two.
    """
    alive_bytes = max(alive_bytes, 1)
    if jax.default_backend() == "cpu":
        lanes = min(_CACHE_BYTES // alive_bytes, _MOST_LANES_CPU)
        if own_bytes:  # each member of a batch brings its own
            lanes = min(lanes, _OWN_BYTES // own_bytes)
        return Batch(_power_of_two(lanes), False)
    lanes = _power_of_two(min(_DEVICE_BYTES // alive_bytes, _MOST_LANES))
    if inner is not None and inner >= lanes > 1:
        return Batch(lanes, True)
    wanted = max(_LEAST_LANES, next_power_of_two(members))
    return Batch(_power_of_two(min(_DEVICE_BYTES // (alive_bytes + own_bytes), _MOST_LANES, wanted)), False)


def _power_of_two(most: int) -> int:
    """The largest power of two up to a number, at least 1."""
    return 1 << max(0, most.bit_length() - 1)


def next_power_of_two(least: int) -> int:
    """The smallest power of two from a positive number on."""
    return 1 << (least - 1).bit_length()


def batch_function(
    fn: Callable[..., Mapping[str, Any]], batch: Batch, outer: Sequence[str], along: bool, devices: int
) -> Callable[..., dict[str, jax.Array]]:
    """The function of one batch, shared among devices where there are several.

    Args:
        fn: the member function; it may take numbers beside, which are the same for all members.
        batch: how members are put together.
        outer: axes of the outer dimension.
        along: whether data differ along it.
        devices: devices D.

    Returns:
        A function of points [D * lanes] and data, which lead with [D * lanes], or with [D] where the batch is grouped,
        if they differ, and of what is the same for all; its outputs [D * lanes, ...].
    """

    def together(points: dict[str, jax.Array], shared: Any, *same: Any) -> dict[str, jax.Array]:
        def first(tree: Any) -> Any:
            return jax.tree.map(lambda leaf: leaf[0], tree)

        if batch.lanes == 1:  # no batch axis at all: the program of a single member
            found = member(fn, first(points), first(shared) if along else shared, *same)
            return jax.tree.map(lambda leaf: leaf[None], found)
        if batch.grouped:
            common = {name: points[name][0] for name in outer}
            inner = {name: values for name, values in points.items() if name not in outer}
            data = first(shared) if along else shared
            if not inner:
                found = member(fn, common, data, *same)
                return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (batch.lanes, *leaf.shape)), found)
            return jax.vmap(lambda point: member(fn, {**common, **point}, data, *same))(inner)
        return jax.vmap(lambda point, data: member(fn, point, data, *same), (0, 0 if along else None))(points, shared)

    if devices == 1:
        return together
    mesh, split = _mesh(devices), P("members")

    def shared_out(points: dict[str, jax.Array], shared: Any, *same: Any) -> dict[str, jax.Array]:
        specs = (split, split if along else P(), *[P()] * len(same))
        shared_out = jax.shard_map(together, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)
        return shared_out(points, shared, *same)

    return shared_out


def _mesh(devices: int) -> Mesh:
    return Mesh(np.array(jax.local_devices()[:devices]), ("members",))


def by_member(devices: int) -> NamedSharding | None:
    """How arrays that lead with [D * lanes] lie on several devices between two programs; None for one device."""
    return None if devices == 1 else NamedSharding(_mesh(devices), P("members"))


class Program:
    """A compiled batch; callable from several threads.

    Attributes:
        text_hash: hash of the program's text, which changes when the member function or its static settings do.
        key: what tells it from every other program of this process.
    """

    def __init__(self, function: Callable[..., Any], fn: Any, devices: int, arguments: Any) -> None:
        """Lower for arguments of these shapes; compiled at the first call, once per process."""
        # An argument that is dropped because it is unused would leave two functions of different ones with equal text.
        self._lowered = jax.jit(function, keep_unused=True).lower(*arguments)
        text = self._lowered.as_text()
        self.text_hash = hashlib.sha256(text.encode()).hexdigest()
        names = jax.tree.structure(arguments)  # the text does not have them
        # Nor does it say which host function a callback calls.
        callback = id(fn) if "callback" in text else 0
        self.key = f"{self.text_hash} {callback} {names} {[d.id for d in jax.local_devices()[:devices]]}"

    def __call__(self, points: dict[str, np.ndarray], shared: Any) -> dict[str, np.ndarray]:
        """Compute one batch.

        Args:
            points: a value of each axis per member.
            shared: data.

        Returns:
            Outputs per member on the host.
        """
        return jax.device_get(self.on_device(points, shared))

    def whole(self, points: dict[str, np.ndarray], shared: Any) -> dict[str, np.ndarray]:
        """All that there is of a batch: its outputs."""
        return self(points, shared)

    def on_device(self, *arguments: Any) -> dict[str, jax.Array]:
        """Compute one batch and leave its outputs where they are; arguments are those of its function."""
        global compilations
        with _compiling:
            if self.key not in _compiled:
                _compiled[self.key] = self._lowered.compile()
                compilations += 1
        return _compiled[self.key](*arguments)
