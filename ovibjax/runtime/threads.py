"""Independent work on all cores, and the threads inside of one piece of it, on which its last bits depend.

XLA keeps one core busy per small program and leaves the rest idle.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any, TypeVar

import jax
import scipy.linalg  # noqa: F401  jax calls its LAPACK on a CPU; what is not loaded cannot be limited
from threadpoolctl import ThreadpoolController, threadpool_limits

from ovibjax.runtime.limits import MOST_PROGRAMS, cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def workers() -> int:
    """Programs worth running at a time: one per core that this process may use on a CPU, one on an accelerator."""
    return min(cores(), MOST_PROGRAMS) if jax.default_backend() == "cpu" else 1


@cache
def pool_threads() -> int:
    """Threads that XLA splits sums and products among on a CPU; NPROC in the environment sets them before jax starts.

    Returns:
        Their number; the last bits of long sums depend on it.
    """
    given = os.environ.get("NPROC", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(int(given) if given.isdecimal() and int(given) else cores, jax.local_device_count())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK, which jax calls on a CPU too, to one thread: then no bit depends on the number of cores."""
    with threadpool_limits(1, user_api="blas"):
        yield


class _BlasLimit:
    """One BLAS thread while anybody is inside, in any number of threads; the last one out restores what was before."""

    def __init__(self) -> None:
        self._lock, self._inside = Lock(), 0
        self._libraries: ThreadpoolController | None = None
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                # Looking for libraries takes longer than a search; those that come later are not ours.
                self._libraries = self._libraries or ThreadpoolController()
                self._limit = self._libraries.limit(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limit.restore_original_limits()


quick_one_blas_thread = _BlasLimit()
"""`one_blas_thread` for pieces of work of a millisecond, which may run in several threads: for speed, as BLAS's own
threads wait for each other where all cores are busy already."""


def in_threads(
    function: Callable[[Item], Result], items: Iterable[Item], at_most: int | None = None
) -> Iterator[Result]:
    """Results of a function over items, in the order in which they are finished.

    Args:
        function: called once per item, in threads.
        items: started in this order.
        at_most: of them at a time; see `workers`.

    Yields:
        Results. Leaving the loop (Ctrl-C, an error) drops the items that have not started.
    """
    pool = ThreadPoolExecutor(max_workers=max(1, min(workers(), at_most or workers())))
    pending: set[Future[Result]] = {pool.submit(function, item) for item in items}
    try:
        while pending:
            # A short wait, so that Ctrl-C is noticed between results.
            done, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def in_order(function: Callable[[Item], Result], items: Iterable[Item], ahead: int) -> Iterator[Result]:
    """Results of a function over items, in their order, computed in threads a bounded number of items ahead.

    Args:
        function: called once per item; should spend its time outside Python's lock (files, decoders).
        items: any number; taken as they are needed.
        ahead: results held at most.

    Yields:
        Results. Leaving the loop waits for what is being computed, and drops the rest.
    """
    pool = ThreadPoolExecutor(max_workers=min(cores(), MOST_PROGRAMS))
    pending: deque[Future[Result]] = deque()
    try:
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) >= ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
