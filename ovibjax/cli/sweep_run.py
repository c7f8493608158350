"""The command `ovibjax sweep run`: a function of one's own at every point of a grid."""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ovibjax.cli.file_axes import asked_axes, drawn_axes
from ovibjax.cli.options import (
    Counted,
    executor_of,
    finished_line,
    kept_in,
    require_positive,
    require_store,
    shard_of,
)
from ovibjax.cli.processor import settle
from ovibjax.cli.search import HalvingOptions, SearchOptions, halved_line
from ovibjax.errors import InputError
from ovibjax.runtime.progress import console, progress_bar

if TYPE_CHECKING:
    import xarray

    from ovibjax.sweep.engine import Executor
    from ovibjax.sweep.from_file import SweepFile
    from ovibjax.sweep.program import MemberFn
    from ovibjax.sweep.staged import Staged


@dataclass(frozen=True)
class SweepRun:
    """Compute a function of your own at every point of a grid: one compiled program, a store that survives a kill.

    FILE is a Python file. It defines axes, values by name, and member, a function that jax can compile:

        axes = {"rate": [0.1, 0.5, 1.0], "seed": range(5)}

        def member(key, point, shared):
            return {"drawn": point["rate"] * jax.random.normal(key)}

    Every combination of the values is a member. A point holds one value per axis, names as their place in the list of
    FILE; the key follows the axis seed; arrays by name come back. FILE may also define shared() or shared(axes), which
    loads arrays for all members (or ovibjax.sweep.Along, for an entry per value of an axis); units, dims and coords of
    outputs; zipped, groups of axes that advance together; and settings, kept in the store and compared.

    For --halving a member must be such that it can be cut. In its place FILE defines begin(key, point, shared), which
    returns a state; go_on(key, point, shared, state, first, last), which returns it after the steps from first to last;
    judge(key, point, shared, state), which returns arrays by name; steps, of the whole; and score, one of the names.

    Finished members are written to OUT as they come: after Ctrl-C, a crash or a kill, the same command goes on where it
    stopped, and one with more values adds what is missing. Another function, other data or settings on the same OUT are
    refused with what differs.

    Example: ovibjax sweep run examples/digits.py --axis l2=1e-4,1e-2 seed=0:20 --out runs/digits.zarr
    """

    file: tyro.conf.Positional[Path]
    """The Python file."""
    out: Path
    """The store, a folder (NAME.zarr by custom); members that it has are not computed again."""
    axis: tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]] = ()
    """Values in place of the file's, NAME=VALUE,VALUE; seed=0:5 is 0 1 2 3 4; a range as rate=log:0.1:3 for --sobol."""
    # The default is frozen, so that instances may share it.
    search: tyro.conf.OmitArgPrefixes[SearchOptions] = SearchOptions()  # noqa: RUF009
    """How points are drawn where an axis is a range."""
    halving: tyro.conf.OmitArgPrefixes[HalvingOptions] = HalvingOptions()  # noqa: RUF009
    """Whether only the best points are trained to the end."""
    score: str | None = None
    """The output by which --halving chooses, the lowest being best; the file's score by default."""
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
    lanes: int | None = None
    """Members vmapped together, from cache and memory by default; small members may gain from more, such as 4."""
    traceback: bool = False
    """Show in full where in FILE an error came from."""

    def run(self) -> None:
        """Run the command."""
        settle(self.out, self.threads, self.devices)
        require_positive(self, "lanes")
        self.halving.check(self.shard, self.on)
        if self.score is not None and self.halving.halving is None:
            raise InputError(f"--score {self.score}: it is for --halving")
        shard_of(self.shard)  # misspelt, it is refused before the data are loaded
        require_store(self.out)
        executor = executor_of(self.on, self.address)
        try:
            with _importing_beside(self.file):
                self._sweep(executor)
        except InputError as error:
            if self.traceback and error.__cause__ is not None:
                traceback.print_exception(error.__cause__)
            raise

    def _sweep(self, executor: "Executor | None") -> None:
        import jax

        from ovibjax.sweep.engine import run
        from ovibjax.sweep.from_file import data_of, member_of, read_sweep_file
        from ovibjax.sweep.grid import make_grid
        from ovibjax.sweep.halving import halve

        file = read_sweep_file(self.file)
        axes, zipped = drawn_axes(
            asked_axes([entry for entries in self.axis for entry in entries], file), file, self.search
        )
        make_grid(axes, zipped)  # refused before the data are loaded
        shared = data_of(file, axes)
        fn, options = member_of(file), {**file.options, "zipped": zipped}

        def compute(store: Path) -> "xarray.Dataset":
            common = {**options, "store": store, "lanes": self.lanes, "on_progress": counted}
            if self.halving.halving is None:
                return run(fn, axes, shared, **common, shard=shard_of(self.shard), executor=executor)
            staged, score = self._staged(fn, file)
            by: dict[str, Any] = {"score": score, "factor": self.halving.halving, "rungs": self.halving.rungs}
            return halve(staged, axes, shared, **by, **common)

        with progress_bar("computing", 1) as update:
            counted = Counted(update)
            try:
                dataset, store = kept_in(self.out, self.keep_both, compute)
            except jax.errors.JaxRuntimeError as error:  # out of memory, a host function that raised
                raise InputError(
                    f"{self.file}: the program failed as it ran ({_gist(error)}); finished members are kept"
                ) from error
        if self.halving.halving is not None:
            console.print(halved_line(dataset, store))
            return
        diverged = int(dataset.diverged.sum())
        line = finished_line(dataset, counted, f", {diverged} diverged" if diverged else "")
        console.print(f"{line}: {store}\nlook at them: ovibjax show {store}")

    def _staged(self, fn: "MemberFn", file: "SweepFile") -> "tuple[Staged, str]":
        """The file's function as one that can be cut, and the output that chooses."""
        from ovibjax.sweep.staged import Staged

        if not isinstance(fn, Staged):
            raise InputError(
                f"{file.path}: member cannot be cut; for --halving define begin, go_on, judge and steps in its place"
            )
        score = self.score or file.score
        if score is None:
            raise InputError(f"{file.path}: say by which output --halving chooses: score = NAME there, or --score")
        return fn, score


def _gist(error: Exception) -> str:
    """What a failed program says: the end of a host function's traceback, or the first line."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[-1 if "Traceback" in lines[0] else 0].strip()[:300]


@contextmanager
def _importing_beside(file: Path) -> Iterator[None]:
    """Modules beside the file can be imported, as when Python runs it."""
    folder = str(file.absolute().parent)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
