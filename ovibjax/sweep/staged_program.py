"""The compiled programs of a member function in stages: each of one size, whatever number of steps is asked for."""

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ovibjax.sweep.program import Program, by_member
from ovibjax.sweep.staged import STATE, Form, Staged


class Stage(NamedTuple):
    """A part of the steps.

    Attributes:
        first: number of the first one; at 0 the state is begun, later members bring theirs along.
        last: number of the one after the last.
        keep: whether the state is wanted beside the outputs.
    """

    first: int
    last: int
    keep: bool


class StagedProgram:
    """What `Program` is, of three stages; states stay on the device from one to the next.

    Attributes:
        text_hash: hash of the texts of all of them.
        key: what tells them from all other programs of this process.
    """

    def __init__(
        self, staged: Staged, form: Form, stage: Stage, points: Any, devices: int, lower: Callable[..., Program]
    ) -> None:
        """Lower every stage.

        Args:
            staged: the function.
            form: what its state is made of.
            stage: the steps to take.
            points: points of a batch, or their shapes.
            devices: that share a batch.
            lower: makes a program of a member function, the function that it calls, points, and what is the same for
                all members.
        """
        self._form, self._stage = form, stage
        n, place = len(jax.tree.leaves(points)[0]), by_member(devices)
        leaves = [jax.ShapeDtypeStruct((n, *leaf.shape), leaf.dtype, sharding=place) for leaf in form.leaves]
        state = {STATE: tuple(leaves)}
        points = {name: values for name, values in points.items() if name != STATE}
        self._begin = lower(form.begin(staged), staged.begin, points)
        self._go_on = lower(form.go_on(staged), staged.go_on, points | state, np.int32(0), np.int32(0))
        self._judge = lower(form.judge(staged), staged.judge, points | state)
        parts = (self._begin, self._go_on, self._judge)
        self.text_hash = hashlib.sha256("".join(part.text_hash for part in parts).encode()).hexdigest()
        self.key = " ".join(part.key for part in parts)

    def __call__(self, points: dict[str, Any], shared: Any) -> dict[str, np.ndarray]:
        """Compute one batch.

        Args:
            points: a value of each axis per member, and the leaves of its state unless it is begun.
            shared: data.

        Returns:
            Outputs per member on the host, with the leaves of the state if they are wanted.
        """
        outputs, state = self._run(points, shared)
        return jax.device_get({**outputs, **(state if self._stage.keep else {})})

    def whole(self, points: dict[str, Any], shared: Any) -> dict[str, np.ndarray]:
        """The same, with the leaves of the state."""
        outputs, state = self._run(points, shared)
        return jax.device_get({**outputs, **state})

    def _run(self, points: dict[str, Any], shared: Any) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        def carried(state: dict[str, jax.Array]) -> dict[str, Any]:
            return {**points, STATE: tuple(state[name] for name in self._form.names())}

        first, last, _ = self._stage
        given = points if first else carried(self._begin.on_device(points, shared))
        state = self._go_on.on_device(given, shared, np.int32(first), np.int32(last))
        return self._judge.on_device(carried(state), shared), state
