"""Member functions that can be cut: begun, gone on with and judged, at any of their cuts or all in one go.

Each stage is a program of its own, and how many steps it takes is a number that it is given: whoever asks, and wherever
a training is cut, the same machine code computes it and gives the same bits.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ovibjax.errors import InputError

STEPS = "steps"
"""The axis that says how long a member was trained when it was judged."""

STATE = "~"
"""Entry of points and outputs that holds the leaves of a state; no axis or output has this name."""


@dataclass(frozen=True)
class Staged:
    """A member function in stages: `run` does them in one go, `halve` stops on the way.

    Attributes:
        begin: the state before the first step, of key, point and data: a pytree of arrays.
        go_on: the state after further steps, of key, point, data, state, and the numbers of the first step and of the
            one after the last. Both are int32 scalars that the program is given, as `jax.lax.fori_loop` takes them.
        judge: outputs of key, point, data and state.
        steps: of the whole training.
        every: cuts fall on multiples of so many steps.
        name: what stores call the function; that of `go_on` if empty.
    """

    begin: Callable[[jax.Array, dict[str, jax.Array], Any], Any]
    go_on: Callable[[jax.Array, dict[str, jax.Array], Any, Any, jax.Array, jax.Array], Any]
    judge: Callable[[jax.Array, dict[str, jax.Array], Any, Any], Mapping[str, Any]]
    steps: int
    every: int = 1
    name: str = ""

    def __post_init__(self) -> None:
        """Refuse lengths that cannot be."""
        if self.steps < 1 or self.every < 1 or self.steps % self.every:
            raise InputError(f"a training of {self.steps} steps cannot be cut at every {self.every}; both are positive")

    @property
    def named(self) -> str:
        """What stores call the function."""
        return self.name or f"{self.go_on.__module__}.{self.go_on.__qualname__}"

    def __call__(self, key: jax.Array, point: dict[str, jax.Array], shared: Any) -> Mapping[str, Any]:
        """Begin, go on to the last step, judge; in one program, whose last bits may be others than those of stages.

        Args:
            key: the member's key.
            point: its value per axis.
            shared: data.

        Returns:
            Outputs by name.
        """
        state = self.begin(key, point, shared)
        state = self.go_on(key, point, shared, state, jnp.int32(0), jnp.int32(self.steps))
        return self.judge(key, point, shared, state)


class Form(NamedTuple):
    """What a state is made of.

    Attributes:
        structure: of its pytree.
        leaves: shape and type of each array as it is stored.
        keys: kind of the random keys that a leaf holds; None for numbers.
    """

    structure: Any
    leaves: tuple[jax.ShapeDtypeStruct, ...]
    keys: tuple[Any, ...]

    @property
    def nbytes(self) -> int:
        """Bytes of one state."""
        return sum(int(np.prod(leaf.shape)) * leaf.dtype.itemsize for leaf in self.leaves)

    def stored(self, state: Any) -> dict[str, jax.Array]:
        """The leaves of a state, as outputs of a member function."""
        return {f"{STATE}.{i}": _bare(leaf) for i, leaf in enumerate(jax.tree.leaves(state))}

    def names(self) -> list[str]:
        """Names of these outputs, in order."""
        return [f"{STATE}.{i}" for i in range(len(self.leaves))]

    def state(self, leaves: Any) -> Any:
        """The state of stored leaves."""
        pairs = zip(leaves, self.keys, strict=True)
        dressed = [leaf if kind is None else jax.random.wrap_key_data(leaf, impl=kind) for leaf, kind in pairs]
        return jax.tree.unflatten(self.structure, dressed)

    # The stages as member functions, whose points hold the state as `STATE`.

    def begin(self, staged: Staged) -> Callable[..., dict[str, jax.Array]]:
        """The first stage."""
        return lambda key, point, shared: self.stored(staged.begin(key, point, shared))

    def go_on(self, staged: Staged) -> Callable[..., dict[str, jax.Array]]:
        """The second one, given the numbers of two steps beside."""

        def function(key: jax.Array, point: dict[str, Any], shared: Any, first: Any, last: Any) -> dict[str, jax.Array]:
            values, state = self._taken_apart(point)
            state = staged.go_on(key, values, shared, state, first, last)
            self._check(state, staged.named)
            return self.stored(state)

        return function

    def judge(self, staged: Staged) -> Callable[..., Mapping[str, Any]]:
        """The last one."""

        def function(key: jax.Array, point: dict[str, Any], shared: Any) -> Mapping[str, Any]:
            values, state = self._taken_apart(point)
            return staged.judge(key, values, shared, state)

        return function

    def _check(self, state: Any, named: str) -> None:
        """Refuse a state that is made of something else."""
        leaves, structure = jax.tree.flatten(state)
        here = [str(structure), *(_said(_bare(leaf), _kind(leaf)) for leaf in leaves)]
        there = [str(self.structure), *map(_said, self.leaves, self.keys)]
        for given, taken in zip(there, here, strict=False):
            if given != taken:
                told = f"{given[:150]} becomes {taken[:150]}"  # a large tree would fill the screen
                raise InputError(f"{named}: go_on gives a state of another form than it is given: {told}")

    def _taken_apart(self, point: dict[str, Any]) -> tuple[dict[str, jax.Array], Any]:
        return {name: value for name, value in point.items() if name != STATE}, self.state(point[STATE])


def form_of(staged: Staged, point: dict[str, Any], shared: Any) -> Form:
    """Look at the state of one member without computing it.

    Args:
        staged: the function.
        point: a value per axis.
        shared: data.

    Returns:
        What its state is made of.
    """
    seen: list[tuple[Any, list[Any]]] = []

    def traced(point: dict[str, jax.Array], shared: Any) -> list[jax.Array]:
        leaves, structure = jax.tree.flatten(staged.begin(jax.random.key(0), point, shared))
        seen.append((structure, [_kind(leaf) for leaf in leaves]))
        return [_bare(leaf) for leaf in leaves]

    leaves = jax.eval_shape(traced, point, shared)
    structure, kinds = seen[0]
    return Form(structure, tuple(leaves), tuple(kinds))


def _said(leaf: Any, kind: Any) -> str:
    """A leaf in words."""
    return f"{leaf.dtype}{list(leaf.shape)}" if kind is None else f"keys of {kind}"


def _kind(leaf: Any) -> Any:
    """Which random keys a leaf holds; None for numbers."""
    held = jnp.asarray(leaf)
    return jax.random.key_impl(held) if jnp.issubdtype(held.dtype, jax.dtypes.prng_key) else None


def _bare(leaf: Any) -> jax.Array:
    """A leaf as an array of numbers: random keys as theirs, numbers of Python with the type that they have in jax."""
    array = jnp.asarray(leaf)
    if jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        return jax.random.key_data(array)
    return jax.lax.convert_element_type(array, array.dtype)
