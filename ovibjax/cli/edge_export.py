"""The command `ovibjax edge export`: the file that an edge and its robots are made from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ovibjax.cli.options import own_drive
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, progress_bar


@dataclass(frozen=True)
class EdgeExport:
    """Train the encoder of the request-control study and write what an edge and its robots need into one file.

    It holds the network, the references that the edge keeps, and the held-out routes that robots drive: arrays only.

    Example: ovibjax edge export edge.npz
    """

    out: tyro.conf.Positional[Path]
    """File to write, .npz."""
    data: Path | None = None
    """Your own frames, in order and half a second apart (.npz or folder, see `ovibjax reproduce --help`): the first
    60 % are the training route, robots drive the rest."""
    order: Literal["drive", "places"] | None = None
    """Whether the frames of --data are a drive in their order, or places in no order; by default as they look."""
    size: str = "full"
    """full: the embedded town's six drives; smoke: two short ones and a short training, to try things."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.cards.control_study import PRESETS, drives_of
        from ovibjax.live.edge_file import save_edge
        from ovibjax.live.exporting import make_edge

        if self.size not in PRESETS:
            raise InputError(f"--size {self.size}: sizes are {', '.join(PRESETS)}")
        if self.out.suffix != ".npz":
            raise InputError(f"{self.out}: the name of an edge file ends in .npz")
        if not self.out.parent.is_dir():
            raise InputError(f"{self.out}: its folder does not exist; create the folder first")
        own = own_drive(self.data, self.order)
        with progress_bar("rendering the routes", 1) as update:
            drives, training = drives_of(self.size, own, update)
        with console.status("training the encoder, surveying the scene"):
            edge = make_edge(drives, training, PRESETS[self.size].checkpoint)
        save_edge(self.out, edge)
        routes, size_mb = int(edge.route_number[-1]) + 1, self.out.stat().st_size / 1e6
        counts = f"{len(edge.reference_m)} references, {routes} routes of {len(edge.route_m)} frames"
        console.print(f"{self.out}: {counts}, {size_mb:.1f} MB, {edge.fingerprint.hex()[:8]}", highlight=False)
