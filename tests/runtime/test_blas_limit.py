"""BLAS in one thread while anybody wants it so, from whatever thread; what was before comes back."""

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from ovibjax.runtime.threads import in_threads, quick_one_blas_thread


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_the_last_one_out_restores_what_was_before():
    limit = type(quick_one_blas_thread)()  # one that knows all libraries that other tests have loaded by now
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with limit:
            with limit:
                assert blas_threads() == {1}
            assert blas_threads() == {1}
        assert blas_threads() == before


def test_threads_that_overlap_leave_it_as_it_was():
    def work(_):
        with quick_one_blas_thread:
            return float(np.sum(np.ones((50, 50)) @ np.ones((50, 50))))

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert set(in_threads(work, range(40))) == {125000.0}
        assert blas_threads() == before
