"""One compiled program that computes any chunk of a sweep, and the choice of the chunk's size.

Members of a chunk are vmapped `lanes` at a time and otherwise run in turn inside the program. On a CPU, where a large
member gains nothing from company and loses the cache, lanes follow from how much memory a member keeps alive; on an
accelerator as many run together as fit. Several devices split the inner points (or the outer values) of a chunk.
"""

import hashlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from ovibjax.errors import InputError
from ovibjax.runtime.threads import workers
from ovibjax.sweep.grid import Grid
from ovibjax.sweep.memory import available_bytes, live_bytes

MemberFn = Callable[[jax.Array, dict[str, jax.Array], Any], Mapping[str, Any]]
"""`fn(key, point, shared) -> dict of arrays`, pure."""

SEED = "seed"
"""The axis that random numbers follow."""

# Members that keep less alive than a core's cache share it; a larger one has it for itself.
_CACHE_BYTES = 1 << 20
_MEMORY_SHARE = 0.5
_MAX_CHUNKS = 1024

_compiled: dict[str, Any] = {}
_compiling = threading.Lock()
compilations = 0
"""Programs compiled by this process, counted."""


@dataclass(frozen=True)
class Shape:
    """Size of a chunk and how it is computed; part of a store's configuration, because bits depend on it.

    Attributes:
        rows: outer values per chunk.
        columns: inner points per chunk.
        lanes: members vmapped together on one device.
        devices: devices that share a chunk.
    """

    rows: int
    columns: int
    lanes: int
    devices: int


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one level, names joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        more = flatten(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
        if flat.keys() & more.keys():
            raise InputError(f"the member function has two outputs {min(flat.keys() & more.keys())!r}")
        flat |= more
    return flat


def member(fn: MemberFn, point: dict[str, jax.Array], shared: Any) -> dict[str, jax.Array]:
    """One member: its key depends on its seed alone, so members of equal seed share their random numbers."""
    key = jax.random.key(point.get(SEED, 0))
    return {name: jnp.asarray(value) for name, value in flatten(fn(key, point, shared)).items()}


def chunk_function(fn: MemberFn, shape: Shape, along: bool) -> Callable[..., Any]:
    """The function of one chunk, sharded over devices where there are several.

    Args:
        fn: the member function.
        shape: size of the chunk.
        along: whether shared data have a leading axis of outer values.

    Returns:
        A function of outer points [rows], inner points [columns] and shared data, that returns [rows, columns, ...].
    """
    by_columns = shape.columns % shape.devices == 0
    rows, columns = (
        (shape.rows, shape.columns // shape.devices) if by_columns else (shape.rows // shape.devices, shape.columns)
    )

    def block(outer: Any, inner: Any, shared: Any) -> Any:
        def row(operand: Any) -> Any:
            outer_point, data = operand
            return _map(lambda point: member(fn, {**outer_point, **point}, data), inner, columns, shape.lanes)

        row_lanes = shape.lanes // columns

        if along:
            return _map(row, (outer, shared), rows, row_lanes)
        return _map(lambda outer_point: row((outer_point, shared)), outer, rows, row_lanes)

    if shape.devices == 1:
        return block
    mesh = Mesh(np.array(jax.local_devices()[: shape.devices]), ("members",))
    split = P("members")
    specs = (P(), split, P()) if by_columns else (split, P(), split if along else P())
    out = P(None, "members") if by_columns else split
    return jax.shard_map(block, mesh=mesh, in_specs=specs, out_specs=out, check_vma=False)


def _map(function: Callable[[Any], Any], xs: Any, size: int, lanes: int) -> Any:
    """`vmap` where all fit side by side, in turn where nothing does, groups in between."""
    if size == 1:  # no batch axis at all: the program of a single member
        return jax.tree.map(lambda y: y[None], function(jax.tree.map(lambda x: x[0], xs)))
    if not jax.tree.leaves(xs):  # no axis to map over: all are the same
        return jax.tree.map(lambda y: jnp.broadcast_to(y, (size, *y.shape)), function(xs))
    if lanes >= size:
        return jax.vmap(function)(xs)
    return jax.lax.map(function, xs, batch_size=lanes if lanes > 1 else None)


def trace_member(fn: MemberFn, point: dict[str, Any], shared: Any) -> tuple[dict[str, Any], tuple[int, int]]:
    """Look at one member without running it.

    Args:
        fn: the member function.
        point: a value per axis.
        shared: data.

    Returns:
        Shape and type of each output; bytes it keeps alive while it runs, and bytes of its outputs.
    """
    traced = jax.make_jaxpr(lambda p, s: member(fn, p, s), return_shape=True)
    jaxpr, outputs = traced(point, shared)
    size = sum(int(np.prod(aval.shape)) * aval.dtype.itemsize for aval in jaxpr.out_avals)
    return outputs, (live_bytes(jaxpr), size)


def choose_shape(grid: Grid, outer: int | None, cost: tuple[int, int], chunk: int | None, lanes: int | None) -> Shape:
    """Size of a chunk from memory and number of devices.

    Args:
        grid: the grid.
        outer: position of its outer dimension, or None.
        cost: bytes a member keeps alive, bytes of its outputs.
        chunk: members per chunk, chosen if None.
        lanes: members vmapped together, chosen if None.

    Returns:
        The shape; `rows` grows beyond 1 only when a chunk holds all inner points.
    """
    devices = jax.local_devices()
    n_outer = 1 if outer is None else grid.shape[outer]
    n_inner = grid.size // n_outer
    alive, output = max(cost[0], 1), cost[1]
    at_once = len(devices) if len(devices) > 1 else workers()
    fit = max(1, int(_MEMORY_SHARE * available_bytes(devices[0]) / (alive + output) / at_once))
    on_cpu = devices[0].platform == "cpu"
    if lanes is None:
        lanes = min(fit, _CACHE_BYTES // alive) if on_cpu else fit
    lanes = max(1, min(lanes, chunk or grid.size, grid.size))
    if chunk is None:
        # Small enough that every worker has several and little is lost when one is interrupted, yet not too many.
        chunk = max(lanes * len(devices), -(-grid.size // _MAX_CHUNKS))
    by_columns = n_inner >= len(devices) or n_outer == 1
    column_devices, row_devices = (len(devices), 1) if by_columns else (1, len(devices))
    # Whole groups of lanes on every device: a remainder would be a second program inside the first.
    per_device = -(-min(chunk, n_inner) // column_devices)
    side_by_side = min(lanes, per_device)
    columns = -(-per_device // side_by_side) * side_by_side * column_devices
    row_lanes = max(1, lanes // per_device) if side_by_side == per_device else 1
    rows_per_device = -(-min(max(1, chunk // columns), n_outer) // row_devices)
    row_lanes = min(row_lanes, rows_per_device)
    rows = -(-rows_per_device // row_lanes) * row_lanes * row_devices
    return Shape(rows, columns, side_by_side * row_lanes, len(devices))


class Program:
    """A compiled chunk; callable from several threads.

    Attributes:
        text_hash: hash of the program's text, which changes when the member function or its static settings do.
    """

    def __init__(self, fn: MemberFn, shape: Shape, along: bool, arguments: Any) -> None:
        """Lower for arguments of these shapes; compiled at the first call, once per process."""
        # An argument that is dropped because it is unused would leave two functions of different ones with equal text.
        self._lowered = jax.jit(chunk_function(fn, shape, along), keep_unused=True).lower(*arguments)
        text = self._lowered.as_text()
        self.text_hash = hashlib.sha256(text.encode()).hexdigest()
        names = jax.tree.structure(arguments)  # the text does not have them
        # Nor does it say which host function a callback calls.
        callback = id(fn) if "callback" in text else 0
        self._key = f"{self.text_hash} {callback} {names} {[d.id for d in jax.local_devices()[: shape.devices]]}"

    def __call__(self, outer: Any, inner: Any, shared: Any) -> dict[str, np.ndarray]:
        """Compute one chunk.

        Args:
            outer: outer values of each axis, [rows].
            inner: inner values of each axis, [columns].
            shared: data.

        Returns:
            Outputs [rows, columns, ...] on the host.
        """
        global compilations
        with _compiling:
            if self._key not in _compiled:
                _compiled[self._key] = self._lowered.compile()
                compilations += 1
        return jax.device_get(_compiled[self._key](outer, inner, shared))
