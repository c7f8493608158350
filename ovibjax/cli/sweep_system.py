"""The command `ovibjax sweep system`: the whole system at every point of a grid."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ovibjax.cli.options import (
    Counted,
    finished_line,
    integers,
    kept_in,
    numbers,
    own_drive,
    require_positive,
    require_store,
    shard_of,
)
from ovibjax.cli.processor import settle
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, progress_bar


@dataclass(frozen=True)
class SweepSystem:
    """Run the whole system at every point of a grid: encoder, retrieval, request control, edge queue; one program.

    A member is trained once per (beta, gamma, seed); its prefixes k, values of V and schedulers cost no training.
    Members of one seed share initial weights, minibatches, drift, channel and service times, so that differences
    between them are paired. Finished members are written to OUT as they come, and the same command goes on there.

    Example: ovibjax sweep system --beta 1e-4 1e-3 --k 16 32 --V 0 8 64 --seed 100:105 --out runs/system.zarr
    """

    out: Path
    """The store, a folder (NAME.zarr by custom); members that it has are not computed again."""
    beta: tuple[str, ...] = ("1e-3",)
    """Weights of the rate term."""
    gamma: tuple[str, ...] = ("0.1",)
    """Weights of the orthogonality penalty."""
    k: tuple[str, ...] = ("8", "16", "32", "64")
    """Prefix lengths that requests carry."""
    V: tuple[str, ...] = ("8",)
    """Weights of VOI against backlog in Base-DPP."""
    scheduler: tuple[str, ...] = ("all",)
    """Rules at the edge: fifo edf maxweight base_dpp voi_lyapunov; all by default."""
    code: tuple[str, ...] = ("float32",)
    """How prefixes are written: float32 int8 int4 entropy; they cost no training."""
    compact: bool = False
    """Send those that are not floats under a header of about 13 bytes instead of 20 and 4 per view."""
    seed: tuple[str, ...] = ("100:103",)
    """Seeds, as numbers or ranges: 100:105 is 100 101 102 103 104. Those below 100 are for tuning."""
    policy: Literal["voi", "uncertainty", "fixed_front", "periodic", "budgeted_periodic", "random", "oracle_action"] = (
        "voi"
    )
    """When clients ask the edge."""
    steps: int = 600
    """Training steps."""
    clients: int = 6
    """Clients replayed, each with drift and channel of its own."""
    fleet: int = 30
    """Clients N on each edge server."""
    kb_per_s: float = 4.0
    """Uplink rate, KB/s of 1,024 bytes."""
    data: Path | None = None
    """Your own feature set: frames of one route in order, half a second apart, the first 60 % for training."""
    order: Literal["drive", "places"] | None = None
    """Whether the frames of --data are a drive in their order, or places in no order; by default as they look."""
    shard: str | None = None
    """i/n, e.g. 3/16: compute a sixteenth of the members, so that 16 commands fill one OUT (or several, see merge)."""
    threads: int | None = None
    """Threads of one program. Bits depend on it: by default those that OUT was begun with, in a new one 8."""
    keep_both: bool = False
    """If OUT holds another sweep (other settings, data or code), use a store beside it instead of stopping."""

    def run(self) -> None:
        """Run the command."""
        settle(self.out, self.threads)
        from ovibjax.link.codes.tables import CODES
        from ovibjax.scheduling.rules import POLICIES
        from ovibjax.system.data import PREFIXES

        at_least_zero = (lambda value: value >= 0, "zero or more")
        axes: dict[str, list[Any]] = {
            "beta": numbers("beta", self.beta, *at_least_zero),
            "gamma": numbers("gamma", self.gamma, *at_least_zero),
            "seed": integers("seed", self.seed, 0, 2**31 - 1),
        }
        along: dict[str, list[Any]] = {"k": sorted(set(integers("k", self.k, 1, max(PREFIXES))))}
        along["V"] = numbers("V", self.V, *at_least_zero)
        schedulers = POLICIES if self.scheduler == ("all",) else self.scheduler
        for name in schedulers:
            if name not in POLICIES:
                raise InputError(f"--scheduler {name}: there are {', '.join(POLICIES)}")
        for name in self.code:
            if name not in CODES:
                raise InputError(f"--code {name}: there are {', '.join(CODES)}")
        if len(set(self.code)) < len(self.code):
            raise InputError("--code: one of them is there twice")
        require_positive(self, "steps", "clients", "fleet")
        if not self.kb_per_s > 0:
            raise InputError(f"--kb-per-s {self.kb_per_s} is not positive")
        shard_of(self.shard)  # misspelt, it is refused before the data are prepared
        require_store(self.out)
        self._sweep(axes, along, tuple(schedulers))

    def _sweep(self, axes: dict[str, list[Any]], along: dict[str, Any], schedulers: tuple[str, ...]) -> None:
        from ovibjax.cards.control_study import drives_of
        from ovibjax.system.data import FLOATS, SystemSize
        from ovibjax.system.grids import sweep_system

        own = own_drive(self.data, self.order)
        with progress_bar("rendering the routes", 1) as update:
            drives, training = drives_of("full", own, update)
        size = SystemSize(steps=self.steps, clients=self.clients, fleet=self.fleet, kb_per_s=self.kb_per_s)
        settings: dict[str, Any] = {"policy": self.policy}
        settings |= {"steps": self.steps, "clients": self.clients, "fleet": self.fleet, "kb_per_s": self.kb_per_s}
        settings |= {"k": along["k"], "V": along["V"], "scheduler": list(schedulers)}
        if self.code != FLOATS:  # stores of floats alone are those of before
            settings |= {"code": list(self.code), "compact": self.compact}
        with progress_bar("training and replaying", 1) as update:
            counted = Counted(update)
            dataset, store = kept_in(
                self.out,
                self.keep_both,
                lambda store: sweep_system(
                    (drives, training, size),
                    axes,
                    (along["k"], along["V"], schedulers),
                    self.policy,
                    (self.code, self.compact),
                    store=store,
                    settings=settings,
                    notes={"data": str(self.data)} if self.data else None,
                    shard=shard_of(self.shard),
                    on_progress=counted,
                ),
            )
        lost = int(dataset.unserved.sum())
        line = finished_line(dataset, counted, f"; {lost} requests exceeded the room kept for them" if lost else "")
        each = dataset.top_cost.size // dataset.finished.size
        console.print(f"{line}, {each} points each: {store}\nlook at them: ovibjax show {store}")
