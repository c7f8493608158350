"""Results of a sweep on disk, one region per finished chunk, resumable after a kill at any moment.

A store is a directory in Zarr format 3, by convention named *.zarr. Its arrays lead with dimension `member`: position
chunk * size + offset of the chunks, so that one chunk of the sweep is one file of every output. Files are replaced
atomically and carry a checksum; `finished` is set last and commits a chunk.

`open_dataset` gives the grid back. `xarray.open_zarr(path, consolidated=False)` (without the option it warns, as
Zarr 3 has no consolidated metadata) reads the same arrays as a flat table with the axes as coordinates, names as
their index into the attribute `names`; rows with `grid_index` -1 are padding, rows of unfinished chunks are not valid.
"""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
import xarray
import zarr

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.disk import take_lock, writing
from ovibjax.sweep.schema import Schema, assemble, check, description, differences
from ovibjax.sweep.store_format import create, open_arrays


class Store:
    """An open store; several threads may write different chunks.

    Attributes:
        path: the directory.
        schema: what it holds.
        config: what the sweep was started with, as JSON gives it back.
    """

    def __init__(self, path: Path, schema: Schema, config: dict[str, Any], arrays: dict[str, zarr.Array]):
        self.path, self.schema, self.config = path, schema, config
        self._arrays = arrays
        self._lock: IO[str] | None = None

    @classmethod
    def open(cls, path: str | Path, schema: Schema, config: dict[str, Any], lock: bool = True) -> "Store":
        """Create a store, or resume it if it is there and holds the same sweep.

        Args:
            path: the directory; parents are made.
            schema: what it holds.
            config: what identifies the sweep, made of JSON's types.
            lock: keep other processes out; False where the caller knows that there are none.

        Returns:
            The open store.

        Raises:
            InputError: names in the schema clash, the path holds something else or another sweep, another process
                works on it, or it cannot be written.
        """
        path = Path(path)
        check(schema)
        config = json.loads(json.dumps(config))
        # Links are followed: two names of one store are one lock.
        real = Path(os.path.realpath(path))
        if real.exists():
            open_arrays(path)  # so that no lock file is left beside something that is no store
        with writing(path, len(schema.chunks.members)):
            real.parent.mkdir(parents=True, exist_ok=True)
            handle = take_lock(path, real) if lock else None
            try:
                if not real.exists():
                    create(real, schema, config)
                store = attach(path)
                _refuse_other(store, schema, config)
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
        done = np.zeros(len(self.schema.chunks.members), bool)
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
            ValueError: names, shapes, types or the chunk do not fit the schema.
        """
        count, rows, columns = self.schema.chunks.members.shape
        if arrays.keys() != self.schema.variables.keys() or not 0 <= chunk < count:
            raise ValueError(f"chunk {chunk} of {count} with {sorted(arrays)}, not {sorted(self.schema.variables)}")
        blocks = {}
        for name, given in {**arrays, "diverged": diverged}.items():
            block, array = np.asarray(given), self._arrays[name]
            shapes = ((rows, columns, *array.shape[1:]), (rows * columns, *array.shape[1:]))
            if block.shape not in shapes or block.dtype != array.dtype:
                raise ValueError(f"{name} is {block.dtype} {block.shape}, not {array.dtype} {shapes[0]}")
            blocks[name] = block.reshape(array.chunks)
        with writing(self.path, count):
            for name, block in blocks.items():
                self._arrays[name][chunk * rows * columns : (chunk + 1) * rows * columns] = block
            self._arrays["finished"][chunk] = True

    def dataset(self) -> xarray.Dataset:
        """Read all finished members.

        Returns:
            See `schema.assemble`.

        Raises:
            InputError: a file is damaged.
        """
        done = np.flatnonzero(self.finished()).tolist()
        return assemble(self.schema, done, lambda name: self._read(name, done), self.config)

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
                    f"{self.path}: chunk {chunk} of {name} is damaged ({one_line(error)}); "
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
    return Store(Path(path), *open_arrays(Path(path)))


def open_dataset(path: str | Path) -> xarray.Dataset:
    """Read all finished members; the sweep may still be running.

    Args:
        path: the directory.

    Returns:
        See `schema.assemble`.

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


def _refuse_other(store: Store, schema: Schema, config: dict[str, Any]) -> None:
    found = list(differences(store.config, config)) or list(differences(description(store.schema), description(schema)))
    if found:
        raise InputError(
            f"{store.path} holds another sweep: {'; '.join(found[:3])}; "
            "choose another --out or repeat the first command"
        )
