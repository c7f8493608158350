"""A halving as it runs: rung after rung, what is missing of each, and the states in between."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray

from ovibjax.errors import InputError
from ovibjax.runtime.progress import console
from ovibjax.sweep.arrange import each_batch, require_threads, settled
from ovibjax.sweep.asked import expect, expected
from ovibjax.sweep.in_memory import InMemory
from ovibjax.sweep.ladder import Points, best_points
from ovibjax.sweep.staged import STATE, STEPS
from ovibjax.sweep.states import States
from ovibjax.sweep.store import Store
from ovibjax.sweep.work import Work

_WORTH_SAYING_BYTES = 100 << 20


class Brought:
    """States that members bring along to a rung."""

    def __init__(self, states: States, steps: int, names: Sequence[str]) -> None:
        """Bring states with so many steps behind them, of members by name."""
        self._states, self._steps, self._names = states, steps, names

    def of(self, members: np.ndarray) -> dict[str, Any]:
        """Their leaves [n, ...]."""
        names = [self._names[member] for member in members.tolist()]
        found = {name: self._states.find(self._steps, name) for name in set(names)}
        whole = [leaves for leaves in (found[name] for name in names) if leaves is not None]
        if len(whole) < len(names):
            raise InputError("a state that was there a moment ago is gone or damaged; repeat the command")
        return {STATE: tuple(np.stack(leaves) for leaves in zip(*whole, strict=True))}


@dataclass
class Plan:
    """What a halving is made of.

    Attributes:
        asked: the points.
        cuts: steps behind a member at the end of each rung.
        works: the work of each rung, on all points.
        outputs: shape and type of what is judged.
        names: of all members, whatever they are trained for.
        states: where members of a rung leave their states for the next.
    """

    asked: Points
    cuts: tuple[int, ...]
    works: list[Work]
    outputs: dict[str, Any]
    names: list[str]
    states: States

    def settle(self, held: dict[str, Any] | None, lanes: int | None) -> None:
        """Batch members as a store was begun with it, in all rungs alike; see `arrange.settled`."""
        first = settled(self.works[0], held, np.arange(self.works[0].grid.size), lanes)
        self.works = [first, *(replace(work, batch=first.batch, threads=first.threads) for work in self.works[1:])]

    def members(self, points: np.ndarray) -> np.ndarray:
        """[n] flat indices of the members of some points."""
        grid = self.works[0].grid
        every = np.arange(grid.size).reshape(grid.shape)
        return np.sort(np.take(every, points, axis=grid.group_of(STEPS)).ravel())


class Climb:
    """One way up the rungs."""

    def __init__(self, plan: Plan, kept: Store | InMemory, on_progress: Callable[[int, int], None]) -> None:
        """Climb with what a store has, and add to it what it lacks."""
        self._plan, self._kept, self._on_progress = plan, kept, on_progress
        self._reached: list[np.ndarray] = []
        self._done = self._total = 0
        self._writes = False

    def run(self, score: str, factor: int) -> bool:
        """Finish every rung.

        Args:
            score: the output whose mean decides.
            factor: one point in so many goes on.

        Returns:
            False if Ctrl-C came before the last member.

        Raises:
            InputError: the store cannot be used or written.
        """
        plan = self._plan
        keep = [max(1, len(plan.asked) // factor**rung) for rung in range(len(plan.cuts))]
        points = np.arange(len(plan.asked))
        self._total = sum(keep) * plan.asked.seeds
        try:
            for rung in range(len(plan.cuts)):
                self._reached.append(points)
                self._finish(rung, points)
                if rung + 1 < len(plan.cuts):
                    grid = plan.asked.trained(points, np.full(len(points), plan.cuts[rung]))
                    dim = grid.dims[grid.group_of(STEPS)]
                    points = points[best_points(self._kept.dataset(grid), score, dim, keep[rung + 1])]
                self._tidy(rung, points)
                if not len(points):
                    break
        except KeyboardInterrupt:
            return False
        self._end()
        return True

    def dataset(self) -> xarray.Dataset:
        """All members of the rungs that were reached."""
        plan, reached = self._plan, self._reached
        cuts = plan.cuts[: len(reached)]
        grid = plan.asked.trained(np.concatenate(reached), np.repeat(cuts, [len(points) for points in reached]))
        dataset = self._kept.dataset(grid)
        begun = (0, *cuts[:-1])
        steps = sum(len(points) * (cut - first) for points, first, cut in zip(reached, begun, cuts, strict=True))
        dataset.attrs["rungs"] = [
            {"steps": cut, "points": len(points)} for points, cut in zip(reached, cuts, strict=True)
        ]
        dataset.attrs["asked"] = self._total
        dataset.attrs["spent"] = steps / (len(plan.asked) * plan.cuts[-1])
        return dataset

    def _finish(self, rung: int, points: np.ndarray) -> None:
        """Compute and keep what is missing of a rung."""
        plan, work = self._plan, self._plan.works[rung]
        members = plan.members(points)
        data = [work.digests[i] for i in work.data_of(np.arange(work.grid.size))]
        missing = np.intersect1d(self._kept.missing(work.grid, data), members)
        if len(missing):
            self._begin_writing(work)
            missing = np.intersect1d(self._kept.missing(work.grid, data), members)
        if len(missing):
            self._kept.announce(plan.asked.trained(points, np.full(len(points), plan.cuts[rung])))
        self._done += len(members) - len(missing)
        self._on_progress(self._done, self._total)
        for rows in self._train(rung, missing):
            self._kept.add(rows)
            self._done += len(rows)
            self._on_progress(self._done, self._total)

    def _train(self, rung: int, members: np.ndarray) -> Any:
        """Rows of members of a rung; states that they go on from and that are not there are computed first."""
        plan, work = self._plan, self._plan.works[rung]
        steps = plan.cuts[rung]
        if rung:
            there = plan.cuts[rung - 1]
            lost = [m for m in members.tolist() if plan.states.find(there, plan.names[m]) is None]
            for _ in self._train(rung - 1, np.array(lost, int)):
                pass

        def one(lot: np.ndarray) -> np.ndarray:
            found, outputs = work.outputs(lot)
            leaves = [outputs.pop(name) for name in work.form.names() if name in outputs]
            for i, member in enumerate(found.tolist()) if leaves else ():
                plan.states.keep(steps, plan.names[member], [leaf[i] for leaf in leaves])
            return work.rows(found, outputs)

        return each_batch(work, work.lots(members), one)

    def _begin_writing(self, work: Work) -> None:
        """Once, before the first member is computed."""
        if self._writes:
            return
        require_threads(work, self._kept.path)
        self._kept.lock()
        self._writes = True
        path = self._kept.path
        if path is not None:
            held = 0 if self._kept.rows is None else len(self._kept.rows)
            expect(path, held + self._total)
            size = work.form.nbytes * work.grid.size
            if size > _WORTH_SAYING_BYTES:
                where = f"{path}/states takes up to {size / 1e9:.1f} GB until this is done"
                console.print(f"{where}: the states of {work.grid.size} members", highlight=False)

    def _tidy(self, rung: int, points: np.ndarray) -> None:
        """Remove the states of a rung but of the points that go on, and of the rung before, which has ended."""
        if self._writes:
            plan = self._plan
            plan.states.leave(plan.cuts[rung], {plan.names[member] for member in plan.members(points)})
            if rung:
                plan.states.leave(plan.cuts[rung - 1])

    def _end(self) -> None:
        """Remove what was there for the time being, that of a command which was killed at its very end too."""
        plan, path = self._plan, self._kept.path
        if not self._writes and (plan.states.any() or expected(path)):
            with suppress(InputError):  # another command is at it, or the disk cannot be written: it stays
                self._kept.lock()
                self._writes = True
        if self._writes:
            plan.states.remove()
            expect(path, None)
