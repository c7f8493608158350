"""What an unfinished extraction has on disk: features of finished batches, and an index that says which they are.

A batch counts once its line stands whole in the index; whatever a kill left behind it is cut off. The features are
synchronised before the line that vouches for them, and a checksum tells a torn one.
"""

import json
import os
import shutil
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import InputError, doubt, refusal
from ovibjax.features.images.source import Skipped
from ovibjax.runtime.locks import WITHOUT_LOCKS, Held, take_lock

_CONFIG, _INDEX, _BLOCKS, _LOCK = "config.json", "index.jsonl", "blocks.f32", "lock"


class Journal:
    """Finished batches of one extraction, in order; use it as a context.

    Args:
        folder: made if missing.
        config: everything the features depend on, by the name it has for the user; text and numbers.

    Raises:
        InputError: the folder belongs to another configuration or is something else, another process works on it,
            or it cannot be written.
    """

    def __init__(self, folder: Path, config: Mapping[str, str | int]) -> None:
        self.folder = folder
        self.batches = 0
        self.rows: list[int] = []
        self.failed: list[Skipped] = []
        self._shape: tuple[int, ...] = ()  # of one frame's features
        self._files: list[BinaryIO] = []
        self._lock: IO[str] | None = None
        try:
            self._open(config)
        except OSError as error:
            self.close()
            raise self._refused(error) from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()
        if self.batches == 0 and kind is not None:
            self.remove()  # nothing to go on from

    def append(self, rows: Sequence[int], features: NDArray[np.float32], failed: Sequence[Skipped]) -> None:
        """Keep one more batch.

        Args:
            rows: which frames have features.
            features: [rows, M, d], of equal M and d in all batches.
            failed: frames of the batch that have none.

        Raises:
            InputError: the system refuses the write.
        """
        content = np.ascontiguousarray(features, "<f4").tobytes()
        line: dict[str, Any] = {"batch": self.batches, "rows": list(rows), "shape": list(features.shape[1:])}
        line |= {"failed": [[one.frame_id, one.reason, one.detail] for one in failed], "crc32": zlib.crc32(content)}
        try:
            for file, part in zip(self._files, (content, json.dumps(line).encode() + b"\n"), strict=True):
                file.write(part)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise self._refused(error) from error
        self._count(line)

    def features(self) -> NDArray[np.float32]:
        """Features of all kept frames, [rows, M, d], in the order of `rows`."""
        return np.fromfile(self.folder / _BLOCKS, "<f4").astype(np.float32, copy=False).reshape(-1, *self._shape)

    def close(self) -> None:
        """Close the files and give up the lock."""
        for file in self._files:
            file.close()
        self._files = []
        if self._lock is not None:
            self._lock.close()

    def remove(self) -> None:
        """Remove the folder, its contents being in the final file or worth nothing."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _refused(self, error: OSError) -> InputError:
        return refusal(self.folder, f"cannot be written ({error.strerror or error}); {self.batches} batches are kept")

    def _open(self, config: Mapping[str, str | int]) -> None:
        self.folder.mkdir(exist_ok=True)
        known = {_CONFIG, f".{_CONFIG}.part", _INDEX, _BLOCKS, _LOCK}
        if strange := sorted({entry.name for entry in self.folder.iterdir()} - known):
            raise refusal(self.folder, f"holds {strange[0]}, which is no part of an extraction; choose another --out")
        try:
            self._lock = take_lock(self.folder / _LOCK)
        except Held as error:
            raise refusal(
                self.folder, f"{error.strerror} is working on it; wait for it or choose another --out"
            ) from None
        if self._lock is None:
            doubt(self.folder / _LOCK, f"{WITHOUT_LOCKS}, or choose --out on another disk")
        if (self.folder / _CONFIG).exists():
            self._check(config)
        else:
            part = self.folder / f".{_CONFIG}.part"
            part.write_text(json.dumps(dict(config)))
            part.replace(self.folder / _CONFIG)
        good_index, good_blocks = self._replay()
        for name, length in ((_BLOCKS, good_blocks), (_INDEX, good_index)):
            file = (self.folder / name).open("ab")
            self._files.append(file)
            file.truncate(length)

    def _check(self, config: Mapping[str, str | int]) -> None:
        try:
            found = json.loads((self.folder / _CONFIG).read_bytes())
            differing = [key for key in {**config, **found} if config.get(key) != found.get(key)]
        except (ValueError, TypeError, AttributeError):
            raise refusal(self.folder / _CONFIG, "is damaged; remove its folder to begin anew") from None
        if differing:
            parts = []
            for key in differing[:3]:
                old, new = (str(values.get(key, "none"))[:40] for values in (found, config))
                parts.append(f"{key} was {old}, is {new}")
            raise refusal(
                self.folder,
                f"holds an unfinished extraction with other choices: {'; '.join(parts)}; "
                "repeat its command, remove the folder, or choose another --out",
            )

    def _replay(self) -> tuple[int, int]:
        """Count the batches that are whole; the lengths of index and blocks up to their end."""
        index, blocks = self.folder / _INDEX, self.folder / _BLOCKS
        if not index.exists() or not blocks.exists():
            return 0, 0
        good_index = good_blocks = 0
        with index.open("rb") as lines, blocks.open("rb") as content:
            for line in lines:
                try:
                    entry = json.loads(line)
                    length = 4 * len(entry["rows"]) * int(np.prod(entry["shape"]))
                    whole = line.endswith(b"\n") and entry["batch"] == self.batches
                    whole = whole and zlib.crc32(content.read(length)) == entry["crc32"]
                    if not whole:
                        break
                    self._count(entry)
                except (ValueError, TypeError, KeyError):
                    break
                good_index, good_blocks = good_index + len(line), good_blocks + length
        return good_index, good_blocks

    def _count(self, entry: Mapping[str, Any]) -> None:
        failed = [Skipped(*one) for one in entry["failed"]]
        self.batches, self.rows, self.failed = self.batches + 1, self.rows + entry["rows"], self.failed + failed
        if entry["rows"]:
            self._shape = tuple(entry["shape"])
