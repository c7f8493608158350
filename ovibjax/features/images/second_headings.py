"""Headings that a table has twice, as degrees, radians or rotations: whether those that are not used say the same."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from ovibjax.errors import doubt
from ovibjax.runtime.text_tables import number_of

_SAME_RAD = math.radians(1.0)  # what a few digits may cost


class SecondHeadings:
    """Compares the headings of a table with others of the same rows.

    Args:
        spare: columns of known names (`yaw_deg`, `yaw_rad`, all of `qw`, `qx`, `qy`, `qz`) that are not used.
    """

    def __init__(self, spare: Mapping[str, int]) -> None:
        self._spare = spare
        self._worst: dict[str, tuple[float, int]] = {}

    def compare(self, line: int, yaw_rad: float, cells: Sequence[str]) -> None:
        """Look at one row, beside the heading that is used."""
        found = {name: number for name, at in self._spare.items() if (number := number_of(cells[at])) is not None}
        others: dict[str, float] = {}
        if "yaw_deg" in found:
            others["yaw_deg"] = math.radians(found["yaw_deg"])
        if "yaw_rad" in found:
            others["yaw_rad"] = found["yaw_rad"]
        if {"qw", "qx", "qy", "qz"} <= found.keys():
            w, x, y, z = (found[name] for name in ("qw", "qx", "qy", "qz"))
            if abs(math.hypot(w, x, y, z) - 1) < 0.1:  # zeros stand for none
                others["qw,qx,qy,qz"] = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
        for name, other in others.items():
            apart = abs(math.remainder(other - yaw_rad, 2 * math.pi)) if math.isfinite(other - yaw_rad) else 0.0
            if apart > max(_SAME_RAD, self._worst.get(name, (0.0, 0))[0]):
                self._worst[name] = (apart, line)

    def doubt_them(self, path: Path, used: str) -> None:
        """Name each column that says otherwise.

        Warns:
            Doubt: for each, with the line where it is worst and the option that settles it.
        """
        for name, (apart, line) in self._worst.items():
            choice = f"say which is right, --columns {name.partition(',')[0]}=NAME, or leave one out"
            doubt(
                path,
                f"{used} is used, {name} disagrees by up to {math.degrees(apart):.0f} degrees (line {line}); {choice}",
            )
