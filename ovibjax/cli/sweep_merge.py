"""The commands `ovibjax sweep merge` and `ovibjax sweep upgrade`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class SweepMerge:
    """Join stores of one sweep, such as shards from machines that share no file system.

    Example: ovibjax sweep merge a.zarr b.zarr --out all.zarr
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """The stores; they stay as they are."""
    out: Path
    """The store they are joined in; members are added to one that is there."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.sweep.merging import merge

        total, added = merge(self.paths, self.out)
        console.print(f"{total} members, {added} of them new: {self.out}")


@dataclass(frozen=True)
class SweepUpgrade:
    """Bring a store of the format of before over into one of today's, to be shown and read.

    Example: ovibjax sweep upgrade old.zarr --out new.zarr
    """

    path: Annotated[Path, tyro.conf.Positional]
    """The old store; it stays as it is."""
    out: Path
    """The new one."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.sweep.old_format import upgrade

        console.print(f"{upgrade(self.path, self.out)} members: {self.out}")
