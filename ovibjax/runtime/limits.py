"""What of the machine this process may use: a container or `taskset` may leave less than there is."""

import os
from contextlib import suppress
from pathlib import Path, PurePosixPath

_ROOT = Path("/")

MOST_PROGRAMS = 8
"""Programs that run at a time at most, on a machine of any size; beyond, memory and its bandwidth are what limits."""


def cores(root: Path = _ROOT) -> int:
    """Processor cores this process may keep busy: of its affinity, and of its control groups' share of time.

    Args:
        root: of the file system that the kernel tells in; another one in tests.

    Returns:
        At least 1.
    """
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([mine, *(round(share) or 1 for share in _time_shares(root))]))


def free_bytes(root: Path = _ROOT) -> int | None:
    """Memory that this process may still take: of the machine, and of its control groups.

    Args:
        root: see `cores`.

    Returns:
        Bytes; None where the system does not tell.
    """
    found = [value for group in _groups(root, "memory") if (value := _free_of(group)) is not None]
    with suppress(OSError, ValueError, IndexError, StopIteration):
        lines = (root / "proc/meminfo").read_text().splitlines()
        found.append(next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")))
    return max(0, min(found)) if found else None


def _time_shares(root: Path) -> list[float]:
    """Cores' worth of time that each control group above this process allows."""
    shares = []
    for group in _groups(root, "cpu"):
        with suppress(OSError, ValueError, ZeroDivisionError):
            if (group / "cpu.max").exists():  # "max 100000" or "150000 100000"
                quota, period = (group / "cpu.max").read_text().split()
            else:  # version 1; -1 is no limit
                quota, period = ((group / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
            if quota not in ("max", "-1"):
                shares.append(int(quota) / int(period))
    return shares


def _free_of(group: Path) -> int | None:
    """Memory that a control group has left, what it could drop from its cache counted as free; None without a limit."""
    version_2 = ("memory.max", "memory.current", "inactive_file")
    for limit, used, cached in (version_2, ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")):
        with suppress(OSError, ValueError):
            most = (group / limit).read_text().strip()
            if most == "max" or int(most) >= 2**62:  # version 1 writes no limit as a number
                return None
            now = int((group / used).read_text())
            with suppress(OSError, ValueError):
                stated = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
                now -= int(stated.get(cached, 0))
            return int(most) - now
    return None


def _groups(root: Path, controller: str) -> list[Path]:
    """Folders of the control groups that hold this process, each within the next."""
    found: list[Path] = []
    with suppress(OSError, ValueError):
        for line in (root / "proc/self/cgroup").read_text().splitlines():
            _, names, place = line.split(":", 2)
            if names and controller not in names.split(","):
                continue
            top = root / "sys/fs/cgroup" / (controller if names else "")
            inner = PurePosixPath(place.lstrip("/"))
            # Inside a container the group's own name is not there, and its files are at the top.
            found += [top / part for part in (inner, *inner.parents)]
    return [group for group in dict.fromkeys(found) if group.is_dir()]
