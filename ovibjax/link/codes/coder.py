"""A prefix as bytes and back, by any of the codes; any prefix of the coordinates can be cut from the bytes of another.

The bytes of k coordinates are those of `Coder.encode`, whoever makes them: a robot from its code, or whoever holds the
table from the bytes of more coordinates. They do not tell k nor the code: packets do (`link.coded_packets`).
"""

import numpy as np

from ovibjax.link.codes.arithmetic import TOTAL_BITS, StreamError, read_symbols, read_whole, write_symbols
from ovibjax.link.codes.rounding import numbers_of, values_of
from ovibjax.link.codes.tables import CODES, LEVELS, CodeTable, check_table


class Coder:
    """Encoder and decoder of one code with its table.

    Args:
        code: one of `CODES`.
        table: what `fit_table` gave for it; None for `float32`.

    Raises:
        ValueError: an unknown code, a damaged table, or one of another code.
    """

    def __init__(self, code: str, table: CodeTable | None = None) -> None:
        if code not in CODES:
            raise ValueError(f"code is one of {', '.join(CODES)}, not {code!r}")
        if (table is None) != (code == "float32"):
            raise ValueError(f"code {code} with{'out' if table is None else ''} a table")
        self.code, self.table = code, table
        self._rows: list[list[int]] = []
        if table is None:
            return
        check_table(table)
        levels = np.asarray(table.grid.last) - table.grid.first + 1
        if bool(table.cumulative.shape[1]) != (code == "entropy") or levels.max() > LEVELS.get(code, levels.max()):
            raise ValueError(f"this is no table of code {code}")
        if code == "entropy":
            self._rows = [row[: n + 1].tolist() for row, n in zip(table.cumulative, levels, strict=True)]

    def encode(self, prefix: np.ndarray) -> bytes:
        """The bytes of a prefix.

        Args:
            prefix: [k] float32 coordinates; what is beyond its grid saturates.

        Returns:
            4 k bytes for `float32`, k for `int8`, k / 2 rounded up for `int4`, as many as it takes for `entropy`.
        """
        prefix = np.asarray(prefix, np.float32)
        return prefix.astype("<f4").tobytes() if self.table is None else self._write(self._symbols(prefix))

    def decode(self, data: bytes, k: int) -> np.ndarray:
        """The prefix that bytes stand for.

        Args:
            data: what `encode` or `cut` gave.
            k: how many coordinates they hold.

        Returns:
            [k] float32, the same bits on every machine.

        Raises:
            StreamError: bytes that `encode` never gives for k coordinates.
        """
        if self.table is None:
            if len(data) != 4 * k:
                raise StreamError(f"{len(data)} bytes are not {k} numbers of 4")
            return np.frombuffer(data, "<f4").astype(np.float32)
        numbers = np.array(self._read(data, k), np.int64) + np.asarray(self.table.grid.first)[:k]
        return values_of(self.table.grid, numbers)

    def cut(self, data: bytes, of: int, k: int) -> bytes:
        """The bytes of a shorter prefix, as the robot would have sent it.

        Args:
            data: bytes of `of` coordinates.
            of: how many coordinates they hold.
            k: how many to keep, at most `of`.

        Returns:
            What `encode` gives for the first k coordinates.

        Raises:
            ValueError: k is more than there are.
        """
        if not 0 <= k <= of:
            raise ValueError(f"{k} coordinates cannot be cut from {of}")
        if self.code == "float32":
            return data[: 4 * k]
        symbols = read_symbols(data, k, self._rows) if self.code == "entropy" else self._read(data, of)[:k]
        return self._write(symbols)

    def ideal_bits(self, prefix: np.ndarray) -> float:
        """Length of a prefix by the shares of the table: the sum of -log2 of them, where there are any.

        Args:
            prefix: [k] float32 coordinates.

        Returns:
            Bits; no stream with this table is shorter on average.
        """
        if self.code != "entropy":
            return {"float32": 32.0, "int8": 8.0, "int4": 4.0}[self.code] * len(prefix)
        chosen = zip(self._symbols(np.asarray(prefix, np.float32)), self._rows, strict=False)
        share = np.array([row[symbol + 1] - row[symbol] for symbol, row in chosen], np.float64)
        return float(np.sum(TOTAL_BITS - np.log2(share)))

    def _symbols(self, prefix: np.ndarray) -> list[int]:
        assert self.table is not None
        return (numbers_of(self.table.grid, prefix) - np.asarray(self.table.grid.first)[: len(prefix)]).tolist()

    def _write(self, symbols: list[int]) -> bytes:
        if self.code == "entropy":
            return write_symbols(symbols, self._rows)
        if self.code == "int8":
            return bytes(symbols)
        padded = symbols + [0] * (len(symbols) % 2)
        return bytes(low | high << 4 for low, high in zip(padded[::2], padded[1::2], strict=True))

    def _read(self, data: bytes, k: int) -> list[int]:
        if self.code == "entropy":
            return read_whole(data, k, self._rows)
        symbols = list(data) if self.code == "int8" else [nibble for byte in data for nibble in (byte & 15, byte >> 4)]
        if len(data) != (k if self.code == "int8" else (k + 1) // 2) or any(symbols[k:]):
            raise StreamError(f"{len(data)} bytes are not {k} coordinates of {self.code}")
        return symbols[:k]
