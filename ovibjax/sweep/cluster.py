"""A sweep on a Ray cluster, or on worker processes of this machine.

    dataset = run(fn, axes, data, store="sweep.zarr", executor=on_ray())

A task is some batches of members. It adds them to the store itself, so that only their number comes back; without a
store their rows do. The work itself travels once and is lowered and compiled once per worker process. A worker that
dies loses nothing but the task it was at, which is done again.
"""

import logging
import os
import re
import socket
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ovibjax.errors import InputError, one_line
from ovibjax.runtime.limits import cores
from ovibjax.sweep.differences import digest
from ovibjax.sweep.engine import Executor
from ovibjax.sweep.grid import Grid
from ovibjax.sweep.pickling import by_value
from ovibjax.sweep.store import attach
from ovibjax.sweep.work import PADDING, Work
from ovibjax.sweep.worker import Assignment, compute_task, frozen_environment

# A task whose worker dies this often is given up, ...
_ATTEMPTS = 3
# ... and all are when so many workers have died and not one task was finished.
_HOPELESS = 24
# Tasks for each worker: enough that the last ones end together, few enough that each is worth sending.
_TASKS = 16
_CAUSE = "too little memory (try fewer workers, or fewer lanes) or a crash in native code"
_CONNECT_SECONDS = 10.0

# What of jax's configuration changes programs; set in scripts, where workers do not see it.
_JAX_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
)


def on_ray(address: str | None = None, workers: int | None = None) -> Executor:
    """Compute members on Ray, for `run(..., executor=on_ray())`.

    The numbers are bit for bit those of a run without it, on processors of one kind: a worker has as many threads as
    this process, or those that a store was begun with. On GPUs of this machine start the program with
    XLA_PYTHON_CLIENT_PREALLOCATE=false, or it keeps the memory that its workers need.

    Args:
        address: a running cluster, as `ray.init` takes it ("auto", "10.0.0.1:6379"); a store must then be on a file
            system that all machines share. None starts workers on this machine and ends them afterwards; a
            connection that this process has already is used as it is.
        workers: most tasks at a time; as many as there are cores (or GPUs) if None.

    Returns:
        The executor.

    Raises:
        InputError: Ray is not installed. The executor raises it if the cluster cannot be reached, a worker cannot use
            the store or has other software, or a task keeps killing its worker (once all others are finished).
    """
    try:
        import ray
    except ImportError:
        raise InputError("Ray is not installed; pip install 'ovibjax[cluster]'") from None
    if workers is not None and workers < 1:
        raise InputError("workers is a positive number")

    def compute(work: Work, lots: Sequence[np.ndarray], path: Path | None) -> Iterator[tuple[int, np.ndarray | None]]:
        if lots:  # a finished sweep needs no cluster
            with _connected(ray, address, workers):
                at_once = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
                yield from _compute(ray, work, _tasks(lots, at_once), path, at_once)

    return compute


def _assignment(ray: Any, work: Work, path: Path | None) -> Assignment:
    """What workers are told; the work itself goes into Ray's object store."""
    with by_value(ray.cloudpickle):
        held = ray.put(work)
    where = None if path is None else str(path.absolute())
    return Assignment(
        held,
        None if where is None else (where, digest(attach(where).config)),
        tuple(frozen_environment(work.threads).items()),
        work.text_hash,
        tuple((name, getattr(jax.config, name)) for name in _JAX_SETTINGS),
    )


def _tasks(lots: Sequence[np.ndarray], at_once: int) -> list[np.ndarray]:
    """Batches put together to tasks [batches, devices, lanes], several for each worker."""
    size = max(1, -(-len(lots) // (_TASKS * at_once)))
    return [np.stack(lots[i : i + size]) for i in range(0, len(lots), size)]


def _compute(
    ray: Any, work: Work, tasks: Sequence[np.ndarray], path: Path | None, at_once: int
) -> Iterator[tuple[int, np.ndarray | None]]:
    """Members as workers finish them; tasks whose worker died are tried again batch by batch, after all others."""
    assignment = _assignment(ray, work, path)
    # Ray would end the process after every task on a GPU, and its compiled program with it. It does not repeat tasks
    # itself: it would for ever where memory runs out.
    remote = ray.remote(max_calls=0, max_retries=0, num_cpus=1, **_resources(work))(compute_task)
    queue, running, deaths, finished = deque((task, 0) for task in tasks), dict[Any, Any](), 0, False
    deadly: list[np.ndarray] = []
    try:
        while queue or running:
            while queue and len(running) < at_once:
                running[remote.remote(assignment, queue[0][0])] = queue[0]
                queue.popleft()
            # A short wait, so that Ctrl-C is noticed between results.
            for ref in ray.wait(list(running), timeout=0.5)[0]:
                task, died = running.pop(ref)
                try:
                    rows = _result(ray, ref)
                except _WorkerDied:
                    deaths += 1
                    if died + 1 < _ATTEMPTS:
                        # Last, as others may have taken the memory; alone, so that no other batch dies with it.
                        queue.extend((part, died + 1) for part in np.split(task, len(task)))
                    else:
                        deadly.append(task)
                    if not finished and deaths >= _HOPELESS:
                        raise InputError(
                            f"{_HOPELESS} workers died and not one task was finished; {_CAUSE}, e.g. for "
                            f"{_members(work.grid, task)}"
                        ) from None
                    continue
                finished = True
                yield int(np.sum(task != PADDING)), rows
        if deadly:
            named = "; ".join(_members(work.grid, task) for task in deadly[:3]) + "; ..." * (len(deadly) > 3)
            raise InputError(
                f"some members killed their worker {_ATTEMPTS} times: {named}; {_CAUSE}; "
                f"the other members are {'finished' if path is None else 'kept'}"
            )
    finally:
        # No worker may write any more when the driver gives up the store's lock.
        for ref in running:
            ray.cancel(ref, force=True)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=10)


class _WorkerDied(Exception):
    """A worker was lost with its process, its node, or the arrays that it had not yet sent."""


def _result(ray: Any, ref: Any) -> np.ndarray | None:
    """What a task sent back: rows, or None if it stored them itself.

    Raises:
        _WorkerDied: the task may be tried again.
        InputError: Ray cannot run a worker at all.
    """
    errors = ray.exceptions
    try:
        rows = ray.get(ref)
    except (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.NodeDiedError, errors.ObjectLostError):
        raise _WorkerDied from None
    except errors.RayTaskError as error:
        raise error.cause from None  # without Ray's account of the worker's stack
    except errors.RayError as error:
        raise InputError(f"Ray cannot run a worker: {one_line(error, 300)}") from None
    # Copied out of memory that Ray shares and takes back.
    return None if rows is None else np.array(rows)


@contextmanager
def _connected(ray: Any, address: str | None, workers: int | None) -> Iterator[None]:
    """A connection to Ray; what was started here ends here."""
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options |= {"address": "local", "include_dashboard": False, "num_cpus": workers or cores()}
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
    """What a task asks of Ray: as many devices and threads as the work has."""
    devices = work.devices
    if jax.default_backend() != "cpu":
        return {"num_gpus": devices, "runtime_env": {"env_vars": {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}}}
    flags = re.sub(r"--xla_force_host_platform_device_count=\S+", "", os.environ.get("XLA_FLAGS", ""))
    variables = {
        "JAX_PLATFORMS": "cpu",
        "JAX_NUM_CPU_DEVICES": "-1",  # excludes the flag
        "XLA_FLAGS": f"{flags} --xla_force_host_platform_device_count={devices}".strip(),
        "NPROC": str(work.threads),
    }
    return {"runtime_env": {"env_vars": variables}}


def _members(grid: Grid, task: np.ndarray) -> str:
    """Grid values of a task's members."""
    index = np.unravel_index(task[task != PADDING], grid.shape)
    named = []
    for name, axis in grid.axes.items():
        values = [str(axis.values[k]) for k in np.unique(index[grid.group_of(name)])]
        named.append(f"{name} {', '.join(values if len(values) <= 4 else [values[0], '...', values[-1]])}")
    return "; ".join(named)
