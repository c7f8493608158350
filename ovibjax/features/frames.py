"""A feature set: a unit-norm feature vector per view of each frame, with poses and labels, and the checks it passes."""

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ovibjax.errors import doubt, refusal
from ovibjax.features.places import MAX_MAGNITUDE_M, coarse_m
from ovibjax.views import VIEWS, modes_for

CONTEXTS: tuple[str, ...] = ("corridor", "intersection", "repetitive")
"""Scene contexts in label order (paper, Section "VOI-Guided Request and Mode Selection")."""
MAX_ID_CHARS = 255
"""Longest frame name."""
OnFrames = Callable[[int, int], None]
"""Called with the frames done so far and the frames in all."""

_KIND_NAMES = {"iuf": "real numbers", "iu": "integers", "U": "text", "iuU": "text or integers"}
_NORM_TOLERANCE = 1e-6  # float32 rounding of a unit vector stays within 1e-7
_BLOCK_FRAMES = 1024  # bounds the float64 copies made while normalising


class FeatureSet(NamedTuple):
    """View features of N frames with poses and labels, as NumPy arrays.

    Text is no JAX type: hand JAX the fields it needs, not the whole set.
    """

    features: NDArray[np.float32]  # [N, M, d], unit norm per view, in the order of views.VIEWS
    positions_m: NDArray[np.float64]  # [N, 3], as the data have them; `places` makes them fit for float32
    yaw_rad: NDArray[np.float32]  # [N]
    context: NDArray[np.int32]  # [N], index into CONTEXTS, -1 where unknown
    scene_id: NDArray[np.int32]  # [N], at least 0
    frame_id: NDArray[np.str_]  # [N], frame names


def _field(source: str, name: str, value: ArrayLike, kinds: str, shape: tuple[int | str, ...]) -> NDArray[Any]:
    """A field as an array of the wanted kind and shape; a letter in `shape` stands for any length."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise refusal(source, f"{name} is not a rectangular array") from error
    if array.dtype.kind not in kinds:
        raise refusal(source, f"{name} has dtype {array.dtype}, expected {_KIND_NAMES[kinds]}")
    if array.ndim != len(shape) or any(
        isinstance(want, int) and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        wanted, have = (", ".join(map(str, lengths)) for lengths in (shape, array.shape))
        raise refusal(source, f"{name} has shape [{have}], expected [{wanted}]")
    return array


def _unit_norm(source: str, features: NDArray[Any], frame_id: NDArray[np.str_]) -> NDArray[np.float32]:
    """Features scaled to unit norm per view; those that already have it keep their bits."""
    out = np.empty(features.shape, np.float32)
    for start in range(0, len(features), _BLOCK_FRAMES):
        block = features[start : start + _BLOCK_FRAMES].astype(np.float64)
        peak = np.abs(block).max(axis=-1, keepdims=True)
        for bad, reason in (
            (~np.isfinite(peak), "feature has values that are not finite (NaN or infinity)"),
            (peak == 0, "feature has zero norm"),
        ):
            if bad.any():
                row, view, _ = np.argwhere(bad)[0]
                raise refusal(source, f"frame {frame_id[start + row]!s}, view {VIEWS[view]}: {reason}")
        # Dividing by the peak first keeps the squares of very small and very large values in range.
        scaled = block / peak
        single = block.astype(np.float32)
        norm = np.linalg.norm(single.astype(np.float64), axis=-1, keepdims=True)
        scaled /= np.linalg.norm(scaled, axis=-1, keepdims=True)
        out[start : start + _BLOCK_FRAMES] = np.where(np.abs(norm - 1) <= _NORM_TOLERANCE, single, scaled)
    return out


def validate(feature_set: FeatureSet, source: str = "array") -> FeatureSet:
    """Check every field and bring it to its dtype, features to unit norm.

    The norm is that of the paper, Section "Task-Oriented Feature Extraction".

    Args:
        feature_set: fields of any real, integer or text dtype.
        source: what to call the data in messages, usually a file name.

    Returns:
        The same set in the dtypes of `FeatureSet`. A set that has been validated comes back unchanged.

    Raises:
        InputError: a wrong dtype or shape, no frames, not 4 or 5 views, values that are not finite, a zero
            feature, a label out of range, or a frame name that is not printable text.

    Warns:
        Doubt: positions in a type that steps by more than a millimetre where they lie.
    """
    features = _field(source, "features", feature_set.features, "iuf", ("N", "M", "d"))
    n, n_views, dim = features.shape
    if n == 0:
        raise refusal(source, "no frames: features has shape [0, M, d]")
    try:
        modes_for(n_views)
    except ValueError as error:
        raise refusal(source, f"features has {n_views} views: {error}") from error
    if dim < 2:
        raise refusal(source, f"features has dimension {dim}, expected at least 2")
    frame_id = np.array(_field(source, "frame_id", feature_set.frame_id, "U", (n,)).tolist())
    for row, name in enumerate(frame_id.tolist()):
        if not name or not name.isprintable() or len(name) > MAX_ID_CHARS:
            raise refusal(source, f"frame_id of frame {row} is empty, too long or not printable text")
    # Values beyond float32 become infinite in the cast and are refused as such.
    with np.errstate(all="ignore"):
        given_m = _field(source, "positions_m", feature_set.positions_m, "iuf", (n, 3))
        positions_m = given_m.astype(np.float64)
        yaw_rad = _field(source, "yaw_rad", feature_set.yaw_rad, "iuf", (n,)).astype(np.float32)
        unit = _unit_norm(source, features, frame_id)
    context = _field(source, "context", feature_set.context, "iu", (n,))
    scene_id = _field(source, "scene_id", feature_set.scene_id, "iu", (n,))
    checks = (
        (~np.isfinite(positions_m).all(axis=1), "positions_m is not finite (NaN or infinity)"),
        (
            (np.abs(positions_m) > MAX_MAGNITUDE_M).any(axis=1),
            f"positions_m is beyond {MAX_MAGNITUDE_M:g} m",
        ),
        (~np.isfinite(yaw_rad), "yaw_rad is not finite (NaN or infinity)"),
        ((context < -1) | (context >= len(CONTEXTS)), f"context is out of range -1 to {len(CONTEXTS) - 1}"),
        ((scene_id < 0) | (scene_id > np.iinfo(np.int32).max), "scene_id is out of range 0 to 2**31 - 1"),
    )
    for bad, reason in checks:
        if bad.any():
            raise refusal(source, f"frame {frame_id[np.argmax(bad)]!s}: {reason}")
    if step_m := coarse_m(given_m):
        far_m, kind = np.abs(positions_m).max(), given_m.dtype
        doubt(source, f"positions_m is {kind}, which steps by {step_m:.2g} m at {far_m:.0f} m; save it as float64")
    return FeatureSet(unit, positions_m, yaw_rad, context.astype(np.int32), scene_id.astype(np.int32), frame_id)


def make_feature_set(
    features: ArrayLike,
    positions_m: ArrayLike,
    yaw_rad: ArrayLike | None = None,
    context: ArrayLike | None = None,
    scene_id: ArrayLike | None = None,
    frame_id: ArrayLike | None = None,
    source: str = "array",
) -> FeatureSet:
    """A checked feature set from arrays, with defaults for what is not known.

    Args:
        features: [N, M, d] real, of any norm but zero; M is 5 (UAV) or 4 (UGV).
        positions_m: [N, 3], metres.
        yaw_rad: [N], radians; 0 by default.
        context: [N], index into `CONTEXTS`; -1 (unknown) by default.
        scene_id: [N], integers from 0; 0 by default.
        frame_id: [N], text or integers; "000000", "000001", ... by default.
        source: what to call the data in messages.

    Returns:
        The set, features at unit norm per view (paper, Section "Task-Oriented Feature Extraction").

    Raises:
        InputError: as for `validate`.
    """
    n = len(_field(source, "features", features, "iuf", ("N", "M", "d")))
    names = _field(source, "frame_id", np.arange(n) if frame_id is None else frame_id, "iuU", ("N",))
    if names.dtype.kind in "iu":
        names = np.array([f"{number:06d}" for number in names.tolist()], dtype=np.str_)
    fields: tuple[Any, ...] = (  # not yet in the dtypes that FeatureSet promises
        features,
        positions_m,
        np.zeros(n) if yaw_rad is None else yaw_rad,
        np.full(n, -1) if context is None else context,
        np.zeros(n, np.int32) if scene_id is None else scene_id,
        names,
    )
    return validate(FeatureSet(*fields), source)


def content_hash(feature_set: FeatureSet) -> str:
    """SHA-256 of names, dtypes, shapes and values of all fields: the key under which derived data is cached.

    Returns:
        64 hexadecimal digits, the same on every run and machine.
    """
    digest = hashlib.sha256()
    for name, array in feature_set._asdict().items():
        # The storage width of text depends on how the array was cut, not on what it says.
        array = np.array(array.tolist()) if array.dtype.kind == "U" else array
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
