"""Arithmetic coding in whole numbers of any length: exact, so that two machines cannot disagree.

A row of symbols is an interval of [0, 1) as wide as the row is probable; its bytes are the shortest binary fraction
inside. Probabilities are whole shares of 2^16 (`TOTAL`). A code has at most a few hundred coordinates, for which plain
integers are fast enough, and which range coders with words of four bytes would lengthen: the streams here are within
one byte of the ideal length, each by itself.

As symbols are coded in order and nothing is carried back, whoever has the tables reads the first k symbols of any
stream, and so can cut it: their own shortest fraction is the stream that would have been sent for k.
"""

from bisect import bisect_right
from collections.abc import Sequence

TOTAL_BITS = 16
TOTAL = 1 << TOTAL_BITS
"""What the shares of a coordinate's symbols add up to."""


class StreamError(ValueError):
    """Bytes that no encoder with these tables sends."""


def write_symbols(symbols: Sequence[int], tables: Sequence[Sequence[int]]) -> bytes:
    """The stream of a row of symbols.

    Args:
        symbols: k symbols, counted from 0.
        tables: at least k cumulative tables: table[s] is the share of symbols below s, from 0 to `TOTAL`, strictly
            ascending.

    Returns:
        The shortest bytes, less than one byte longer than the ideal length; none at all for a row that begins at 0.
    """
    low, width = 0, 1
    for symbol, table in zip(symbols, tables, strict=False):
        below = table[symbol]
        low = (low << TOTAL_BITS) + below * width
        width *= table[symbol + 1] - below
    return _shortest(low, width, len(symbols))


def _shortest(low: int, width: int, count: int) -> bytes:
    """The shortest fraction in an interval of so many symbols."""
    if not low:
        return b""
    # Of the numbers from low to high, the one that ends with the most zeros: high without what is behind the first bit
    # in which it differs from low - 1.
    high, precision = low + width - 1, TOTAL_BITS * count
    zeros = ((low - 1) ^ high).bit_length() - 1
    size = (precision - zeros + 7) // 8
    return (high >> zeros << zeros + 8 * size >> precision).to_bytes(size, "big")


def read_symbols(data: bytes, count: int, tables: Sequence[Sequence[int]]) -> list[int]:
    """The first symbols of a stream; it may be that of a longer row.

    Args:
        data: the stream.
        count: symbols wanted.
        tables: as they were written with.

    Returns:
        The symbols.
    """
    return _read(data, count, tables)[0]


def _read(data: bytes, count: int, tables: Sequence[Sequence[int]]) -> tuple[list[int], int, int]:
    """The first symbols of a stream, and the interval that they leave: its lower end and width."""
    precision = TOTAL_BITS * count
    shift = precision - 8 * len(data)
    value = int.from_bytes(data, "big")
    value = value << shift if shift >= 0 else value >> -shift
    width, rest, found, mask = 1, 0, [], TOTAL - 1
    for table in tables[:count]:
        precision -= TOTAL_BITS
        rest = (rest << TOTAL_BITS) + (value >> precision & mask)
        symbol = bisect_right(table, rest // width) - 1
        below = table[symbol]
        rest -= below * width
        width *= table[symbol + 1] - below
        found.append(symbol)
    return found, value - rest, width


def read_whole(data: bytes, count: int, tables: Sequence[Sequence[int]]) -> list[int]:
    """The symbols of a stream that holds exactly so many.

    Args:
        data: the stream.
        count: symbols that it holds.
        tables: as it was written with.

    Returns:
        The symbols.

    Raises:
        StreamError: these bytes are not what `write_symbols` makes of any row of so many symbols.
    """
    # Longer than any: not worth the work.
    if len(data) <= TOTAL_BITS // 8 * count:
        symbols, low, width = _read(data, count, tables)
        if _shortest(low, width, count) == data:
            return symbols
    raise StreamError(f"{len(data)} bytes are no stream of {count} coordinates")
