"""Stores that were filled apart, joined into one."""

from collections.abc import Sequence
from pathlib import Path

from ovibjax.errors import InputError
from ovibjax.sweep.asked import asked_grids
from ovibjax.sweep.head import refuse_other
from ovibjax.sweep.store import Store, attach


def merge(paths: Sequence[str | Path], out: str | Path) -> tuple[int, int]:
    """Join stores of one sweep, e.g. shards of machines that share nothing.

    Args:
        paths: the stores, which stay as they are.
        out: the store they are joined in; made if it is not there, added to if it is.

    Returns:
        Members in it now, and how many of them were not there before.

    Raises:
        InputError: no store, stores of different sweeps or data, or a disk that refuses. What was added stays, and the
            same command goes on.
    """
    if not paths:
        raise InputError("there is nothing to merge; name one store or more")
    given = [attach(path) for path in paths]
    first = (given[0].layout, given[0].config)
    for store in given[1:]:
        refuse_other(store.path, (store.layout, store.config), first, f"it cannot be merged with {given[0].path}")
    with Store.open(out, *first) as kept:
        kept.lock()
        added = 0
        for store in given:
            store.read()
            for grid in asked_grids(store.path, store.layout):
                kept.announce(grid)
            if store.rows is not None:
                added += kept.join(store.rows, store.path)
        return (0 if kept.rows is None else len(kept.rows)), added
