"""Chunks of a sweep on a Ray cluster, or on worker processes of this machine.

    dataset = run(fn, axes, data, store="sweep.zarr", executor=on_ray())

Every chunk is one task. It writes its own region of the store, so that only its number comes back; without a store
its arrays do. The work itself travels once and is lowered and compiled once per worker process. A worker that dies
loses nothing but the chunk it was at, which is computed again.
"""

import logging
import os
import re
import socket
import warnings
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ovibjax.errors import InputError, one_line
from ovibjax.sweep.engine import Executor
from ovibjax.sweep.grid import PADDING
from ovibjax.sweep.pickling import by_value
from ovibjax.sweep.schema import Schema, digest
from ovibjax.sweep.store import attach
from ovibjax.sweep.work import Block, Work
from ovibjax.sweep.worker import Assignment, compute_chunk

# A chunk whose worker dies this often is given up, ...
_ATTEMPTS = 3
# ... and all are when so many workers have died and not one chunk was finished.
_HOPELESS = 24
_CAUSE = "too little memory (try fewer workers, or smaller chunks) or a crash in native code"
_CONNECT_SECONDS = 10.0

# What of jax's configuration changes programs; set in scripts, where workers do not see it.
_JAX_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
)


def on_ray(address: str | None = None, workers: int | None = None) -> Executor:
    """Compute chunks on Ray, for `run(..., executor=on_ray())`.

    The numbers are bit for bit those of a run without it on machines of the same kind. On GPUs of this machine start
    the program with XLA_PYTHON_CLIENT_PREALLOCATE=false, or it keeps the memory that its workers need.

    Args:
        address: a running cluster, as `ray.init` takes it ("auto", "10.0.0.1:6379"); a store must then be on a file
            system that all machines share. None starts workers on this machine and ends them afterwards; a
            connection that this process has already is used as it is.
        workers: most chunks at a time; as many as there are cores (or GPUs) if None.

    Returns:
        The executor.

    Raises:
        InputError: Ray is not installed. The executor raises it if the cluster cannot be reached, a worker cannot use
            the store or has other software, or a chunk keeps killing its worker (once all others are finished).
    """
    try:
        import ray
    except ImportError:
        raise InputError("Ray is not installed; pip install 'ovibjax[cluster]'") from None
    if workers is not None and workers < 1:
        raise InputError("workers is a positive number")

    def compute(work: Work, pending: Sequence[int], path: Path | None) -> Iterator[tuple[int, Block | None]]:
        if pending:  # a finished sweep needs no cluster
            with _connected(ray, address, workers):
                yield from _compute(ray, work, pending, path, workers or len(pending))

    return compute


def _assignment(ray: Any, work: Work, path: Path | None) -> Assignment:
    """What workers are told; the work itself goes into Ray's object store."""
    with by_value(ray.cloudpickle):
        held = ray.put(work)
    where = None if path is None else str(path.absolute())
    return Assignment(
        held,
        None if where is None else (where, digest(attach(where).config)),
        (jax.__version__, jax.default_backend()),
        work.program.text_hash,
        tuple((name, getattr(jax.config, name)) for name in _JAX_SETTINGS),
    )


def _compute(
    ray: Any, work: Work, pending: Sequence[int], path: Path | None, at_once: int
) -> Iterator[tuple[int, Block | None]]:
    """Chunks as workers finish them; those whose worker died are tried again, after all others."""
    assignment = _assignment(ray, work, path)
    # Ray would end the process after every task on a GPU, and its compiled program with it. It does not repeat tasks
    # itself: it would for ever where memory runs out.
    task = ray.remote(max_calls=0, max_retries=0, num_cpus=1, **_resources(work))(compute_chunk)
    queue, running, deaths, finished = deque(pending), dict[Any, int](), Counter[int](), False
    try:
        while queue or running:
            while queue and len(running) < at_once:
                running[task.remote(assignment, queue[0])] = queue[0]
                queue.popleft()
            # A short wait, so that Ctrl-C is noticed between results.
            for ref in ray.wait(list(running), timeout=0.5)[0]:
                i = running.pop(ref)
                try:
                    block = _result(ray, ref)
                except _WorkerDied:
                    deaths[i] += 1
                    if deaths[i] < _ATTEMPTS:
                        queue.append(i)  # last, as others may have taken the memory
                    if not finished and deaths.total() >= _HOPELESS:
                        raise InputError(
                            f"{_HOPELESS} workers died and not one chunk was finished; {_CAUSE}, e.g. for "
                            f"{_members(work.schema, i)}"
                        ) from None
                    continue
                finished = True
                yield i, block
        deadly = [i for i, count in deaths.items() if count >= _ATTEMPTS]
        if deadly:
            named = "; ".join(_members(work.schema, i) for i in deadly[:3]) + "; ..." * (len(deadly) > 3)
            raise InputError(
                f"{len(deadly)} of {len(pending)} chunks killed their worker {_ATTEMPTS} times each: {named}; "
                f"{_CAUSE}; the other chunks are {'finished' if path is None else 'kept'}"
            )
    finally:
        # No worker may write any more when the driver gives up the store's lock.
        for ref in running:
            ray.cancel(ref, force=True)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=10)


class _WorkerDied(Exception):
    """A worker was lost with its process, its node, or the arrays that it had not yet sent."""


def _result(ray: Any, ref: Any) -> Block | None:
    """What a task sent back: a chunk, or None if it stored the chunk itself.

    Raises:
        _WorkerDied: the chunk may be tried again.
        InputError: Ray cannot run a worker at all.
    """
    errors = ray.exceptions
    try:
        block = ray.get(ref)
    except (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError, errors.ObjectLostError):
        raise _WorkerDied from None
    except errors.RayTaskError as error:
        raise error.cause from None  # without Ray's account of the worker's stack
    except errors.RayError as error:
        raise InputError(f"Ray cannot run a worker: {one_line(error, 300)}") from None
    if block is None:
        return None
    # Copied out of memory that Ray shares and takes back.
    return Block({name: np.array(values) for name, values in block.arrays.items()}, np.array(block.diverged))


@contextmanager
def _connected(ray: Any, address: str | None, workers: int | None) -> Iterator[None]:
    """A connection to Ray; what was started here ends here."""
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options |= {"address": "local", "include_dashboard": False, "num_cpus": workers or os.cpu_count()}
        if jax.default_backend() == "gpu":
            options |= {"num_gpus": jax.local_device_count()}
    else:
        options |= {"address": address}
    try:
        try:
            host = re.fullmatch(r"(?:ray://)?([^:/]+):(\d+)", address or "")
            if host:  # Ray itself tries for minutes, and then ends the process
                socket.create_connection((host[1], int(host[2])), timeout=_CONNECT_SECONDS).close()
            with warnings.catch_warnings():  # of jax's threads: Ray forks only to start other programs at once
                warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
                ray.init(**options)
        except Exception as error:
            named = "Ray cannot start" if address is None else f"no Ray cluster answers at {address}"
            raise InputError(f"{named} ({one_line(error, 300)})") from None
        yield
    finally:
        ray.shutdown()


def _resources(work: Work) -> dict[str, Any]:
    """What a task asks of Ray: as many devices as the work has, and no more threads than that."""
    devices = work.shape.devices
    if jax.default_backend() != "cpu":
        return {"num_gpus": devices, "runtime_env": {"env_vars": {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}}}
    flags = re.sub(r"--xla_force_host_platform_device_count=\S+", "", os.environ.get("XLA_FLAGS", ""))
    variables = {
        "JAX_PLATFORMS": "cpu",
        "JAX_NUM_CPU_DEVICES": "-1",  # excludes the flag
        "XLA_FLAGS": f"{flags} --xla_force_host_platform_device_count={devices}".strip(),
        "NPROC": str(devices),  # sizes XLA's pool of threads
    }
    return {"runtime_env": {"env_vars": variables}}


def _members(schema: Schema, chunk: int) -> str:
    """Grid values of a chunk's members."""
    grid, members = schema.grid, schema.chunks.members[chunk]
    index = np.unravel_index(members[members != PADDING], grid.shape)
    named = []
    for name, axis in grid.axes.items():
        values = [str(axis.values[k]) for k in np.unique(index[grid.group_of(name)])]
        named.append(f"{name} {', '.join(values if len(values) <= 4 else [values[0], '...', values[-1]])}")
    return "; ".join(named)
