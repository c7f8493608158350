"""Find the cards (one file per figure of the paper) and run them with their data, presets and output folders."""

import importlib.util
import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import xarray

import ovibjax
from ovibjax.errors import InputError
from ovibjax.features.frames import MIN_QUERIES, MIN_REFERENCES, FeatureSet, load, require_frames
from ovibjax.report.page import write_page
from ovibjax.report.provenance import provenance
from ovibjax.runtime.cache import cache_folder
from ovibjax.runtime.progress import console, progress_bar
from ovibjax.sweep.engine import Interrupted as SweepInterrupted
from ovibjax.sweep.engine import run
from ovibjax.sweep.layout import digest
from ovibjax.sweep.store import attach
from ovibjax.world.rooms.feature_set import room_features
from ovibjax.world.rooms.room import platform_room
from ovibjax.world.town.feature_set import PAPER_FRAMES, town_features
from ovibjax.world.town.layout import TownConfig

PRESETS = ("smoke", "quick", "full")
_SMOKE_FRAMES = 400
_KEPT_S = 7 * 24 * 3600.0


class Interrupted(KeyboardInterrupt):
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
    """

    name: str
    preset: str
    out: Path
    seed: int
    features: FeatureSet
    source: str
    rank: int | None
    queries: FeatureSet | None = None

    def sweep(self, description: str, fn: Any, axes: Mapping[str, Any], shared: Any, **options: Any) -> xarray.Dataset:
        """`sweep.run`, kept as `kept` says.

        Args:
            description: what the bar says.
            fn: member function.
            axes: values per axis.
            shared: data.
            options: further options of `sweep.run`.

        Returns:
            See `kept`.

        Raises:
            Interrupted: Ctrl-C; finished members are kept.
        """
        return self.kept(description, partial(run, fn, axes, shared, **options))

    def kept(self, description: str, compute: Callable[..., xarray.Dataset]) -> xarray.Dataset:
        """A sweep with a progress bar and a store in the cache folder: an interrupted figure goes on from there.

        Args:
            description: what the bar says.
            compute: the sweep; takes `store` and `on_progress` of `sweep.run`.

        Returns:
            The dataset, complete; attribute `resumed` says how many members an earlier, interrupted run had finished.

        Raises:
            Interrupted: Ctrl-C; finished members are kept.
        """
        folder = cache_folder() / "sweeps"

        def store(config: dict[str, Any]) -> Path:
            return folder / f"{self.name}-{digest(config)[:16]}.zarr"

        found: list[int] = []
        with progress_bar(description, 1) as update:

            def on_progress(done: int, total: int) -> None:
                found.append(done)
                update(done, total)

            try:
                dataset = compute(store=store, on_progress=on_progress)
            except SweepInterrupted as error:
                finished = error.dataset.finished
                kept = f"{int(finished.sum())} of {finished.size} members are kept"
                raise Interrupted(f"interrupted; {kept}: repeat the command to go on") from None
        _remove_old(folder)
        return dataset.assign_attrs(resumed=found[0])

    @property
    def own_features(self) -> FeatureSet | None:
        """The user's feature set; None for the embedded town, where a card may drive elsewhere."""
        return None if self.embedded else self.features

    def record(self, title: str, caption: str, seeds: Iterable[int], started: float, **facts: Any) -> None:
        """Write `provenance.json`: what every card says of itself, and its own facts.

        Args:
            title: heading on the results page.
            caption: what the reader of the figure needs to know.
            seeds: seeds that finished.
            started: `time.perf_counter()` at the start.
            facts: what the card adds, of JSON's types.
        """
        common: dict[str, Any] = {"title": title, "caption": caption, "preset": self.preset}
        common |= {"seeds": " ".join(map(str, seeds)), "frames": len(self.features.features)}
        common |= {"data": "embedded town" if self.embedded else Path(self.source).name}
        everything = provenance(**common | facts, seconds=round(time.perf_counter() - started))
        text = json.dumps(everything, indent=1, ensure_ascii=False)
        (self.out / "provenance.json").write_text(text + "\n")

    @property
    def embedded(self) -> bool:
        """Whether the data are the embedded town, about which the project states expectations."""
        return self.source == "embedded"


def cards_folder() -> Path:
    """Folder of the cards: `sweeps/` of a checkout, or the copy inside an installed wheel."""
    package = Path(ovibjax.__file__).parent
    checkout = package.parent / "sweeps"
    return checkout if (package.parent / "pyproject.toml").exists() and checkout.is_dir() else package / "_sweeps"


def card_names() -> list[str]:
    """Names of the cards that come with the software."""
    return sorted(path.stem for path in cards_folder().glob("*.py") if not path.stem.startswith("_"))


def load_card(path: Path) -> ModuleType:
    """Import a card from its file, without putting its name where other packages could meet it.

    Args:
        path: a Python file with `TITLE` and `run(job)`.

    Returns:
        The module.

    Raises:
        InputError: the file is missing, does not import, or is no card.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such sweep file")
    spec = importlib.util.spec_from_file_location(f"ovibjax._cards.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"{path}: does not import: {type(error).__name__}: {error}") from error
    for name in ("TITLE", "run"):
        if not hasattr(module, name):
            raise InputError(f"{path}: a sweep file defines TITLE and run(job); {name} is missing")
    return module


def takes_queries(card: ModuleType) -> bool:
    """Whether a card works on references and queries of its own instead of one feature set."""
    return bool(getattr(card, "TAKES_QUERIES", False))


def load_pair(data: Sequence[Path], seed: int) -> tuple[FeatureSet, FeatureSet | None, str]:
    """References and queries of somebody, or the references of the first embedded room.

    Args:
        data: two feature sets, or none.
        seed: the embedded room.

    Returns:
        References, queries (None for embedded data), where they are from.

    Raises:
        InputError: unreadable data, too few frames, or two sets that do not match.
    """
    if not data:
        with console.status("rendering a room"):
            return room_features(platform_room("uav", seed))[0], None, "embedded"
    references, queries = (load(path) for path in data)
    require_frames(references, MIN_REFERENCES, str(data[0]))
    require_frames(queries, MIN_QUERIES, str(data[1]))
    if references.features.shape[1:] != queries.features.shape[1:]:
        (m, d), (views, dim) = references.features.shape[1:], queries.features.shape[1:]
        raise InputError(f"{data[1]}: queries have {views} views of dimension {dim}, the references {m} of {d}")
    return references, queries, str(data[0])


def load_features(data: Path | None, preset: str) -> tuple[FeatureSet, str]:
    """The data of a run: somebody's feature set, or the embedded town.

    Args:
        data: a feature set (`.npz` or folder), or None for the embedded town.
        preset: the smoke preset takes a short drive.

    Returns:
        The feature set, and where it is from.

    Raises:
        InputError: unreadable data, or fewer than 200 frames.
    """
    if data is not None:
        with progress_bar(f"reading {data.name}", 1) as update:
            features = load(data, on_frame=lambda done, total: update(done // total))
        require_frames(features, source=str(data))
        return features, str(data)
    frames = _SMOKE_FRAMES if preset == "smoke" else PAPER_FRAMES
    with progress_bar(f"rendering {frames} frames x 5 views", frames) as update:
        return town_features(TownConfig(), frames, on_frames=lambda done, _: update(done)), "embedded"


def reproduce(
    preset: str = "quick",
    only: Sequence[str] = (),
    out: Path = Path("results"),
    data: Sequence[Path] = (),
    backbone: str = "embedded",
    seed: int = 100,
    sweep: Path | None = None,
    rank: int | None = 64,
) -> Path:
    """Run cards and write their figures, tables and claims.

    Args:
        preset: smoke, quick or full.
        only: names of the cards to run; all if empty.
        out: results folder.
        data: a feature set of somebody else's; references and queries for a card that takes them.
        backbone: image backbone for the embedded town.
        seed: first seed.
        sweep: a card of the user's own, run instead.
        rank: coordinates kept per view; None keeps all.

    Returns:
        The results page.

    Raises:
        InputError: bad options or data.
        Interrupted: Ctrl-C.
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r} is not one of {', '.join(PRESETS)}")
    if seed < 0:
        raise InputError(f"seed {seed} is negative; seeds are 0, 1, 2, ...")
    if rank is not None and rank < 1:
        raise InputError(f"rank {rank} is not positive; give the coordinates kept per view, or 0 for all")
    for name in only:
        if name not in card_names():
            raise InputError(f"no figure is called {name!r}; there are: {', '.join(card_names())}")
    if backbone != "embedded":
        raise InputError(
            f"backbone {backbone!r}: the figures embed the town with 'embedded'; write frames with `ovibjax town "
            f"--frames N`, embed them with `ovibjax features --backbone {backbone}`, and pass the file with --data"
        )
    paths = [sweep] if sweep is not None else [cards_folder() / f"{name}.py" for name in (only or card_names())]
    cards = [load_card(path) for path in paths]
    chosen = bool(only or sweep)
    left_out = _unusable(data, paths, cards, chosen)
    usable = [i for i, path in enumerate(paths) if path.stem not in left_out]
    paths, cards = [paths[i] for i in usable], [cards[i] for i in usable]
    pair = all(takes_queries(card) for card in cards)
    # Whatever can be refused is refused before anything is rendered, and a refusal leaves no folder behind.
    if not data:
        _check_writable(out)
    queries = None
    try:
        if pair:
            features, queries, source = load_pair(data, seed)
        else:
            features, source = load_features(data[0] if data else None, preset)
    except KeyboardInterrupt:
        raise Interrupted("interrupted while reading the data; nothing was written") from None
    _check_writable(out)
    for name in left_out:
        console.print(f"{name}: left out, it takes references and queries (--only {name} --data REF QUERY)")
    refused: list[str] = []
    for path, card in zip(paths, cards, strict=True):
        started = time.perf_counter()
        folder = out / path.stem
        folder.mkdir(exist_ok=True)
        console.print(f"[bold]{card.TITLE}[/bold] ({preset} preset) -> {folder}")
        job = Job(path.stem, preset, folder, seed, features, source, rank, queries)
        try:
            card.run(job)
        except Interrupted:  # the card wrote what it had
            write_page(out)
            raise
        except KeyboardInterrupt:
            _drop_if_empty(folder)
            raise Interrupted(f"interrupted in {path.stem}; finished figures are in {out}") from None
        except InputError as error:
            _drop_if_empty(folder)
            if not data or chosen:
                raise
            # Of all figures, those that somebody's data do not allow are named, and the others made.
            console.print(f"{path.stem}: left out, {error}", highlight=False)
            refused.append(path.stem)
            continue
        console.print(f"{path.stem}: {time.perf_counter() - started:.0f} s")
        write_page(out)
    if len(refused) == len(paths):
        raise InputError(f"{source}: allows no figure; the reasons are above")
    return out / "README.md"


def _unusable(data: Sequence[Path], paths: Sequence[Path], cards: Sequence[ModuleType], chosen: bool) -> list[str]:
    """Names of cards that the data do not allow; refuses data that cards chosen by the user cannot use."""
    paired = [path.stem for path, card in zip(paths, cards, strict=True) if takes_queries(card)]
    if len(data) > 2:
        raise InputError(f"--data takes one feature set, or references and queries; {len(data)} were given")
    if len(data) == 2 and (not chosen or len(paired) < len(cards)):
        raise InputError("--data with references and queries is for real_scene; add --only real_scene")
    if len(data) != 1:
        return []
    if chosen and paired:
        raise InputError(f"{paired[0]} takes references and queries: --only {paired[0]} --data REF QUERY")
    return paired


def _remove_old(folder: Path) -> None:
    """Remove finished sweeps begun more than a week ago; unfinished ones are somebody's work."""
    for path in folder.glob("*.zarr"):
        if time.time() - path.stat().st_mtime < _KEPT_S:
            continue
        with suppress(InputError, OSError):
            if attach(path).finished().all():
                shutil.rmtree(path)


def _check_writable(out: Path) -> None:
    """Fail before the work, not after it."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"{out}: cannot write there ({error.strerror}); choose another folder with --out") from error


def _drop_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        shutil.rmtree(folder)
