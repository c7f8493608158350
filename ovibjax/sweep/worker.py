"""A worker process of a sweep on Ray: told once what the sweep is, it computes the chunks it is given."""

import socket
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax

from ovibjax.errors import InputError
from ovibjax.sweep.schema import digest
from ovibjax.sweep.store import Store, attach
from ovibjax.sweep.work import Block, Work


@dataclass(frozen=True)
class Assignment:
    """What a worker needs to know, small and hashable.

    Attributes:
        work: reference to the work in Ray's object store.
        store: the store and the digest of its configuration; None to send arrays back.
        environment: version of jax and platform, which must be the same.
        program: hash of the program's text.
        settings: jax's configuration.
    """

    work: Any
    store: tuple[str, str] | None
    environment: tuple[str, str]
    program: str
    settings: tuple[tuple[str, Any], ...]


def compute_chunk(assignment: Assignment, i: int) -> Block | None:
    """One chunk, into the store or back; the task that Ray is given."""
    work, store = begin(assignment)
    block = work.compute(i)
    if store is None:
        return block
    store.write(i, block.arrays, block.diverged)
    return None


@lru_cache(maxsize=1)
def begin(assignment: Assignment) -> tuple[Work, Store | None]:
    """Once per worker process: the work, and the store it writes to."""
    import ray

    here = f"the worker on {socket.gethostname()}"
    for name, value in assignment.settings:
        jax.config.update(name, value)
    for what, there, mine in zip(
        ("jax", "platform"), assignment.environment, (jax.__version__, jax.default_backend()), strict=True
    ):
        if there != mine:
            raise InputError(f"{here} has {what} {mine} and this process {there}; bits depend on it: make them equal")
    store = None
    if assignment.store is not None:
        path, config = assignment.store
        try:
            store = attach(path)
        except InputError as error:
            raise InputError(
                f"{here} cannot open the store: {error}; it must be on a file system that all machines share"
            ) from None
        if digest(store.config) != config:
            raise InputError(f"{here} finds another store at {path}; use a file system that all machines share")
    work: Work = ray.get(assignment.work)
    if work.program.text_hash != assignment.program:
        raise InputError(f"{here} makes another program of this sweep; install the same software on all machines")
    return work, store
