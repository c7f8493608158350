"""The actions of the online controller: a view mode and a prefix length (paper, Section "View-Rate Encoding").

Actions are numbered mode by mode, prefixes inside: F-C, F-R, FS-C, FS-R, ... with C the compact and R the rich prefix.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from ovibjax.link.payload import request_bytes
from ovibjax.views import MODES, modes_for

CONTROL_PREFIXES = (16, 32)
"""Prefix lengths K_ctrl that a request may carry, compact and rich (paper, Section "View-Rate Encoding")."""


@dataclass(frozen=True)
class ActionSet:
    """Modes times prefixes; hashable, a static argument.

    Attributes:
        modes: view modes, keys of `MODES`.
        prefixes: prefix lengths k, ascending.
        sizes_bytes: size of each action's request, where its prefix is coded otherwise than in floats.
    """

    modes: tuple[str, ...] = tuple(MODES)
    prefixes: tuple[int, ...] = CONTROL_PREFIXES
    sizes_bytes: tuple[float, ...] | None = None

    def __len__(self) -> int:
        return len(self.modes) * len(self.prefixes)

    @property
    def names(self) -> tuple[str, ...]:
        """`FS-C` and the like; `FS-16` where there are not exactly two prefixes."""
        letters = ("C", "R") if len(self.prefixes) == 2 else tuple(map(str, self.prefixes))
        return tuple(f"{mode}-{letter}" for mode in self.modes for letter in letters)

    @property
    def mode(self) -> np.ndarray:
        """[A] int32 position of each action's mode in `MODES`."""
        order = tuple(MODES)
        return np.repeat([order.index(mode) for mode in self.modes], len(self.prefixes)).astype(np.int32)

    @property
    def prefix(self) -> np.ndarray:
        """[A] int32 prefix length of each action."""
        return np.tile(self.prefixes, len(self.modes)).astype(np.int32)

    @property
    def payload_bytes(self) -> np.ndarray:
        """[A] float32 request size b(a) = 4 k + 20 + 4 |S|, or what was given."""
        if self.sizes_bytes is not None:
            return np.asarray(self.sizes_bytes, np.float32)
        views = np.repeat([len(MODES[mode]) for mode in self.modes], len(self.prefixes))
        return np.asarray(request_bytes(self.prefix, views), np.float32)

    def index(self, mode: str, prefix: int) -> int:
        """Number of an action."""
        return self.modes.index(mode) * len(self.prefixes) + self.prefixes.index(prefix)


@dataclass(frozen=True, eq=False)
class SweptActions(ActionSet):
    """Actions that share one prefix length, which is data of the program instead of a static choice.

    Not hashable by value: for use inside a compiled function, never as its static argument.

    Attributes:
        k: the prefix length, a traced scalar.
        sizes_bytes: [A] traced sizes of requests, where prefixes are coded otherwise than in floats.
    """

    prefixes: tuple[int, ...] = (0,)
    sizes_bytes: Any = None
    k: Any = 0

    @property
    def prefix(self) -> Any:
        """[A] int32 prefix length of each action."""
        return jnp.broadcast_to(jnp.asarray(self.k, jnp.int32), (len(self.modes),))

    @property
    def payload_bytes(self) -> Any:
        """[A] float32 request size b(a) = 4 k + 20 + 4 |S|, or what was given."""
        if self.sizes_bytes is not None:
            return self.sizes_bytes
        views = jnp.array([len(MODES[mode]) for mode in self.modes], jnp.int32)
        return request_bytes(self.prefix, views).astype(jnp.float32)

    def index(self, mode: str, prefix: int) -> int:
        """Number of an action; there is one prefix, whatever it is."""
        return self.modes.index(mode)


ACTIONS = ActionSet()
"""The paper's A_ctrl = {F, FS, H4, A5} x {16, 32}."""


def actions_for(n_views: int, actions: ActionSet) -> ActionSet:
    """The actions that a platform with so many views has."""
    return ActionSet(tuple(mode for mode in actions.modes if mode in modes_for(n_views)), actions.prefixes)
