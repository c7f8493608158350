"""What a process may use of the machine: affinity, shares of time, and memory of containers, as kernels tell them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ovibjax.runtime import limits, threads
from ovibjax.sweep import arrange
from ovibjax.sweep.program import Batch
from ovibjax.sweep.work import Work

GB = 2**30
ROOT = Path(__file__).parents[2]


def machine(root, cgroup="0::/\n", available_kb=8 * 2**20, **files):
    """A file system in which a kernel tells these things; `__` in a name stands for a folder's end."""
    for name, content in {"proc/self/cgroup": cgroup, "proc/meminfo": meminfo(available_kb), **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return root


def meminfo(available_kb):
    return f"MemTotal: 99999999 kB\nMemFree: 1 kB\nMemAvailable: {available_kb} kB\n"


@pytest.fixture
def eight(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 8),
        ({"sys/fs/cgroup/cpu.max": "max 100000\n"}, 8),
        ({"sys/fs/cgroup/cpu.max": "200000 100000\n"}, 2),
        ({"sys/fs/cgroup/cpu.max": "150000 100000\n"}, 2),
        ({"sys/fs/cgroup/cpu.max": "20000 100000\n"}, 1),
        ({"sys/fs/cgroup/cpu.max": "9999999 100000\n"}, 8),
        ({"sys/fs/cgroup/cpu.max": "not a number\n"}, 8),
        ({"sys/fs/cgroup/cpu.max": "100000 0\n"}, 8),
    ],
)
def test_a_share_of_time(tmp_path, eight, files, expected):
    assert limits.cores(machine(tmp_path, **files)) == expected


def test_groups_above_count_too(tmp_path, eight):
    root = machine(
        tmp_path,
        "0::/slice/job\n",
        **{"sys/fs/cgroup/slice/job/cpu.max": "max 100000", "sys/fs/cgroup/slice/cpu.max": "300000 100000"},
        **{"sys/fs/cgroup/slice/memory.max": str(2 * GB), "sys/fs/cgroup/slice/memory.current": str(GB // 2)},
    )
    assert limits.cores(root) == 3 and limits.free_bytes(root) == 3 * GB // 2


def test_version_1(tmp_path, eight):
    groups = "4:memory:/docker/abc\n2:cpu,cpuacct:/docker/abc\n1:name=systemd:/x\n"
    root = machine(
        tmp_path,
        groups,
        **{"sys/fs/cgroup/cpu/cpu.cfs_quota_us": "400000", "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000"},
        **{"sys/fs/cgroup/memory/memory.limit_in_bytes": str(3 * GB)},
        **{"sys/fs/cgroup/memory/memory.usage_in_bytes": str(2 * GB)},
        **{"sys/fs/cgroup/memory/memory.stat": f"cache 5\ntotal_inactive_file {GB}\n"},
    )
    assert limits.cores(root) == 4 and limits.free_bytes(root) == 2 * GB
    (root / "sys/fs/cgroup/cpu/cpu.cfs_quota_us").write_text("-1")
    (root / "sys/fs/cgroup/memory/memory.limit_in_bytes").write_text("9223372036854771712")
    assert limits.cores(root) == 8 and limits.free_bytes(root) == 8 * GB


@pytest.mark.parametrize(
    ("files", "expected_gb"),
    [
        ({}, 8),
        ({"memory.max": "max", "memory.current": "5"}, 8),
        ({"memory.max": str(4 * GB), "memory.current": str(GB)}, 3),
        ({"memory.max": str(4 * GB), "memory.current": str(3 * GB), "memory.stat": f"inactive_file {2 * GB}\n"}, 3),
        ({"memory.max": str(64 * GB), "memory.current": "0"}, 8),
        ({"memory.max": str(GB), "memory.current": str(2 * GB)}, 0),
        ({"memory.max": "?", "memory.current": "0"}, 8),
        ({"memory.max": str(4 * GB)}, 8),
    ],
)
def test_memory_of_a_container(tmp_path, files, expected_gb):
    root = machine(tmp_path, **{f"sys/fs/cgroup/{name}": content for name, content in files.items()})
    assert limits.free_bytes(root) == expected_gb * GB


def test_a_system_that_does_not_tell(tmp_path, monkeypatch):
    assert limits.free_bytes(tmp_path) is None
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert limits.cores(tmp_path) == 1


@given(st.text(max_size=60), st.text(max_size=30))
def test_nothing_that_a_kernel_may_write_is_an_error(tmp_path_factory, cgroup, limit):
    root = tmp_path_factory.mktemp("root")
    files = {f"sys/fs/cgroup/{name}": limit for name in ("cpu.max", "memory.max", "memory.current", "memory.stat")}
    for name, content in {"proc/self/cgroup": cgroup, "proc/meminfo": limit, **files}.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(content, encoding="utf-8")
    assert limits.cores(root) >= 1 and (limits.free_bytes(root) or 0) >= 0


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity here")
def test_one_core_is_one_worker():
    """As `taskset -c 0` starts it."""
    code = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    code += "from ovibjax.runtime.threads import workers; print(workers())"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.stdout.strip() == "1", done.stderr


@pytest.mark.parametrize(
    ("alive", "lanes", "free", "expected"),
    [
        (GB, 1, 4 * GB, 4),
        (GB, 4, 10 * GB, 2),
        (GB, 8, GB, 1),
        (0, 4, GB, None),
        (sys.maxsize, 1, GB, None),
        (1, 1, None, None),
    ],
)
def test_batches_that_run_together_fit_into_memory(monkeypatch, alive, lanes, free, expected):
    monkeypatch.setattr(arrange, "free_bytes", lambda: free)
    assert arrange._fitting(Work(None, None, None, Batch(lanes, False), 1, 1, None, alive)) == expected


def test_so_many_run_at_a_time(monkeypatch):
    import threading

    running, most = [0], [0]
    lock = threading.Lock()

    def one(i):
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
        np.linalg.svd(np.ones((60, 60)))
        with lock:
            running[0] -= 1
        return i

    monkeypatch.setattr(threads, "workers", lambda: 8)
    for at_most, expected in ((1, 1), (3, 3), (100, 8)):
        most[0] = 0
        assert sorted(threads.in_threads(one, range(40), at_most)) == list(range(40)) and most[0] <= expected
