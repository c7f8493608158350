"""States of members between two rungs: files that can be made again, kept only as long as they may be needed."""

import hashlib
import shutil
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

import jax
import numpy as np

from ovibjax.sweep.blocks import count_members
from ovibjax.sweep.disk import of_this_process, writing

_DIGEST_BYTES = 16
FOLDER = "states"
"""Where they are, in the folder of a store."""


class States:
    """States by the steps they have behind them and the member; several threads may keep them.

    A file is the bytes of its arrays and a digest of them: what a crash left half written counts as not there.
    """

    def __init__(self, store: Path | None, leaves: Sequence[jax.ShapeDtypeStruct]) -> None:
        """Keep states of these arrays in the folder of a store; in memory if None."""
        self._store, self._leaves = store, leaves
        self._memory: dict[tuple[int, str], list[np.ndarray]] = {}

    def keep(self, steps: int, member: str, arrays: Sequence[np.ndarray]) -> None:
        """Keep a state.

        Args:
            steps: steps behind it.
            member: name of the member.
            arrays: its leaves.

        Raises:
            InputError: the disk refuses.
        """
        if self._store is None:
            self._memory[steps, member] = [np.array(array) for array in arrays]
            return
        content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
        file = self._file(steps, member)
        with writing(self._store, partial(count_members, self._store / "members")):
            file.parent.mkdir(parents=True, exist_ok=True)
            aside = file.with_name(f"{file.name}.{of_this_process()}.partial")
            try:
                aside.write_bytes(_digest(content) + content)
                aside.replace(file)
            finally:
                aside.unlink(missing_ok=True)

    def find(self, steps: int, member: str) -> list[np.ndarray] | None:
        """The leaves of a state; None if it is not there, or not whole."""
        if self._store is None:
            return self._memory.get((steps, member))
        try:
            content = self._file(steps, member).read_bytes()
        except OSError:
            return None
        sizes = [int(np.prod(leaf.shape)) * leaf.dtype.itemsize for leaf in self._leaves]
        if len(content) != _DIGEST_BYTES + sum(sizes) or _digest(content[_DIGEST_BYTES:]) != content[:_DIGEST_BYTES]:
            return None
        arrays, at = [], _DIGEST_BYTES
        for leaf, size in zip(self._leaves, sizes, strict=True):
            arrays.append(np.frombuffer(content[at : at + size], leaf.dtype).reshape(leaf.shape))
            at += size
        return arrays

    def leave(self, steps: int, members: Collection[str] = ()) -> None:
        """Remove all states with so many steps behind them but those of some members."""
        for key in [key for key in self._memory if key[0] == steps and key[1] not in members]:
            del self._memory[key]
        if self._store is not None:
            for file in (self._store / FOLDER / str(steps)).glob("*"):
                if file.name not in members:
                    file.unlink(missing_ok=True)

    def any(self) -> bool:
        """Whether there may be some."""
        return bool(self._memory) or (self._store is not None and (self._store / FOLDER).exists())

    def remove(self) -> None:
        """Remove all of them."""
        self._memory.clear()
        if self._store is not None:
            shutil.rmtree(self._store / FOLDER, ignore_errors=True)

    def _file(self, steps: int, member: str) -> Path:
        assert self._store is not None
        return self._store / FOLDER / str(steps) / member


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()
