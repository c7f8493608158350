"""A worker process of a sweep on Ray: told once what the sweep is, it does the tasks it is given."""

import socket
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ovibjax.errors import InputError
from ovibjax.runtime.threads import one_blas_thread, pool_threads
from ovibjax.sweep.differences import digest
from ovibjax.sweep.identity import environment
from ovibjax.sweep.store import attach
from ovibjax.sweep.work import Work
from ovibjax.sweep.writer import Writer


@dataclass(frozen=True)
class Assignment:
    """What a worker needs to know, small and hashable.

    Attributes:
        work: reference to the work in Ray's object store.
        store: the store and the digest of its configuration; None to send arrays back.
        environment: names and values of `frozen_environment`, which must be the same.
        program: hash of the program's text.
        settings: jax's configuration.
    """

    work: Any
    store: tuple[str, str] | None
    environment: tuple[tuple[str, Any], ...]
    program: str
    settings: tuple[tuple[str, Any], ...]


def frozen_environment(threads: int) -> dict[str, Any]:
    """What `identity.environment` says, lists as tuples: an assignment is hashed."""
    return {name: tuple(v) if isinstance(v, list) else v for name, v in environment(threads).items()}


def compute_task(assignment: Assignment, lots: np.ndarray) -> np.ndarray | None:
    """Some batches [batches, devices, lanes], into the store or back; the task that Ray is given."""
    work, store = begin(assignment)
    with one_blas_thread():
        if store is None:
            return np.concatenate([work.compute(lot) for lot in lots])
        with Writer(store) as writer:  # a killed worker has lost a second at most
            for lot in lots:
                writer.add(work.compute(lot))
    return None


@lru_cache(maxsize=1)
def begin(assignment: Assignment) -> tuple[Work, Path | None]:
    """Once per worker process: the work, and the store it writes to."""
    import ray

    here = f"the worker on {socket.gethostname()}"
    for name, value in assignment.settings:
        jax.config.update(name, value)
    mine = frozen_environment(pool_threads())
    for name, there in assignment.environment:
        if mine.get(name) != there:
            raise InputError(
                f"{here} has {name} {mine.get(name)} and this sweep {there}; bits depend on it: make them equal"
            )
    path = None
    if assignment.store is not None:
        path, config = Path(assignment.store[0]), assignment.store[1]
        try:
            store = attach(path)
        except InputError as error:
            raise InputError(
                f"{here} cannot open the store: {error}; it must be on a file system that all machines share"
            ) from None
        if digest(store.config) != config:
            raise InputError(f"{here} finds another store at {path}; use a file system that all machines share")
    work: Work = ray.get(assignment.work)
    if work.text_hash != assignment.program:
        raise InputError(f"{here} makes another program of this sweep; install the same software on all machines")
    return work, path
