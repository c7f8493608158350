"""Arithmetic coding in fractions, digit by digit, and the coding of small whole numbers."""

from fractions import Fraction

import numpy as np


def interval(symbols, tables):
    """Where a row of symbols lies in [0, 1): its beginning and its width."""
    low, width = Fraction(0), Fraction(1)
    for symbol, table in zip(symbols, tables, strict=True):
        low += width * Fraction(int(table[symbol]), 65536)
        width *= Fraction(int(table[symbol + 1] - table[symbol]), 65536)
    return low, width


def shortest(low, width):
    """The shortest bytes whose binary fraction is in [low, low + width); of equal length that with the most zeros."""
    size = 0
    while True:
        scale = 256**size
        first = -(-low * scale // 1)
        inside = []
        while (first + len(inside)) / scale < low + width and len(inside) < 256:
            inside.append(int(first) + len(inside))
        if inside:
            best = max(inside, key=lambda number: (number & -number) if number else 1 << 70)
            return best.to_bytes(size, "big")
        size += 1


def read(data, tables):
    """Symbols of the row in whose interval a binary fraction lies."""
    value, found = Fraction(int.from_bytes(data, "big"), 256 ** len(data)), []
    for table in tables:
        symbol = next(s for s in range(len(table) - 1) if value < Fraction(int(table[s + 1]), 65536))
        low, high = (Fraction(int(table[s]), 65536) for s in (symbol, symbol + 1))
        value = (value - low) / (high - low)
        found.append(symbol)
    return found


def nearest(z, step, first, last):
    """Place of a value on a grid, decided in exact arithmetic: of two that are as near, the even one."""
    exact = Fraction(float(z)) / Fraction(float(step))
    return min(max(round(exact), int(first)), int(last))


def nibbles(numbers):
    """Two numbers below 16 in a byte, the first in its lower half."""
    padded = [*map(int, numbers), 0][: len(numbers) + len(numbers) % 2]
    return bytes(padded[i] + 16 * padded[i + 1] for i in range(0, len(padded), 2))


def random_table(rng, levels):
    """Strictly ascending shares of 2^16, some of them tiny."""
    weights = rng.exponential(size=levels) ** 3
    counts = 1 + np.floor(weights / weights.sum() * (65536 - levels)).astype(int)
    counts[rng.integers(levels)] += 65536 - counts.sum()
    return [0, *np.cumsum(counts).tolist()]
