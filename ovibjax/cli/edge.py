"""The commands of the live edge: `ovibjax edge export`, `serve`, `drive` and `report`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from ovibjax.cli.edge_drive import EdgeDrive
from ovibjax.cli.edge_export import EdgeExport
from ovibjax.cli.edge_report import EdgeReport
from ovibjax.cli.edge_serve import EdgeServe


@dataclass(frozen=True)
class Edge:
    """The whole chain with real sockets and clocks: an edge server, robots, and what they wrote down."""

    what: Annotated[
        Annotated[EdgeExport, tyro.conf.subcommand("export")]
        | Annotated[EdgeServe, tyro.conf.subcommand("serve")]
        | Annotated[EdgeDrive, tyro.conf.subcommand("drive")]
        | Annotated[EdgeReport, tyro.conf.subcommand("report")],
        tyro.conf.arg(name=""),
    ]
    """What to do."""

    def run(self) -> None:
        """Run the command."""
        self.what.run()
