"""The command line: `ovibjax reproduce`, `sweep`, `show`, `best`, `replay`, `features` and `town`.

The only place, with the tests' `conftest.py`, where process-wide settings are made.
"""

import difflib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ovibjax.cli.features import Features
from ovibjax.cli.replay import Replay
from ovibjax.cli.sweep import Show, SweepTrain
from ovibjax.cli.system import Best, SweepSystem
from ovibjax.errors import InputError
from ovibjax.runtime.cache import keep_compiled_programs
from ovibjax.runtime.progress import console


@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's figures and tables; without options, all of them on the embedded town.

    Figures, tables (CSV) and judged claims (JSON) are written to OUT/<figure>/, and OUT/README.md shows them all.
    Rendering and embedding the town is done once and cached (folder: OVIBJAX_CACHE, or the user's cache).
    """

    preset: Literal["smoke", "quick", "full"] = "quick"
    """smoke: seconds, to see that it runs; quick: minutes; full: what the repository's results/ holds."""
    only: tuple[str, ...] = ()
    """Names of the figures to make, e.g. scalable_compression; all by default."""
    out: Path = Path("results")
    """Results folder; made if missing."""
    data: tuple[Path, ...] = ()
    """Your own feature set: a .npz file, or a folder view_features/<Camera>/<frame>.npz (keys feature, position).
    For real_scene two of them, references and queries: --only real_scene --data REF QUERY."""
    backbone: str = "embedded"
    """Image backbone of the embedded town."""
    seed: int = 100
    """First seed; a figure over n seeds uses SEED ... SEED+n-1. Seeds below 100 are for tuning."""
    rank: int = 64
    """Principal coordinates kept per view (fitted on training frames); 0 keeps the full dimension, slower."""
    sweep: Path | None = None
    """A sweep file of your own (a Python file with TITLE and run(job)), run instead of the figures."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.cards.reproduce import reproduce

        if self.backbone != "embedded":
            raise InputError(
                f"backbone {self.backbone!r}: the figures embed the town with 'embedded'; write frames with "
                f"`ovibjax town --frames N`, embed them with `ovibjax features --backbone {self.backbone}`, "
                "and pass the file with --data"
            )
        rank = self.rank if self.rank != 0 else None
        page = reproduce(self.preset, self.only, self.out, self.data, self.seed, self.sweep, rank)
        console.print(f"results: {page}")


@dataclass(frozen=True)
class TownCommand:
    """Draw the embedded town: a contact sheet, and on request frames in the released data set's folder layout."""

    out: Path
    """Folder for contact_sheet.png and the frames; made if missing."""
    frames: int = 0
    """Frames to write as rgb/ depth/ semantic/ metadata/ calibration/ (400 x 300, five cameras); none by default."""
    seed: int = 5
    """The town; another seed is another town."""
    route: int = 0
    """The drive through it."""

    def run(self) -> None:
        """Run the command."""
        from ovibjax.runtime.progress import progress_bar
        from ovibjax.world.town.files import contact_sheet, write_frames
        from ovibjax.world.town.layout import TownConfig

        for name, value in (("frames", self.frames), ("seed", self.seed), ("route", self.route)):
            if value < 0:
                raise InputError(f"--{name} {value} is negative")
        config = TownConfig(seed=self.seed)
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            with console.status("drawing the contact sheet"):
                contact_sheet(config, self.out / "contact_sheet.png")
        except OSError as error:
            raise InputError(
                f"{self.out}: cannot write there ({error.strerror}); choose another folder with --out"
            ) from error
        console.print(f"contact sheet: {self.out / 'contact_sheet.png'}")
        if self.frames:
            with progress_bar(f"writing {self.frames} frames", self.frames) as update:
                write_frames(config, self.out, self.frames, self.route, on_frame=lambda done, _: update(done))
            console.print(f"frames: {self.out}")


@dataclass(frozen=True)
class Sweep:
    """Compute a grid of members in one compiled program, into a store that survives a kill."""

    what: Annotated[
        Annotated[SweepTrain, tyro.conf.subcommand("train")] | Annotated[SweepSystem, tyro.conf.subcommand("system")],
        tyro.conf.arg(name=""),
    ]
    """What to do at every point."""

    def run(self) -> None:
        """Run the command."""
        self.what.run()


Command = (
    Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Best, tyro.conf.subcommand("best")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Features, tyro.conf.subcommand("features")]
    | Annotated[TownCommand, tyro.conf.subcommand("town")]
)

_OPTIONS: dict[tuple[str, ...], type] = {
    ("reproduce",): Reproduce,
    ("sweep", "train"): SweepTrain,
    ("sweep", "system"): SweepSystem,
    ("show",): Show,
    ("best",): Best,
    ("replay",): Replay,
    ("features",): Features,
    ("town",): TownCommand,
}


def _option_names(command: type) -> list[str]:
    """Options of a command, those of a group it includes among them."""
    names: list[str] = []
    for field in fields(command):
        group: object = field.default
        if is_dataclass(group) and not isinstance(group, type):
            names += [part.name for part in fields(group)]
        else:
            names.append(field.name)
    return [name.replace("_", "-") for name in names]


def check_options(arguments: Sequence[str]) -> None:
    """Refuse a misspelt option in one line that names the nearest one.

    Args:
        arguments: the command line without the program's name.

    Raises:
        InputError: an option that the command does not have.
    """
    for words, command in _OPTIONS.items():
        if tuple(arguments[: len(words)]) != words:
            continue
        known = ["help", *_option_names(command)]
        for argument in arguments[len(words) :]:
            name = argument[2:].partition("=")[0].replace("_", "-")
            if argument.startswith("--") and name.removeprefix("no-") not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean --{near[0]}?" if near else f"there are --{', --'.join(known)}"
                raise InputError(f"--{name}: {' '.join(words)} has no such option; {hint}")


def main() -> None:
    """Entry point of the console script; bad input is one line and exit code 2."""
    try:
        if "jax" not in sys.modules:
            keep_compiled_programs()
        check_options(sys.argv[1:])
        command: Command = tyro.cli(
            Command,
            prog="ovibjax",
            description="Task-oriented communications for edge-assisted multi-view localization, for people who sweep.",
        )
        command.run()
    except InputError as error:
        print(f"ovibjax: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt as error:
        print(f"ovibjax: {error or 'interrupted'}", file=sys.stderr)
        sys.stderr.flush()
        # Compiled programs still running in worker threads cannot be stopped; do not wait for them.
        os._exit(130)
