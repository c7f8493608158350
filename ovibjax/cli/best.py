"""The command `ovibjax best`: the point of a sweep with the lowest metric under bounds."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ovibjax.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from ovibjax.report.best import Choice, RunnerUp


@dataclass(frozen=True)
class Best:
    """Print the point of a sweep with the lowest metric under bounds, and the command that reruns it alone.

    The difference to the runner-up is paired by seed, with a 95 % interval: where that holds zero, the two cannot be
    told apart, and more seeds are needed to say which is better.

    Example: ovibjax best runs/system.zarr --minimise mean_route_m --subject-to 'kb<=2.1' 'top_edge_p95_ms<=60'
    """

    path: tyro.conf.Positional[Path]
    """The store, a folder that `ovibjax sweep` wrote."""
    minimise: str
    """The metric to minimise, averaged over OVER."""
    subject_to: tuple[str, ...] = ()
    """Bounds on other metrics: METRIC<=NUMBER, also >=, < and >; in quotes."""
    where: tuple[str, ...] = ()
    """Points to choose among, e.g. k=16,32 'beta>=1e-3'; as for `ovibjax show`."""
    over: tuple[str, ...] = ("seed",)
    """The axes to average over."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.report.best import choose, command
        from ovibjax.report.labels import axes_of, grid_dims, with_unit
        from ovibjax.report.selection import select
        from ovibjax.sweep.store import config_of, open_dataset

        dataset = self._trained_longest(select(open_dataset(self.path), self.where))
        found = choose(dataset, self.minimise, self.subject_to, self.over)
        print(_named(found.point))
        for name, mean in found.means.items():
            if mean == mean:
                half = found.halves[name]
                print(f"  {with_unit(dataset, name)}: {mean:.4g}" + (f" ± {half:.2g}" if isfinite(half) else ""))
        means = f"means over {' and '.join(self.over)}" if found.over else "single members"
        means += f" ({found.missing})" if found.missing else ""
        print(f"  best of {found.feasible} points that keep the bounds, of {found.points}; {means}")
        if found.runner_up is not None:
            unit = dataset[self.minimise].attrs.get("units", "")
            for line in _against(found, found.runner_up, "seed" if "seed" in found.over else "member", unit):
                print(f"  {line}")
        if "halving" in dataset.attrs["config"]:
            print(f"  among points trained for {int(dataset.steps.max())} steps; others: --where steps=NUMBER")
        try:
            axes = axes_of(dataset, grid_dims(dataset))
            out = str(self.path.with_name(f"{self.path.stem}-best.zarr"))
            print(command(config_of(self.path) or {}, axes, found.point, found.over, out))
        except InputError as error:
            print(f"  ({error})")

    def _trained_longest(self, dataset: "xr.Dataset") -> "xr.Dataset":
        """Of a halving the points that were trained longest, as it means to compare, unless steps were asked for."""
        from ovibjax.report.selection import select, taken_apart

        asked = [parts[0] for parts in map(taken_apart, self.where) if parts is not None]
        if "halving" not in dataset.attrs["config"] or "steps" in asked:
            return dataset
        there = dataset.finished.any([dim for dim in dataset.finished.dims if dim not in dataset.steps.dims])
        return select(dataset, [f"steps={int(dataset.steps.where(there).max())}"]) if bool(there.any()) else dataset


def _against(found: "Choice", runner_up: "RunnerUp", repetition: str, unit: str) -> list[str]:
    """The runner-up in words: `runner-up with beta = 0.01: higher by 0.3 ± 0.1 m over 5 common seeds`."""
    difference, common = runner_up.difference, runner_up.common
    other = {axis: value for axis, value in runner_up.point.items() if value != found.point[axis]}
    named = f"runner-up with {_named(other)}"
    if common == 0:
        return [f"{named}: no {repetition} in common, so that the two cannot be compared"]
    said = f"{named}: {'lower' if difference.mean < 0 else 'higher'} by {abs(difference.mean):.2g}"
    if common == 1:
        return [f"{said}{' ' + unit if unit else ''}; one {repetition} each, so that nothing tells how sure that is"]
    said += f" ± {difference.half:.2g}{' ' + unit if unit else ''} over {common} common {repetition}s"
    lines = [said if runner_up.apart else f"{said}: the two cannot be told apart"]
    if runner_up.others > 1:
        lines.append(f"{runner_up.tied} of {runner_up.others} other points cannot be told apart from the best")
    return lines


def _named(point: dict[str, object]) -> str:
    from ovibjax.report.labels import text_of

    return ", ".join(f"{axis} = {text_of(value)}" for axis, value in point.items())
