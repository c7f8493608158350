"""A store on disk: which Zarr arrays hold a sweep, how they are made, and whether those found are what they say."""

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.grid import PADDING
from ovibjax.sweep.schema import Schema, attributes_of, description, digest, fill_value, schema_of

FORMAT = 1
"""Version of the layout on disk."""


@dataclass(frozen=True)
class ArraySpec:
    """How one array is stored; with `data`, it is written at creation, in one piece."""

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype
    dims: tuple[str, ...]
    attributes: dict[str, Any]
    data: np.ndarray | None = None


def array_specs(schema: Schema) -> dict[str, ArraySpec]:
    """All arrays of a store; those with data are written at creation, in one piece."""
    count, rows, columns = schema.chunks.members.shape
    size = rows * columns
    members = schema.chunks.members.reshape(-1).astype(np.int64)
    real = members != PADDING

    def fixed(data: np.ndarray, dim: str, attributes: dict[str, Any]) -> ArraySpec:
        return ArraySpec(data.shape, data.shape, data.dtype, (dim,), attributes, data)

    def per_member(shape: tuple[int, ...], dtype: np.dtype, dims: tuple[str, ...], unit: str = "") -> ArraySpec:
        return ArraySpec((count * size, *shape), (size, *shape), dtype, ("member", *dims), attributes_of(unit))

    arrays = {"grid_index": fixed(members, "member", {})}
    for name, axis in schema.grid.axes.items():
        codes = schema.grid.points(np.where(real, members, 0), [name])[name]
        arrays[name] = fixed(np.where(real, codes, fill_value(codes.dtype)), "member", attributes_of(axis.unit, axis))
    for dim, axis in schema.coords.items():
        values = np.asarray(np.asarray(axis.values).tolist())  # float64, as the description has it
        codes = np.arange(len(values), dtype=np.int32) if values.dtype.kind == "U" else values
        arrays[dim] = fixed(codes, dim, attributes_of(axis.unit, axis))
    for name, v in schema.variables.items():
        arrays[name] = per_member(v.shape, np.dtype(v.dtype), v.dims, v.unit)
    arrays["diverged"] = per_member((), np.dtype(bool), ())
    arrays["finished"] = ArraySpec((count,), (1,), np.dtype(bool), ("chunk",), {})
    return arrays


def create(real: Path, schema: Schema, config: dict[str, Any]) -> None:
    """Build a store aside and move it into place."""
    for stale in real.parent.iterdir():
        if re.fullmatch(re.escape(real.name) + r"\.tmp-\d+", stale.name):  # of killed processes, as the lock is ours
            shutil.rmtree(stale, ignore_errors=True)
    temporary = real.with_name(f"{real.name}.tmp-{os.getpid()}")
    attributes = {"format": FORMAT, "hash": digest(config), "config": config, "layout": description(schema)}
    # xarray takes the names under this attribute as coordinates.
    attributes["coordinates"] = " ".join(["grid_index", *schema.grid.axes])
    try:
        group = zarr.create_group(temporary, zarr_format=3, attributes=attributes)
        for name, spec in array_specs(schema).items():
            array = group.create_array(
                name,
                shape=spec.shape,
                chunks=spec.chunks,
                dtype=spec.dtype,
                fill_value=fill_value(spec.dtype),
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                dimension_names=spec.dims,
                attributes=spec.attributes,
                # One folder per array instead of one per chunk and dimension.
                chunk_key_encoding={"name": "default", "separator": "."},
            )
            if spec.data is not None:
                array[:] = spec.data
        temporary.rename(real)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def open_arrays(path: Path) -> tuple[Schema, dict[str, Any], dict[str, zarr.Array]]:
    """Open an existing store and check it against its own description.

    Args:
        path: the directory.

    Returns:
        What it holds, what the sweep was started with, and the arrays by name.

    Raises:
        InputError: there is no store, or a damaged, edited or newer one.
    """
    try:
        group = zarr.open_group(path, mode="r+", zarr_format=3)
        attributes: dict[str, Any] = dict(group.attrs)
        if attributes["format"] != FORMAT:
            raise InputError(
                f"{path} has format {attributes['format']!r} and this version reads {FORMAT}; choose another path"
            )
        if attributes["hash"] != digest(attributes["config"]):
            raise InputError(f"{path} was edited: its hash does not fit its config; restore it or choose another path")
        index: Any = group["grid_index"]
        schema = schema_of(attributes["layout"], index[:])
        arrays: dict[str, zarr.Array] = {}
        for name, spec in array_specs(schema).items():
            array: Any = group[name]
            fits = (array.shape, array.chunks, array.dtype) == (spec.shape, spec.chunks, spec.dtype)
            if not fits or not (spec.data is None or np.array_equal(array[:], spec.data, spec.dtype.kind == "f")):
                raise ValueError(f"array {name} does not fit the layout")
            # A chunk full of fill values is written too, so that a missing file is always a damage.
            arrays[name] = array.with_config({"write_empty_chunks": True})
    except InputError:
        raise
    except Exception as error:  # foreign or damaged metadata fail anywhere in the parsers
        raise InputError(
            f"{path} is no store of a sweep, or damaged ({one_line(error)}); choose another path"
        ) from error
    return schema, attributes["config"], arrays
