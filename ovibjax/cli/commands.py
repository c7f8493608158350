"""The commands, `ovibjax reproduce`, `sweep`, `show`, `best`, `replay`, `edge` and others, and their options."""

import difflib
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from importlib.metadata import version
from typing import Annotated

import tyro

from ovibjax import __version__
from ovibjax.cli.best import Best
from ovibjax.cli.doctor import Doctor
from ovibjax.cli.edge import Edge
from ovibjax.cli.edge_drive import EdgeDrive
from ovibjax.cli.edge_export import EdgeExport
from ovibjax.cli.edge_report import EdgeReport
from ovibjax.cli.edge_serve import EdgeServe
from ovibjax.cli.features import Features
from ovibjax.cli.replay import Replay
from ovibjax.cli.report import Report
from ovibjax.cli.reproduce import Reproduce
from ovibjax.cli.show import Show
from ovibjax.cli.sweep_merge import SweepMerge, SweepUpgrade
from ovibjax.cli.sweep_run import SweepRun
from ovibjax.cli.sweep_system import SweepSystem
from ovibjax.cli.sweep_train import SweepTrain
from ovibjax.cli.town import Town
from ovibjax.errors import InputError
from ovibjax.runtime.cache import keep_compiled_programs


@dataclass(frozen=True)
class Sweep:
    """Compute a grid of members in one compiled program, into a store that grows and survives a kill."""

    what: Annotated[
        Annotated[SweepTrain, tyro.conf.subcommand("train")]
        | Annotated[SweepSystem, tyro.conf.subcommand("system")]
        | Annotated[SweepRun, tyro.conf.subcommand("run")]
        | Annotated[SweepMerge, tyro.conf.subcommand("merge")]
        | Annotated[SweepUpgrade, tyro.conf.subcommand("upgrade")],
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
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Features, tyro.conf.subcommand("features")]
    | Annotated[Town, tyro.conf.subcommand("town")]
    | Annotated[Edge, tyro.conf.subcommand("edge")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
)

_OPTIONS: dict[tuple[str, ...], type] = {
    ("reproduce",): Reproduce,
    ("sweep", "train"): SweepTrain,
    ("sweep", "system"): SweepSystem,
    ("sweep", "run"): SweepRun,
    ("sweep", "merge"): SweepMerge,
    ("sweep", "upgrade"): SweepUpgrade,
    ("show",): Show,
    ("best",): Best,
    ("report",): Report,
    ("replay",): Replay,
    ("features",): Features,
    ("town",): Town,
    ("edge", "export"): EdgeExport,
    ("edge", "serve"): EdgeServe,
    ("edge", "drive"): EdgeDrive,
    ("edge", "report"): EdgeReport,
    ("doctor",): Doctor,
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


def run(arguments: Sequence[str]) -> None:
    """Run a command line.

    Args:
        arguments: without the program's name.

    Raises:
        InputError: bad input, said in one line.
        SystemExit: from the option parser: help was asked for, or an option does not parse.
        KeyboardInterrupt: Ctrl-C; the message says what is kept.
    """
    if "jax" not in sys.modules:
        keep_compiled_programs()
    if list(arguments) == ["--version"]:
        print(f"ovibjax {__version__}, jax {version('jax')}, Python {platform.python_version()}")
        return
    check_options(arguments)
    command: Command = tyro.cli(
        Command,
        prog="ovibjax",
        description="Task-oriented communications for edge-assisted multi-view localization, for people who sweep.",
        args=list(arguments),
    )
    command.run()
