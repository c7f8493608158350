"""The command `ovibjax best`: the point of a sweep with the lowest metric under bounds."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Best:
    """Print the point of a sweep with the lowest metric under bounds, and the command that reruns it alone.

    Example: ovibjax best runs/system.zarr --minimise mean_route_m --subject-to 'kb<=2.1' 'top_edge_p95_ms<=60'
    """

    path: tyro.conf.Positional[Path]
    """The store, a folder that `ovibjax sweep` wrote."""
    minimise: str
    """The metric to minimise, averaged over OVER."""
    subject_to: tuple[str, ...] = ()
    """Bounds on other metrics: METRIC<=NUMBER, also >=, < and >; in quotes."""
    where: tuple[str, ...] = ()
    """Points to choose among, e.g. k=16,32."""
    over: str = "seed"
    """The axis to average over."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.report.best import choose, command
        from ovibjax.report.labels import select, text_of, with_unit
        from ovibjax.sweep.store import config_of, open_dataset

        dataset = select(open_dataset(self.path), self.where)
        found = choose(dataset, self.minimise, self.subject_to, self.over)
        print(", ".join(f"{axis} = {text_of(value)}" for axis, value in found.point.items()))
        for name, mean in found.means.items():
            if mean == mean:
                half = found.halves[name]
                print(f"  {with_unit(dataset, name)}: {mean:.4g}" + (f" ± {half:.2g}" if isfinite(half) else ""))
        print(f"  best of {found.feasible} points that keep the bounds, of {found.points}; means over {self.over}")
        config = config_of(self.path) or {}
        over = {self.over: found.over} if found.over else {}
        print(command(config, found.point, over, str(self.path.with_name(f"{self.path.stem}-best.zarr"))))
