"""The command `ovibjax reproduce`: the paper's figures and tables."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's figures and tables; without options, all of them on the embedded town.

    Figures, tables (CSV) and judged claims (JSON) are written to OUT/<figure>/, and OUT/index.html and
    OUT/README.md show them all.
    Rendering and embedding the town is done once and cached (folder: OVIBJAX_CACHE, or the user's cache).
    """

    preset: Literal["smoke", "quick", "full"] = "quick"
    """smoke: to see that it runs; quick: trained as full, fewer seeds and points; full: what results/ holds."""
    only: tuple[str, ...] = ()
    """Names of the figures to make, e.g. scalable_compression; all by default."""
    out: Path | None = None
    """Results folder; made if missing. By default results, or results-PRESET where results holds a longer preset."""
    data: tuple[Path, ...] = ()
    """Your own feature set: a .npz file, or a folder view_features/<Camera>/<frame>.npz (keys feature, position).
    For real_scene two of them, references and queries: --only real_scene --data REF QUERY."""
    backbone: str = "embedded"
    """Image backbone of the embedded town."""
    seed: int = 100
    """First seed; a figure over n seeds uses SEED ... SEED+n-1. Seeds below 100 are for tuning."""
    rank: int = 64
    """Principal coordinates kept per view (fitted on training frames); 0 keeps the full dimension, slower."""
    order: Literal["drive", "places"] | None = None
    """Whether the frames of --data are a drive in their order, or places in no order; by default as they look. Request
    control, scheduling and the whole system need a drive."""
    sweep: Path | None = None
    """A sweep file of your own (a Python file with TITLE and run(job)), run instead of the figures."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.cards.reproduce import reproduce

        if self.backbone != "embedded":
            raise InputError(
                f"backbone {self.backbone!r}: the figures embed the town with 'embedded'; write frames with "
                f"`ovibjax town --frames N`, embed them with `ovibjax features --backbone {self.backbone}`, "
                "and pass the file with --data"
            )
        rank = self.rank if self.rank != 0 else None
        page = reproduce(self.preset, self.only, self.out, self.data, self.seed, self.sweep, rank, self.order)
        console.print(f"results: {page}")
