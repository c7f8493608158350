"""The command `ovibjax report`: a sweep, or a folder of results, as one web page."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class Report:
    """Write one web page about a sweep: best points, every metric to explore, main effects, interactions, settings.

    It is one file, needs no network, opens on a phone and prints. Of a folder that `ovibjax reproduce` wrote, its
    README.md and index.html are written anew. Examples:

    ovibjax report runs/mine.zarr

    ovibjax report runs/mine.zarr --metric test_mean_m --where prefix=35 --out mine.html
    """

    path: tyro.conf.Positional[Path]
    """The store, a folder that `ovibjax sweep` wrote; or a folder of results."""
    metric: str | None = None
    """The metric of interest; all by default."""
    where: tuple[str, ...] = ()
    """Conditions that must all hold: prefix=16,35 beta!=1e-3 'gamma>=0.1'; as for `ovibjax show`."""
    over: tuple[str, ...] = ("seed",)
    """The axes to average over, with 95 % intervals; none shows every member by itself."""
    out: Path | None = None
    """File to write; PATH with .html by default."""

    def run(self) -> None:
        """Run the command."""
        results = self.path.is_dir() and any(self.path.glob("*/claims.json"))
        page = self._results() if results else self._sweep()
        console.print(f"written: {page} ({page.stat().st_size / 1e6:.1f} MB)", highlight=False)

    def _results(self) -> Path:
        from ovibjax.cards.dependencies import outdated
        from ovibjax.cards.result_pages import write_result_pages

        if self.metric is not None or self.where or self.over != ("seed",) or self.out is not None:
            raise InputError(f"{self.path}: a folder of results; --metric, --where, --over and --out are for a sweep")
        reasons = outdated(self.path)
        for reason in dict.fromkeys(reasons.values()):
            names = " ".join(name for name, said in reasons.items() if said == reason)
            console.print(f"{reason}, to be made anew with ovibjax reproduce --only: {names}", highlight=False)
        return write_result_pages(self.path)

    def _sweep(self) -> Path:
        from ovibjax.report.selection import select
        from ovibjax.report.web.sweep_html import write_sweep_page
        from ovibjax.sweep.store import config_of, open_dataset

        dataset = select(open_dataset(self.path), self.where)
        out = self.out or self.path.with_suffix(".html")
        about = {"store": str(self.path), **(config_of(self.path) or {})}
        about |= {"where": ", ".join(self.where)} if self.where else {}
        return write_sweep_page(dataset, out, self.path.stem, self.metric, self.over, about)
