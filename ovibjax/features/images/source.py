"""What a source of images is: frames with poses, each with one image per view, wherever the files lie."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ovibjax.errors import InputError, refusal

MAX_IMAGE_BYTES = 256 * 2**20
"""Largest image file read."""
MAX_TEXT_BYTES = 2**20
"""Largest metadata or calibration file read."""
MAX_MAGNITUDE = 1e9
"""Largest coordinate or angle taken for one."""

OnStep = Callable[[str, int, int], None]
"""Called with what is being done, steps done and steps in all."""


@dataclass(frozen=True)
class Frame:
    """One pose with its images.

    Attributes:
        frame_id: name, unique in the source.
        position_m: x, y, z in the axes of the data.
        yaw_rad: heading, from x towards y.
        scene: name of the scene.
        context: index into `frames.CONTEXTS`, -1 where unknown.
        images: names for `Source.read`, in the order of `views.VIEWS`.
        sizes_bytes: length of each image file.
    """

    frame_id: str
    position_m: tuple[float, float, float]
    yaw_rad: float
    scene: str
    context: int
    images: tuple[str, ...]
    sizes_bytes: tuple[int, ...]


@dataclass(frozen=True)
class Skipped:
    """A frame left out: why (one of few reasons, for counting), and what exactly."""

    frame_id: str
    reason: str
    detail: str


class Files(Protocol):
    """Read access to files by name, relative and with forward slashes; reading is safe from several threads."""

    path: Path

    @property
    def sizes_bytes(self) -> Mapping[str, int]:
        """Length by name."""

    def read(self, name: str) -> bytes:
        """The content of a file; InputError where the system refuses."""

    def by_place(self, names: Iterable[str]) -> list[str]:
        """The names in the order in which reading is fast."""

    def close(self) -> None:
        """Release the files."""


@dataclass(frozen=True)
class Source:
    """An ordered list of frames, and the way to their images.

    Attributes:
        files: where the images lie.
        frames: complete frames, in order.
        skipped: frames that lack a view or a pose.
        axes: what the data say of their axes.
        form: what a file of poses was taken for; "" for a layout of folders.
    """

    files: Files
    frames: tuple[Frame, ...]
    skipped: tuple[Skipped, ...]
    axes: str
    form: str = ""

    @property
    def name(self) -> str:
        """What to call the source in messages."""
        return str(self.files.path)

    def read(self, image: str) -> bytes:
        """The encoded bytes of one image."""
        return self.files.read(image)

    def close(self) -> None:
        """Release the files."""
        self.files.close()


def describe_skipped(skipped: Iterable[Skipped], shown: int = 3) -> str:
    """Counts by reason with the first few cases: `2 a view is missing (000003: Left; 000007: Down)`."""
    groups: dict[str, list[str]] = {}
    for one in skipped:
        groups.setdefault(one.reason, []).append(f"{one.frame_id}: {one.detail}")
    parts = []
    for reason, cases in groups.items():
        more = f"; and {len(cases) - shown} more" if len(cases) > shown else ""
        parts.append(f"{len(cases)} {reason} ({'; '.join(cases[:shown])}{more})")
    return ", ".join(parts)


def nothing_left(name: str, skipped: Iterable[Skipped], hint: str = "") -> InputError:
    """The error for a source without one usable frame, and what may have been meant."""
    why = describe_skipped(skipped, 1) or "none, as there is none"
    return refusal(name, f"no usable frame{f' ({hint})' if hint else ''}; skipped: {why}")
