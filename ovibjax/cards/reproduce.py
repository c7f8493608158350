"""Run cards with their data, presets and output folders: the figures, tables and claims of the paper."""

import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import ModuleType

from ovibjax.cards.catalog import card_names, card_paths, load_card, takes_queries
from ovibjax.cards.expected_time import in_words, remaining_s
from ovibjax.cards.job import PRESETS, CardInterrupted, Job, NotHere
from ovibjax.cards.loading import load_features, load_pair
from ovibjax.cards.paper_parts import PARTS
from ovibjax.cards.result_pages import write_result_pages
from ovibjax.errors import InputError
from ovibjax.features.frames import FeatureSet
from ovibjax.features.sequence import sequence_of
from ovibjax.report.page import write_page
from ovibjax.runtime.outputs import require_place
from ovibjax.runtime.progress import console
from ovibjax.runtime.stage_times import Stages

Refusals = tuple[type[InputError], ...]


# Its parameters are the options of the command.
def reproduce(
    preset: str = "quick",
    only: Sequence[str] = (),
    out: Path | None = None,
    data: Sequence[Path] = (),
    seed: int = 100,
    sweep: Path | None = None,
    rank: int | None = 64,
    order: str | None = None,
) -> Path:
    """Run cards and write their figures, tables and claims.

    Args:
        preset: smoke, quick or full.
        only: names of the cards to run; all if empty.
        out: results folder; by default `results`, or `results-PRESET` beside it, see `default_folder`.
        data: a feature set of somebody else's; references and queries for a card that takes them.
        seed: first seed.
        sweep: a card of the user's own, run instead.
        rank: coordinates kept per view; None keeps all.
        order: what the frames of `data` are, one of `features.sequence.ORDERS`; None as they look.

    Returns:
        The web page of results, beside which is one in Markdown.

    Raises:
        InputError: bad options or data.
        CardInterrupted: Ctrl-C.
    """
    _check_options(preset, only, seed, rank)
    paths = [sweep] if sweep is not None else card_paths(only or card_names())
    files = {path.stem: path for path in paths}
    cards = {name: load_card(path) for name, path in files.items()}
    chosen = bool(only or sweep)
    left_out = _left_out(data, cards, chosen)
    cards = {name: card for name, card in cards.items() if name not in left_out}
    out = default_folder(preset) if out is None else out
    # Whatever can be refused is refused before anything is rendered, and a refusal leaves no folder behind.
    require_place(out)
    if not data:
        _check_writable(out)
    loading = Stages()
    with loading.stage("features" if data else "render"):
        features, queries = _load(data, cards, preset, seed)
    _print_stages("data", loading)
    source = str(data[0]) if data else "embedded"
    if data:
        looks = sequence_of(features.positions_m, features.scene_id).line()
        console.print(f"{source}: {looks}", markup=False, highlight=False)
    _check_writable(out)
    for name in left_out:
        console.print(f"{name}: left out, it takes references and queries (--only {name} --data REF QUERY)")
    job = partial(Job, preset=preset, seed=seed, features=features, source=source, rank=rank, queries=queries)
    # Of all figures, those that this machine or somebody's data do not allow are named, and the others made.
    lenient = () if chosen else (InputError,) if data else (NotHere,)
    if not _run_cards(cards, lambda name: job(name=name, out=out / name, order=order, card=files[name]), lenient):
        raise InputError(f"{source}: allows no figure; the reasons are above")
    return write_result_pages(out)


def default_folder(preset: str) -> Path:
    """Where results go by default: `results`, or beside it where it holds figures of a longer preset.

    A checkout's `results/` is a `full` run, and a few minutes of `quick` must not replace it without a word.

    Args:
        preset: the preset about to be run.

    Returns:
        `results` or `results-PRESET`; the second is said.
    """
    usual = Path("results")
    longer = PRESETS[PRESETS.index(preset) + 1 :]
    for section in sorted(usual.glob("*/provenance.json")):
        with suppress(OSError, ValueError):
            held = str(json.loads(section.read_text()).get("preset", "")).split(" ")[0]
            if held in longer:
                beside = usual.with_name(f"results-{preset}")
                console.print(
                    f"{usual}/ holds figures of the {held} preset; these go to {beside}/ (--out {usual} replaces them)",
                    markup=False,
                    highlight=False,
                )
                return beside
    return usual


def _check_options(preset: str, only: Sequence[str], seed: int, rank: int | None) -> None:
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r} is not one of {', '.join(PRESETS)}")
    if seed < 0:
        raise InputError(f"seed {seed} is negative; seeds are 0, 1, 2, ...")
    if rank is not None and rank < 1:
        raise InputError(f"rank {rank} is not positive; give the coordinates kept per view, or 0 for all")
    for name in only:
        if name not in card_names():
            raise InputError(f"no figure is called {name!r}; there are: {', '.join(card_names())}")


def _left_out(data: Sequence[Path], cards: Mapping[str, ModuleType], chosen: bool) -> list[str]:
    """Names of cards that the data do not allow; refuses data that cards chosen by the user cannot use."""
    paired = [name for name, card in cards.items() if takes_queries(card)]
    if len(data) > 2:
        raise InputError(f"--data takes one feature set, or references and queries; {len(data)} were given")
    if len(data) == 2 and (not chosen or len(paired) < len(cards)):
        raise InputError("--data with references and queries is for real_scene; add --only real_scene")
    if len(data) != 1:
        return []
    if chosen and paired:
        raise InputError(f"{paired[0]} takes references and queries: --only {paired[0]} --data REF QUERY")
    return paired


def _load(
    data: Sequence[Path], cards: Mapping[str, ModuleType], preset: str, seed: int
) -> tuple[FeatureSet, FeatureSet | None]:
    """Features, and queries if all cards take them."""
    try:
        if all(takes_queries(card) for card in cards.values()):
            return load_pair(data, seed)
        return load_features(data[0] if data else None, preset), None
    except KeyboardInterrupt:
        raise CardInterrupted("interrupted while reading the data; nothing was written") from None


def _run_cards(cards: Mapping[str, ModuleType], job: Callable[[str], Job], lenient: Refusals) -> bool:
    """Run cards, and after each say how long the rest will take; False if the data allow none of them."""
    seen_s: dict[str, float] = {}
    for name, card in cards.items():
        started = time.perf_counter()
        if _run_card(card, one := job(name), lenient):
            seen_s[name] = time.perf_counter() - started
        left = list(cards)[list(cards).index(name) + 1 :]
        remaining = remaining_s(one.preset, seen_s, left) if left else None
        if remaining is not None:
            console.print(f"{len(cards) - len(left)} of {len(cards)} figures, {in_words(remaining)} left")
    return bool(seen_s)


def _run_card(card: ModuleType, job: Job, lenient: Refusals) -> bool:
    """Run one card into its folder; False if the data do not allow it, which is raised unless it is `lenient`."""
    results = job.out.parent
    job.out.mkdir(exist_ok=True)
    console.print(f"[bold]{card.TITLE}[/bold] ({job.preset} preset) -> {job.out}")
    try:
        with job.stage("other"):
            card.run(job)
    except CardInterrupted:  # the card wrote what it had
        write_result_pages(results)
        raise
    except KeyboardInterrupt:
        _drop_if_empty(job.out)
        raise CardInterrupted(f"interrupted in {job.name}; finished figures are in {results}") from None
    except InputError as error:
        _drop_if_empty(job.out)
        if not isinstance(error, lenient):
            raise
        console.print(f"{job.name}: left out, {error}", highlight=False)
        return False
    _print_stages(job.name, job.stages)
    write_page(results, PARTS)
    return True


def _print_stages(name: str, stages: Stages) -> None:
    """How long something took, and a line per stage."""
    console.print(f"{name}: {sum(stages.seconds().values()):.0f} s", *stages.lines(), sep="\n  ", highlight=False)


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
