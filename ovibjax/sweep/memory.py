"""How much memory a member needs, read off its program before anything is compiled."""

from typing import Any

import numpy as np
from jax.extend import core as jex


def live_bytes(jaxpr: jex.ClosedJaxpr) -> int:
    """Largest total size of values that are alive at once, inputs left out.

    The compiler reuses buffers and fuses operations, so this is an estimate from above, good enough to size batches.

    Args:
        jaxpr: a traced function.

    Returns:
        Bytes.
    """
    return _peak(jaxpr.jaxpr)


def _size(variable: Any) -> int:
    aval = variable.aval
    if not hasattr(aval, "shape"):
        return 0
    itemsize = getattr(aval.dtype, "itemsize", 16)  # keys have an extended dtype
    return int(np.prod(aval.shape, dtype=np.int64)) * itemsize


def _peak(jaxpr: Any) -> int:
    last: dict[Any, int] = {}
    for i, eqn in enumerate(jaxpr.eqns):
        for variable in eqn.invars:
            if isinstance(variable, jex.Var):
                last[variable] = i
    for variable in jaxpr.outvars:
        if isinstance(variable, jex.Var):
            last[variable] = len(jaxpr.eqns)
    alive, peak, made = 0, 0, set()
    for i, eqn in enumerate(jaxpr.eqns):
        inner = max((_peak(sub) for sub in subprograms(eqn)), default=0)
        for variable in eqn.outvars:
            alive += _size(variable)
            made.add(variable)
        peak = max(peak, alive + inner)
        for variable in {*(v for v in eqn.invars if isinstance(v, jex.Var)), *eqn.outvars}:
            if variable in made and last.get(variable, i) == i:
                alive -= _size(variable)
    return peak


def subprograms(eqn: Any) -> list[Any]:
    """Programs inside an equation of one."""
    found = []
    for value in eqn.params.values():
        for item in value if isinstance(value, (tuple, list)) else (value,):
            if isinstance(item, jex.ClosedJaxpr):
                found.append(item.jaxpr)
            elif isinstance(item, jex.Jaxpr):
                found.append(item)
    return found
