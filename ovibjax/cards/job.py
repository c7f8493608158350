"""What a card is given: its data, its output folder, and sweeps that go on where an interrupted figure stopped."""

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import xarray

from ovibjax.cards.dependencies import code_hash
from ovibjax.errors import InputError
from ovibjax.features.frames import FeatureSet
from ovibjax.features.sequence import require_drive
from ovibjax.report.provenance import provenance
from ovibjax.runtime.cache import cache_folder
from ovibjax.runtime.progress import progress_bar
from ovibjax.runtime.stage_times import Stages
from ovibjax.sweep.differences import digest
from ovibjax.sweep.engine import Interrupted, run

PRESETS = ("smoke", "quick", "full")
Sweep = Callable[..., xarray.Dataset]
"""`sweep(description, fn, axes, shared, **options)`, as `Job.sweep`."""

STAGES = ("render", "features", "train", "judge", "codecs", "replay", "time", "draw", "other")
"""What a card's time is spent on; `other` is what it does outside of the stages that it names."""

FEW = 5
"""Below this many repetitions a caption says that intervals are wide: Student's t is 2.8 at 5 and 4.3 at 3."""

_KEPT_S = 7 * 24 * 3600.0


class NotHere(InputError):
    """This machine cannot make a figure, whatever is asked for; of all figures it is left out."""


class CardInterrupted(KeyboardInterrupt):
    """Ctrl-C came; the message says what was kept."""


@dataclass(frozen=True)
class Job:
    """What a card is given.

    Attributes:
        name: the card's name.
        preset: one of `PRESETS`.
        out: the card's own output folder, which exists.
        seed: first seed; a card that needs n seeds uses seed ... seed + n - 1.
        features: the data.
        source: "embedded" or the path the data came from.
        rank: coordinates kept per view; None keeps all.
        queries: the second feature set of a card that takes references and queries; None for embedded data.
        stages: where its time goes.
        order: what somebody said their frames are, one of `features.sequence.ORDERS`; None as they look.
        card: the card's file; None if it has none.
    """

    name: str
    preset: str
    out: Path
    seed: int
    features: FeatureSet
    source: str
    rank: int | None
    queries: FeatureSet | None = None
    stages: Stages = field(default_factory=Stages)
    order: str | None = None
    card: Path | None = None

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Count the time of a `with` block to a stage.

        Args:
            name: one of `STAGES`, or a name of the card's own.

        Returns:
            A context manager; blocks may nest, and time counts to the innermost.
        """
        return self.stages.stage(name)

    def sweep(
        self, description: str, fn: Any, axes: Mapping[str, Any], shared: Any, stage: str = "train", **options: Any
    ) -> xarray.Dataset:
        """`sweep.run`, kept as `kept` says.

        Args:
            description: what the bar says.
            fn: member function.
            axes: values per axis.
            shared: data.
            stage: see `stage`.
            options: further options of `sweep.run`.

        Returns:
            See `kept`.

        Raises:
            CardInterrupted: Ctrl-C; finished members are kept.
        """
        return self.kept(description, partial(run, fn, axes, shared, **options), stage)

    def kept(self, description: str, compute: Callable[..., xarray.Dataset], stage: str = "train") -> xarray.Dataset:
        """A sweep with a progress bar and a store in the cache folder: an interrupted figure goes on from there.

        Args:
            description: what the bar says.
            compute: the sweep; takes `store` and `on_progress` of `sweep.run`.
            stage: see `stage`.

        Returns:
            The dataset, complete; attribute `resumed` says how many members an earlier run had finished.

        Raises:
            CardInterrupted: Ctrl-C; finished members are kept.
        """
        folder = cache_folder() / "sweeps"

        def store(config: dict[str, Any]) -> Path:
            return folder / f"{self.name}-{digest(config)[:16]}.zarr"

        found: list[int] = []
        with self.stage(stage), progress_bar(description, 1) as update:

            def on_progress(done: int, total: int) -> None:
                found.append(done)
                update(done, total)

            try:
                dataset = compute(store=store, on_progress=on_progress)
            except Interrupted as error:
                finished = error.dataset.finished
                kept = f"{int(finished.sum())} of {finished.size} members are kept"
                raise CardInterrupted(f"interrupted; {kept}: repeat the command to go on") from None
        _remove_old(folder)
        return dataset.assign_attrs(resumed=found[0])

    @property
    def own_features(self) -> FeatureSet | None:
        """The user's feature set; None for the embedded town, where a card may drive elsewhere."""
        return None if self.embedded else self.features

    @property
    def own_drive(self) -> FeatureSet | None:
        """The user's feature set as a drive; None for the embedded town. InputError where it is none."""
        return None if self.embedded else require_drive(self.features, self.source, self.order)

    def record(
        self,
        title: str,
        caption: str,
        seeds: Iterable[int],
        started: float,
        *,
        over: tuple[int, str] | None = None,
        **facts: Any,
    ) -> None:
        """Write `provenance.json`: what every card says of itself, and its own facts.

        Where its intervals are over fewer than `FEW` repetitions, the caption says so.

        `precision` is that of products in training, float32 unless the card says otherwise; `stages` are the seconds of
        each stage, `compile` those of them in which programs were compiled; `code` is the hash of the code that the
        figure depends on.

        Args:
            title: heading on the results page.
            caption: what the reader of the figure needs to know.
            seeds: seeds that finished.
            started: `time.perf_counter()` at the start.
            over: what its intervals are over, how many and a word in the plural; the seeds by default.
            facts: what the card adds, of JSON's types.
        """
        seeds = list(seeds)
        count, word = (len(seeds), "seeds") if over is None else over
        if 1 < count < FEW:
            caption += f" {count} {word}: intervals are wide."
        common: dict[str, Any] = {"title": title, "caption": caption, "preset": self.preset, "precision": "float32"}
        common |= {"seeds": " ".join(map(str, seeds)), "frames": len(self.features.features)}
        common |= {"data": "embedded town" if self.embedded else Path(self.source).name}
        common |= {"stages": _rounded(self.stages.seconds()), "compile": _rounded(self.stages.compiling())}
        if self.card is not None:
            common["code"] = code_hash(self.card)
        everything = provenance(**common | facts, seconds=round(time.perf_counter() - started))
        text = json.dumps(everything, indent=1, ensure_ascii=False)
        (self.out / "provenance.json").write_text(text + "\n")

    @property
    def embedded(self) -> bool:
        """Whether the data are the embedded town, about which the project states expectations."""
        return self.source == "embedded"


def _rounded(seconds: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 1) for name, value in seconds.items()}


def _remove_old(folder: Path) -> None:
    """Remove stores to which nothing was added for a week."""
    for path in folder.glob("*.zarr"):
        with suppress(OSError):
            # The second is what stores of an older version had.
            is_store = (path / "sweep.json").is_file() or (path / "finished" / "zarr.json").is_file()
            added = max(part.stat().st_mtime for part in (path, *path.glob("members")))
            if is_store and time.time() - added > _KEPT_S:
                shutil.rmtree(path)
