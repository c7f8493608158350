"""Which output of a network is the feature of an image, and how tokens or maps become one vector."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ovibjax.errors import doubt, refusal

POOLS: dict[str, tuple[int, ...]] = {"first": (3,), "mean": (3, 4), "gem": (4,)}
"""Ways to pool, and the axes of an output that each is for: [N, T, d] tokens, [N, C, H, W] maps."""
_GEM_POWER, _GEM_FLOOR = 3.0, 1e-6  # as published with the pooling (Radenovic et al.)


def choose_output(path: Path, outputs: Sequence[Any], wanted: str | None, pool: str | None) -> str | None:
    """The output to use.

    Args:
        path: the model, for messages.
        outputs: what onnxruntime says of them.
        wanted: its name, if the user gave one.
        pool: how it will be pooled.

    Returns:
        Its name; None if no output declares the axes wanted, so that running the model must tell.

    Raises:
        InputError: there is no such output.

    Warns:
        Doubt: several outputs would do.
    """
    shapes = {output.name: _shape(output.shape) for output in outputs}
    if wanted is not None:
        if wanted not in shapes:
            raise refusal(path, f"has no output {wanted!r}; it has {', '.join(shapes)}")
        return wanted
    axes = POOLS[pool] if pool is not None else (2,)
    fitting = [output.name for output in outputs if output.shape is not None and len(output.shape) in axes]
    if len(fitting) > 1:
        others = ", ".join(f"{name} {shapes[name]}" for name in fitting[1:])
        taken = f"output {fitting[0]} {shapes[fitting[0]]} is taken"
        doubt(path, f"{taken}, the first of several that would do ({others}); --output says which")
    if not fitting and pool is not None and all(output.shape is not None for output in outputs):
        has = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise refusal(path, f"--pool {pool} is for an output of {_axes_text(axes)} axes; it has {has}")
    return fitting[0] if fitting else None


def vectors(path: Path, found: Sequence[Any], batch: int, pool: str | None, layout: str) -> NDArray[np.float32]:
    """One vector per image from what the model gave.

    Args:
        path: the model, for messages.
        found: its outputs, or the one chosen.
        batch: images.
        pool: how tokens or maps are pooled; None where the output is [N, d].
        layout: `nchw` or `nhwc`, of maps.

    Returns:
        [N, d].

    Raises:
        InputError: no output has the axes that are needed; the message names the option.
    """
    arrays = [array for array in found if getattr(array, "ndim", 0) >= 2 and len(array) == batch]
    if pool is None:
        flat = [array for array in arrays if array.ndim == 2]
        # A map of one place needs no pooling.
        flat += [array.reshape(batch, -1) for array in arrays if array.ndim == 4 and max(array.shape[2:]) == 1]
        if flat:
            return flat[0].astype(np.float32)
        raise refusal(path, f"no output of shape [batch, d] but {_given(found)}; {_advice(arrays)}")
    fitting = [array for array in arrays if array.ndim in POOLS[pool]]
    if not fitting:
        what = f"an output of {_axes_text(POOLS[pool])} axes, not {_given(found)}"
        raise refusal(path, f"--pool {pool} is for {what}; {_advice(arrays)}")
    array = fitting[0].astype(np.float32)
    if pool == "first":
        return array[:, 0]
    places = (1,) if array.ndim == 3 else (2, 3) if layout == "nchw" else (1, 2)
    if pool == "mean":
        pooled: NDArray[np.float32] = array.mean(axis=places)
        return pooled
    powers = np.maximum(array, _GEM_FLOOR, dtype=np.float32) ** np.float32(_GEM_POWER)
    return powers.mean(axis=places) ** np.float32(1 / _GEM_POWER)


def _advice(arrays: Sequence[Any]) -> str:
    """What to add to the command for outputs of these shapes."""
    pools = sorted({pool for array in arrays for pool, axes in POOLS.items() if array.ndim in axes})
    flat = "leave out --pool, or " if any(array.ndim == 2 for array in arrays) else ""
    return flat + (f"add --pool {' or '.join(pools)}" if pools else "name another output with --output")


def _given(found: Sequence[Any]) -> str:
    return ", ".join(str(getattr(array, "shape", "?")) for array in found)


def _axes_text(axes: Sequence[int]) -> str:
    return " or ".join(map(str, axes))


def _shape(shape: Sequence[Any] | None) -> str:
    return "[?]" if shape is None else f"[{', '.join(str(length) for length in shape)}]"
