"""The file that an edge and its robots are made from: one `.npz` of plain arrays, with its version; nothing is pickled.

It holds the network, the edge's references uncompressed, and for robots in a simulated world the frames along their
routes.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from hashlib import sha256
from typing import Any

import jax
import numpy as np

from ovibjax.control.actions import ActionSet
from ovibjax.control.adaptation import ADAPT
from ovibjax.encoder.model import Architecture, Params, init
from ovibjax.errors import StrPath, refusal, unreadable
from ovibjax.features.npz import read_npz, write_npz
from ovibjax.link.codes.coder import Coder
from ovibjax.link.codes.rounding import Grid
from ovibjax.link.codes.tables import CODES, CodeTable
from ovibjax.live.messages import FINGERPRINT_BYTES
from ovibjax.views import MODES

FORMAT = "ovibjax-edge 2"
"""What the array `format` of a file says."""

_PARAMS = "params."
_TABLE, _TABLE_PARTS = "code.{}.{}", ("step", "first", "last", "cumulative")
_MOST_REFERENCES = 1 << 24
_AT_MOST = 1 << 16  # of any width: what a damaged file claims must not take the machine's memory


@dataclass(frozen=True)
class EdgeFile:
    """Everything an edge and its robots know; arrays of NumPy.

    Attributes:
        arch: widths of the network.
        actions: modes and prefixes that the edge serves.
        contexts: names of the route contexts.
        params: parameters of the network.
        reference_x: [R, M, r] features of the references in the network's basis.
        reference_m: [R, 3] where they were taken, from the origin.
        origin_m: [3] float64 origin of all positions.
        edges: [A, L - 1] ascending bounds between levels of distinctness, see `control.calibration`.
        risk_m: [A, L] calibrated residual of each level: what comes with an answer.
        predicted_m: [C, A] g_psi, what robots expect.
        context_share: [C] share of training frames in each context.
        route_x: [F, M, r] features of the robots' frames in the network's basis, route after route.
        route_m: [F, 3] where they are taken, from the origin.
        route_yaw_rad: [F] headings.
        route_context: [F] int32 contexts.
        route_number: [F] int32 ascending, which route a frame belongs to.
        route_residual_m: [F, A, 2] how far off the edge's answer is, x and y.
        route_risk_m: [F, A] the calibrated residual that comes with it.
        tables: what prefixes may be coded with, by the name of the code; none in files of earlier versions.
        expected_m: [C, A] what a robot that adapts expects to observe, by how it adapts, see
            `control.adaptation.fit_expected`; none in files of earlier versions.
    """

    arch: Architecture
    actions: ActionSet
    contexts: tuple[str, ...]
    params: Params
    reference_x: np.ndarray
    reference_m: np.ndarray
    origin_m: np.ndarray
    edges: np.ndarray
    risk_m: np.ndarray
    predicted_m: np.ndarray
    context_share: np.ndarray
    route_x: np.ndarray
    route_m: np.ndarray
    route_yaw_rad: np.ndarray
    route_context: np.ndarray
    route_number: np.ndarray
    route_residual_m: np.ndarray
    route_risk_m: np.ndarray
    tables: Mapping[str, CodeTable] = field(default_factory=dict)
    expected_m: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def coders(self) -> dict[str, Coder]:
        """Coders of all codes that robots and edge may use, floats among them."""
        return {"float32": Coder("float32")} | {name: Coder(name, table) for name, table in self.tables.items()}

    @property
    def fingerprint(self) -> bytes:
        """16 bytes that name the network and the references."""
        text = sha256(_about(self).encode())
        for name, leaf in sorted(_flat(self.params).items()):
            text.update(name.encode() + np.ascontiguousarray(leaf, "<f4").tobytes())
        for name in ("reference_x", "reference_m", "origin_m"):
            text.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        for name, part in _tables_flat(self.tables).items():
            text.update(name.encode() + np.ascontiguousarray(part).tobytes())
        return text.digest()[:FINGERPRINT_BYTES]


_OTHERS = ("arch", "actions", "contexts", "params", "tables", "expected_m")
_ARRAYS = tuple(f.name for f in fields(EdgeFile) if f.name not in _OTHERS)
_EXPECTED = {adapt: f"expected.{adapt}" for adapt in ADAPT[1:]}
_DTYPES = {"origin_m": np.float64, "route_context": np.int32, "route_number": np.int32}


def save_edge(path: StrPath, edge: EdgeFile) -> None:
    """Write an edge file, whole or not at all.

    Args:
        path: the file to write or replace; its folder must exist.
        edge: what to write.

    Raises:
        InputError: the file cannot be written.
    """
    arrays = {"format": np.array(FORMAT), "about": np.array(_about(edge))}
    arrays |= {name: np.asarray(getattr(edge, name)) for name in _ARRAYS} | _tables_flat(edge.tables)
    arrays |= {_EXPECTED[adapt]: np.asarray(table) for adapt, table in edge.expected_m.items()}
    write_npz(path, arrays | {_PARAMS + name: np.asarray(leaf) for name, leaf in _flat(edge.params).items()})


def load_edge(path: StrPath) -> EdgeFile:
    """Read an edge file that nobody vouches for.

    Args:
        path: the file.

    Returns:
        Its content, with every shape checked.

    Raises:
        InputError: it is missing, damaged, of another version, or its parts do not fit together.
    """
    head = read_npz(path, ("format",))
    if (told := str(head["format"])) != FORMAT:
        raise refusal(path, f"format {told!r} is not {FORMAT!r}; make the file anew: ovibjax edge export")
    try:
        about = json.loads(str(read_npz(path, ("about",))["about"]))
        arch, actions, contexts = _understood(about)
        codes = _codes_of(about)
        empty = jax.eval_shape(lambda: init(jax.random.key(0), arch))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise unreadable(path, "array 'about' is damaged; make the file anew: ovibjax edge export", error) from error
    leaves = _flat(empty)
    names = {name: _PARAMS + name for name in leaves}
    of_tables = [_TABLE.format(code, part) for code in codes for part in _TABLE_PARTS]
    arrays = read_npz(path, ("format", "about", *_ARRAYS, *names.values(), *of_tables), tuple(_EXPECTED.values()))
    found = {name: arrays[key] for name, key in names.items()}
    for name, leaf in leaves.items():
        _check(path, names[name], found[name], leaf.shape)
    params = jax.tree_util.tree_map_with_path(lambda at, _: found[_name(at)].astype(np.float32), empty)
    _check_shapes(path, arrays, arch, actions, len(contexts))
    parts = {name: arrays[name].astype(_DTYPES.get(name, np.float32)) for name in _ARRAYS}
    tables = _tables_of(path, arrays, codes, arch.latent)
    expected_m = {adapt: arrays[key].astype(np.float32) for adapt, key in _EXPECTED.items() if key in arrays}
    return EdgeFile(arch, actions, contexts, params, **parts, tables=tables, expected_m=expected_m)


def _about(edge: EdgeFile) -> str:
    """What is not an array, as text."""
    actions = {"modes": edge.actions.modes, "prefixes": edge.actions.prefixes}
    codes = {"codes": sorted(edge.tables)} if edge.tables else {}
    return json.dumps({"arch": asdict(edge.arch), **actions, "contexts": edge.contexts, **codes}, sort_keys=True)


def _codes_of(about: Any) -> tuple[str, ...]:
    """Codes that a file has tables for."""
    codes = tuple(about.get("codes", ()))
    if not set(codes) <= set(CODES[1:]):
        raise ValueError("codes that there are not")
    return codes


def _tables_flat(tables: Mapping[str, CodeTable]) -> dict[str, np.ndarray]:
    """Arrays of code tables by name: `code.int8.step`."""
    parts = ((code, (*table.grid, table.cumulative)) for code, table in sorted(tables.items()))
    return {
        _TABLE.format(code, name): np.asarray(part)
        for code, arrays in parts
        for name, part in zip(_TABLE_PARTS, arrays, strict=True)
    }


def _tables_of(
    path: StrPath, arrays: dict[str, np.ndarray], codes: tuple[str, ...], latent: int
) -> dict[str, CodeTable]:
    """Tables of a file, each as a coder takes it."""
    tables = {}
    for code in codes:
        parts = [arrays[_TABLE.format(code, name)] for name in _TABLE_PARTS]
        if any(part.dtype.kind not in kinds for part, kinds in zip(parts, ("f", "iu", "iu", "iu"), strict=True)):
            raise refusal(path, f"the table of code {code} holds numbers of the wrong kind")
        step, *whole = parts
        first, last, cumulative = (part.astype(np.int32) for part in whole)
        table = CodeTable(Grid(step.astype(np.float32), first, last), cumulative)
        try:
            Coder(code, table)
        except ValueError as error:
            raise refusal(path, f"the table of code {code} is damaged: {error}") from error
        if len(step) != latent:
            raise refusal(path, f"the table of code {code} has {len(step)} coordinates, not {latent}")
        tables[code] = table
    return tables


def _understood(about: Any) -> tuple[Architecture, ActionSet, tuple[str, ...]]:
    """The text of `_about`; raises whatever it runs into."""
    arch = Architecture(**about["arch"])
    widths = (arch.n_views, arch.view_dim, arch.latent, arch.hidden, arch.last_hidden, arch.head, arch.rank)
    prefixes = tuple(about["prefixes"])
    if not all(type(width) is int and 0 < width < _AT_MOST for width in (*widths, *prefixes)):
        raise ValueError("a width is not a positive whole number")
    modes, contexts = tuple(about["modes"]), tuple(map(str, about["contexts"]))
    if not modes or not prefixes or len(set(modes)) < len(modes) or max(prefixes) > arch.latent or not contexts:
        raise ValueError("modes, prefixes or contexts that no edge has")
    if not all(max(MODES[mode]) < arch.n_views for mode in modes):
        raise ValueError("a mode of more views than there are")
    return arch, ActionSet(modes, prefixes), contexts


def _check_shapes(path: StrPath, arrays: dict[str, np.ndarray], arch: Architecture, actions: ActionSet, c: int) -> None:
    """Refuse arrays that do not fit one another, or hold what no index or number may be."""
    count, shape = len(actions), {name: arrays[name].shape for name in _ARRAYS}
    refs, frames, levels = shape["reference_m"][:1], shape["route_m"][:1], shape["risk_m"][-1:] or (0,)
    expected = {
        "reference_x": (*refs, arch.n_views, arch.view_dim),
        "reference_m": (*refs, 3),
        "origin_m": (3,),
        "edges": (count, levels[0] - 1),
        "risk_m": (count, *levels),
        "predicted_m": (c, count),
        "context_share": (c,),
        "route_x": (*frames, arch.n_views, arch.view_dim),
        "route_m": (*frames, 3),
        "route_yaw_rad": frames,
        "route_context": frames,
        "route_number": frames,
        "route_residual_m": (*frames, count, 2),
        "route_risk_m": (*frames, count),
    }
    for name in _ARRAYS:
        _check(path, name, arrays[name], expected[name])
    for key in _EXPECTED.values():
        if key in arrays:
            _check(path, key, arrays[key], (c, count))
    if not 0 < refs[0] < _MOST_REFERENCES or not frames[0]:
        raise refusal(path, "it has no reference, too many, or no frame of a route")
    context, number = arrays["route_context"], arrays["route_number"]
    if context.min() < 0 or context.max() >= c or number[0] != 0 or not np.isin(np.diff(number), (0, 1)).all():
        raise refusal(path, "route_context or route_number holds numbers that it cannot")


def _check(path: StrPath, name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise refusal(path, f"array {name!r} has shape {array.shape} and dtype {array.dtype}, not numbers {shape}")
    if not np.isfinite(array).all():
        raise refusal(path, f"array {name!r} has values that are not finite")


def _name(at: tuple[Any, ...]) -> str:
    return ".".join(str(part.key) for part in at[1:])


def _flat(params: Params) -> dict[str, Any]:
    """Leaves of the parameters by name: `decoder_1.kernel`."""
    return {_name(at): leaf for at, leaf in jax.tree_util.tree_leaves_with_path(params)}
