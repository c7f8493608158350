"""Results of a sweep on disk, one region per finished chunk, resumable after a kill at any moment.

A store is a directory in Zarr format 3, by convention named *.zarr. Its arrays lead with dimension `member`: position
chunk * size + offset of the chunks, so that one chunk of the sweep is one file of every output. Files are replaced
atomically and carry a checksum; `finished` is set last and commits a chunk.

`open_dataset` gives the grid back. `xarray.open_zarr(path, consolidated=False)` (without the option it warns, as
Zarr 3 has no consolidated metadata) reads the same arrays as a flat table with the axes as coordinates, names as
their index into the attribute `names`; rows with `grid_index` -1 are padding, rows of unfinished chunks are not valid.
"""

import errno
import fcntl
import json
import os
import re
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
import xarray
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from ovibjax.errors import InputError
from ovibjax.sweep.grid import PADDING
from ovibjax.sweep.layout import (
    Layout,
    assemble,
    attributes_of,
    check,
    describe,
    differences,
    digest,
    fill_value,
    restore,
)

FORMAT = 1
"""Version of the layout on disk."""


@dataclass(frozen=True)
class _Array:
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype
    dims: tuple[str, ...]
    attributes: dict[str, Any]
    data: np.ndarray | None = None


class Store:
    """An open store; several threads may write different chunks.

    Attributes:
        path: the directory.
        layout: what it holds.
        config: what the sweep was started with, as JSON gives it back.
    """

    def __init__(self, path: Path, layout: Layout, config: dict[str, Any], arrays: dict[str, zarr.Array]):
        self.path, self.layout, self.config = path, layout, config
        self._arrays = arrays
        self._lock: IO[str] | None = None

    @classmethod
    def open(cls, path: str | Path, layout: Layout, config: dict[str, Any], lock: bool = True) -> "Store":
        """Create a store, or resume it if it is there and holds the same sweep.

        Args:
            path: the directory; parents are made.
            layout: what it holds.
            config: what identifies the sweep, made of JSON's types.
            lock: keep other processes out; False where the caller knows that there are none.

        Returns:
            The open store.

        Raises:
            InputError: names in the layout clash, the path holds something else or another sweep, another process
                works on it, or it cannot be written.
        """
        path = Path(path)
        check(layout)
        config = json.loads(json.dumps(config))
        # Links are followed: two names of one store are one lock.
        real = Path(os.path.realpath(path))
        if real.exists():
            _open(path)  # so that no lock file is left beside something that is no store
        with _writing(path, len(layout.chunks.members)):
            real.parent.mkdir(parents=True, exist_ok=True)
            handle = _take_lock(path, real) if lock else None
            try:
                if not real.exists():
                    _create(real, layout, config)
                store = _open(path)
                _refuse_other(store, layout, config)
                for partial in real.glob("*/*.partial"):  # what a killed process was writing
                    partial.unlink(missing_ok=True)
            except BaseException:
                if handle is not None:
                    handle.close()
                raise
        store._lock = handle
        return store

    def finished(self) -> np.ndarray:
        """Say which chunks are complete.

        Returns:
            [chunks] bool.

        Raises:
            InputError: a marker is damaged.
        """
        done = np.zeros(len(self.layout.chunks.members), bool)
        written = [chunk for chunk in range(len(done)) if self._file("finished", chunk).is_file()]
        done[written] = self._read("finished", written)[:, 0]
        return done

    def write(self, chunk: int, arrays: dict[str, np.ndarray], diverged: np.ndarray) -> None:
        """Write one chunk and mark it finished.

        Args:
            chunk: its position among the chunks.
            arrays: every variable, [rows, columns, ...] or [rows * columns, ...], padding included.
            diverged: [rows, columns] or [rows * columns] bool.

        Raises:
            InputError: the disk refuses; the chunk is then not finished.
            ValueError: names, shapes, types or the chunk do not fit the layout.
        """
        count, rows, columns = self.layout.chunks.members.shape
        if arrays.keys() != self.layout.variables.keys() or not 0 <= chunk < count:
            raise ValueError(f"chunk {chunk} of {count} with {sorted(arrays)}, not {sorted(self.layout.variables)}")
        blocks = {}
        for name, given in {**arrays, "diverged": diverged}.items():
            block, array = np.asarray(given), self._arrays[name]
            shapes = ((rows, columns, *array.shape[1:]), (rows * columns, *array.shape[1:]))
            if block.shape not in shapes or block.dtype != array.dtype:
                raise ValueError(f"{name} is {block.dtype} {block.shape}, not {array.dtype} {shapes[0]}")
            blocks[name] = block.reshape(array.chunks)
        with _writing(self.path, count):
            for name, block in blocks.items():
                self._arrays[name][chunk * rows * columns : (chunk + 1) * rows * columns] = block
            self._arrays["finished"][chunk] = True

    def dataset(self) -> xarray.Dataset:
        """Read all finished members.

        Returns:
            See `layout.assemble`.

        Raises:
            InputError: a file is damaged.
        """
        done = np.flatnonzero(self.finished()).tolist()
        return assemble(self.layout, done, lambda name: self._read(name, done), self.config)

    def close(self) -> None:
        """Let other processes in."""
        if self._lock is not None:
            self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _file(self, name: str, chunk: int) -> Path:
        metadata = self._arrays[name].metadata
        return self.path / name / metadata.encode_chunk_key((chunk, *[0] * (len(metadata.shape) - 1)))

    def _read(self, name: str, chunks: list[int]) -> np.ndarray:
        """[len(chunks), ...] some chunks of an array, which must be there."""
        array: Any = self._arrays[name]
        size = array.chunks[0]
        with suppress(Exception):  # all at once is faster; one by one tells which is damaged
            if all(self._file(name, chunk).is_file() for chunk in chunks):
                return array[:].reshape(-1, *array.chunks)[chunks]
        data = np.empty((len(chunks), *array.chunks), array.dtype)
        for i, chunk in enumerate(chunks):
            try:
                if not self._file(name, chunk).is_file():  # zarr would give fill values
                    raise FileNotFoundError("its file is missing")
                data[i] = array[chunk * size : (chunk + 1) * size]
            except Exception as error:  # decoders raise what they like
                raise InputError(
                    f"{self.path}: chunk {chunk} of {name} is damaged ({_line(error)}); "
                    f"remove {self._file('finished', chunk)} and repeat the command to compute it again"
                ) from error
        return data


def attach(path: str | Path) -> Store:
    """Open a store that another process has created and holds the lock of, to read or to write chunks.

    Args:
        path: the directory.

    Returns:
        The open store.

    Raises:
        InputError: there is no store, or a damaged one.
    """
    return _open(Path(path))


def open_dataset(path: str | Path) -> xarray.Dataset:
    """Read all finished members; the sweep may still be running.

    Args:
        path: the directory.

    Returns:
        See `layout.assemble`.

    Raises:
        InputError: there is no store, or it is damaged.
    """
    return attach(path).dataset()


def config_of(path: str | Path) -> dict[str, Any] | None:
    """Configuration of the store at a path; None if nothing is there.

    Args:
        path: the directory.

    Returns:
        What the sweep was started with.

    Raises:
        InputError: something else is there, or a damaged store.
    """
    return attach(path).config if Path(os.path.realpath(path)).exists() else None


def _arrays(layout: Layout) -> dict[str, _Array]:
    """All arrays of a store; those with data are written at creation, in one piece."""
    count, rows, columns = layout.chunks.members.shape
    size = rows * columns
    members = layout.chunks.members.reshape(-1).astype(np.int64)
    real = members != PADDING

    def fixed(data: np.ndarray, dim: str, attributes: dict[str, Any]) -> _Array:
        return _Array(data.shape, data.shape, data.dtype, (dim,), attributes, data)

    def per_member(shape: tuple[int, ...], dtype: np.dtype, dims: tuple[str, ...], unit: str = "") -> _Array:
        return _Array((count * size, *shape), (size, *shape), dtype, ("member", *dims), attributes_of(unit))

    arrays = {"grid_index": fixed(members, "member", {})}
    for name, axis in layout.grid.axes.items():
        codes = layout.grid.points(np.where(real, members, 0), [name])[name]
        arrays[name] = fixed(np.where(real, codes, fill_value(codes.dtype)), "member", attributes_of(axis.unit, axis))
    for dim, axis in layout.coords.items():
        values = np.asarray(np.asarray(axis.values).tolist())  # float64, as the description has it
        codes = np.arange(len(values), dtype=np.int32) if values.dtype.kind == "U" else values
        arrays[dim] = fixed(codes, dim, attributes_of(axis.unit, axis))
    for name, v in layout.variables.items():
        arrays[name] = per_member(v.shape, np.dtype(v.dtype), v.dims, v.unit)
    arrays["diverged"] = per_member((), np.dtype(bool), ())
    arrays["finished"] = _Array((count,), (1,), np.dtype(bool), ("chunk",), {})
    return arrays


def _create(real: Path, layout: Layout, config: dict[str, Any]) -> None:
    """Build a store aside and move it into place."""
    for stale in real.parent.iterdir():
        if re.fullmatch(re.escape(real.name) + r"\.tmp-\d+", stale.name):  # of killed processes, as the lock is ours
            shutil.rmtree(stale, ignore_errors=True)
    temporary = real.with_name(f"{real.name}.tmp-{os.getpid()}")
    attributes = {"format": FORMAT, "hash": digest(config), "config": config, "layout": describe(layout)}
    # xarray takes the names under this attribute as coordinates.
    attributes["coordinates"] = " ".join(["grid_index", *layout.grid.axes])
    try:
        group = zarr.create_group(temporary, zarr_format=3, attributes=attributes)
        for name, spec in _arrays(layout).items():
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


def _open(path: Path) -> Store:
    """Open an existing store and check it against its own description."""
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
        layout = restore(attributes["layout"], index[:])
        arrays: dict[str, zarr.Array] = {}
        for name, spec in _arrays(layout).items():
            array: Any = group[name]
            fits = (array.shape, array.chunks, array.dtype) == (spec.shape, spec.chunks, spec.dtype)
            if not fits or not (spec.data is None or np.array_equal(array[:], spec.data, spec.dtype.kind == "f")):
                raise ValueError(f"array {name} does not fit the layout")
            # A chunk full of fill values is written too, so that a missing file is always a damage.
            arrays[name] = array.with_config({"write_empty_chunks": True})
    except InputError:
        raise
    except Exception as error:  # foreign or damaged metadata fail anywhere in the parsers
        raise InputError(f"{path} is no store of a sweep, or damaged ({_line(error)}); choose another path") from error
    return Store(path, layout, attributes["config"], arrays)


def _refuse_other(store: Store, layout: Layout, config: dict[str, Any]) -> None:
    found = list(differences(store.config, config)) or list(differences(describe(store.layout), describe(layout)))
    if found:
        raise InputError(
            f"{store.path} holds another sweep: {'; '.join(found[:3])}; "
            "choose another --out or repeat the first command"
        )


def _take_lock(path: Path, real: Path) -> IO[str]:
    """Take the lock of a store, which ends with the process.

    The file lies beside the store, as it guards its creation too. It is never removed: another process may have
    opened it meanwhile and would lock a file that a third one no longer finds.
    """
    handle = real.with_name(f".{real.name}.lock").open("a+")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on host {socket.gethostname()}")
        handle.flush()
    except BlockingIOError:
        handle.seek(0)
        holder = handle.read() or "another process"
        handle.close()
        raise InputError(
            f"{path}: {holder} is already working on this sweep; wait for it, or choose another --out"
        ) from None
    except BaseException:
        handle.close()
        raise
    return handle


@contextmanager
def _writing(path: Path, count: int) -> Iterator[None]:
    """Turn what the disk refuses into a message that says what is safe."""
    try:
        yield
    except OSError as error:
        kept = len(list((path / "finished").glob("c.*[0-9]")))
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        reason = error.strerror or _line(error)
        if error.errno in (errno.EEXIST, errno.ENOTDIR):
            reason = f"{error.filename} is no folder"
        raise InputError(
            f"{path}: cannot write ({reason}); {kept} of {count} chunks are kept; "
            f"{'make room' if full else 'mend that'} and repeat the command"
        ) from error


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
