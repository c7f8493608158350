"""The command `ovibjax sweep train`: an encoder trained and judged at every point of a grid."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ovibjax.cli.options import (
    Counted,
    executor_of,
    finished_line,
    integers,
    kept_in,
    numbers,
    require_positive,
    require_store,
    shard_of,
)
from ovibjax.cli.processor import settle
from ovibjax.cli.search import HalvingOptions, SearchOptions, halved_line, range_or_none, searched
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, progress_bar

if TYPE_CHECKING:
    import xarray

    from ovibjax.encoder.train import TrainConfig
    from ovibjax.sweep.engine import Executor


@dataclass(frozen=True)
class SweepTrain:
    """Train an O-VIB encoder at every point of a grid and judge it at every prefix; one compiled program.

    Give one or more values per axis; every combination is trained once per seed. Members of one seed see the same
    split, initial weights, minibatches and noise, so that differences between them are paired. Finished members are
    written to OUT as they come: after Ctrl-C, a crash or a kill, the same command goes on where it stopped. A command
    with more values, or others, adds the members that are missing.

    Any axis but seed may be a range, from which --sobol or --random draw points: --beta log:1e-5:1e-1 --sobol 64. With
    --halving 3 points are judged on the way by their mean validation error (val_mean_m over prefixes and modes), and
    the best third goes on.

    Example: ovibjax sweep train --beta 1e-4 1e-3 --gamma 0 0.01 0.1 1 --seed 0:5 --prefix 8 16 35 --out runs/mine.zarr
    """

    out: Path
    """The store, a folder (NAME.zarr by custom); members that it has are not computed again."""
    beta: tuple[str, ...] = ("1e-3",)
    """Weights of the rate term; with --prior bits, prices of a bit."""
    gamma: tuple[str, ...] = ("0.1",)
    """Weights of the orthogonality penalty."""
    alpha: tuple[str, ...] = ("1",)
    """Weights of the localization term."""
    lr: tuple[str, ...] = ("4e-3",)
    """Peak learning rates."""
    weight_decay: tuple[str, ...] = ("1e-4",)
    """Weight decays of AdamW."""
    nesting: tuple[str, ...] = ("1",)
    """Shares of training examples that see a random prefix; 1 is the paper's nested training, 0 is none."""
    seed: tuple[str, ...] = ("0:3",)
    """Seeds, as numbers or ranges: 0:5 is 0 1 2 3 4."""
    # The default is frozen, so that instances may share it.
    search: tyro.conf.OmitArgPrefixes[SearchOptions] = SearchOptions()  # noqa: RUF009
    """How points are drawn where an axis is a range."""
    halving: tyro.conf.OmitArgPrefixes[HalvingOptions] = HalvingOptions()  # noqa: RUF009
    """Whether only the best points are trained to the end."""
    prefix: tuple[str, ...] = ("8", "16", "35", "128")
    """Prefix lengths to judge at (costs no training)."""
    mode: tuple[str, ...] = ("all",)
    """View modes to judge in: F FS H4 A5; all: every view of the platform."""
    steps: int | None = None
    """Training steps, rounded up to whole epochs; by default 75 epochs, at least 400 and at most 10000 steps."""
    batch: int = 128
    """Examples per step."""
    latent: int = 128
    """Full latent dimension K."""
    prior: Literal["gaussian", "ard", "bits"] = "gaussian"
    """Prior of the rate term; bits: codes are rounded to learned steps, and each pays for the bits of what is sent."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Operands of matrix products; auto: those OUT was begun with, in a new one bfloat16 where this machine is faster
    with it, else float32."""
    data: Path | None = None
    """Your own feature set (.npz or folder, see `ovibjax reproduce --help`); the embedded town by default."""
    rank: int = 64
    """Principal coordinates kept per view; 0 keeps the full dimension."""
    keep_params: bool = False
    """Also store the trained parameters (3 MB per member)."""
    on: Literal["local", "ray"] = "local"
    """Where members are computed: this machine, or a Ray cluster (extra [cluster])."""
    address: str | None = None
    """Address of a running Ray cluster; a local one is started by default. OUT must be visible to its workers."""
    devices: int | None = None
    """Split the processor into so many devices; by default members run side by side, one per core."""
    threads: int | None = None
    """Threads of one program. Bits depend on it: by default those that OUT was begun with, in a new one 8."""
    shard: str | None = None
    """i/n, e.g. 3/16: compute a sixteenth of the members, so that 16 commands fill one OUT (or several, see merge)."""
    keep_both: bool = False
    """If OUT holds another sweep (other settings, data or code), use a store beside it instead of stopping."""

    def run(self) -> None:
        """Run the command."""
        settle(self.out, self.threads, self.devices)
        (axes, zipped), prefixes = searched(self._axes(), self.search), self._prefixes()
        self.halving.check(self.shard, self.on)
        shard_of(self.shard)  # misspelt, it is refused before the data are prepared
        require_store(self.out)
        require_positive(self, "steps", "batch", "latent")
        self._train(axes, zipped, prefixes, executor_of(self.on, self.address))

    def _axes(self) -> dict[str, Any]:
        """Values of every axis, or the range to draw them from."""
        rules: dict[str, tuple[Callable[[float], bool], str]] = dict.fromkeys(
            ("alpha", "beta", "gamma", "weight_decay"), (lambda value: value >= 0, "zero or more")
        )
        rules["lr"] = (lambda value: value > 0, "positive")
        rules["nesting"] = (lambda value: 0 <= value <= 1, "between 0 and 1")
        axes: dict[str, Any] = {}
        for name, rule in rules.items():
            option, items = name.replace("_", "-"), getattr(self, name)
            axes[name] = range_or_none(f"--{option} ", items, *rule) or numbers(option, items, *rule)
        axes["seed"] = integers("seed", self.seed, 0, 2**31 - 1)
        return axes

    def _prefixes(self) -> tuple[int, ...]:
        return tuple(sorted(integers("prefix", self.prefix, 1, self.latent)))

    def _precision(self) -> str:
        """The operands by name; what a store was begun with stays, on whatever machine it is gone on with."""
        from ovibjax.runtime.precision import PRECISIONS
        from ovibjax.runtime.precision_choice import faster_precision
        from ovibjax.sweep.store import config_of

        if self.precision != "auto":
            return self.precision
        begun_with = (config_of(self.out) or {}).get("settings", {}).get("precision")
        return begun_with if begun_with in PRECISIONS else faster_precision()

    def _modes(self, n_views: int) -> tuple[str, ...]:
        """View modes to judge in."""
        from ovibjax.views import full_mode, modes_for

        modes = (full_mode(n_views),) if self.mode == ("all",) else self.mode
        for mode in modes:
            if mode not in modes_for(n_views):
                raise InputError(f"--mode {mode}: the data have {n_views} views, modes {', '.join(modes_for(n_views))}")
        return modes

    def _static(self, n_views: int, view_dim: int) -> "TrainConfig":
        """Static choices of the training."""
        from ovibjax.encoder.model import Architecture
        from ovibjax.encoder.recipe import training_prefixes
        from ovibjax.encoder.train import TrainConfig, for_bits

        rank = max(Architecture.rank, self.latent)
        static = TrainConfig(
            arch=Architecture(n_views=n_views, view_dim=view_dim, latent=self.latent, rank=rank),
            prefixes=training_prefixes(self.latent),
            prior=self.prior,
            steps=self.steps,
            batch=self.batch,
            precision=self._precision(),
        )
        return for_bits(static) if self.prior == "bits" else static

    def _train(
        self,
        axes: dict[str, list[Any]],
        zipped: list[tuple[str, ...]],
        prefixes: tuple[int, ...],
        executor: "Executor | None",
    ) -> None:
        from ovibjax.cards.loading import load_features
        from ovibjax.edge.member import SCORE, TrainAndJudge, labels_of
        from ovibjax.encoder.training_data import member_data
        from ovibjax.sweep.engine import run
        from ovibjax.sweep.halving import halve
        from ovibjax.sweep.work import Along

        features = load_features(self.data)
        modes = self._modes(features.features.shape[1])
        members = []
        with progress_bar("splitting and projecting", len(axes["seed"])) as update:
            for i, seed in enumerate(axes["seed"], start=1):
                members.append(member_data(features, seed, self.rank or None)[0])
                update(i)
        static = self._static(*members[0].train.x.shape[1:])
        settings: dict[str, Any] = {name: getattr(self, name) for name in ("rank", "steps", "batch", "latent", "prior")}
        settings |= {"precision": static.precision, "prefix": list(prefixes), "mode": list(modes)}
        # In stages without halving too: a point that a halving chose has the same bits when it is trained alone.
        fn = TrainAndJudge(static, prefixes, modes, keep_params=self.keep_params).staged(len(members[0].train.x))
        coords = {"prefix": list(prefixes), "mode": list(modes)}
        notes = {"data": str(self.data)} if self.data else None
        common: dict[str, Any] = {"zipped": zipped, "settings": settings, "notes": notes}
        common |= labels_of(self.prior) | {"coords": coords}

        def compute(store: Path) -> "xarray.Dataset":
            data = Along("seed", members)
            if self.halving.halving is None:
                shard = shard_of(self.shard)
                return run(fn, axes, data, **common, store=store, shard=shard, executor=executor, on_progress=counted)
            by: dict[str, Any] = {"score": SCORE, "factor": self.halving.halving, "rungs": self.halving.rungs}
            return halve(fn, axes, data, **by, **common, store=store, on_progress=counted)

        with progress_bar("training", 1) as update:
            counted = Counted(update)
            dataset, store = kept_in(self.out, self.keep_both, compute)
        if self.halving.halving is not None:
            console.print(halved_line(dataset, store))
            return
        diverged = int(dataset.diverged.sum())
        line = finished_line(dataset, counted, f", {diverged} diverged" if diverged else "")
        console.print(f"{line}: {store}\nlook at them: ovibjax show {store}")
