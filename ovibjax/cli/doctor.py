"""The command `ovibjax doctor`: what this installation is, and whether it computes what it should."""

import os
import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from ovibjax import __version__
from ovibjax.runtime.cache import cache_folder
from ovibjax.runtime.hardware import instructions, processor_name
from ovibjax.runtime.progress import console

_PACKAGES = ("jax", "jaxlib", "flax", "optax", "numpy", "scipy", "xarray", "zarr", "matplotlib")
_FOR_DEVELOPERS = ("dev", "docs", "test", "bench")


@dataclass(frozen=True)
class Doctor:
    """Say what this installation is, and train one small encoder to see whether it computes what it should.

    Versions, devices, what the processor can, the precision that training would use, the cache and how to empty it,
    which optional parts are installed. What a report of a fault should hold. Exit code 1 if the self-test fails.

    Example: ovibjax doctor
    """

    self_test: bool = True
    """Train and judge the small encoder (some ten seconds, nearly all of it compiling)."""

    def run(self) -> None:
        """Run the command."""
        for name, said in self._facts():
            print(f"{name:12} {said}", flush=True)
        if not self.self_test:
            return
        from ovibjax.edge.self_test import EXPECTED_M, PREFIXES, self_test

        with console.status("training one small encoder"):
            found = self_test()
        errors = ", ".join(
            f"{error:.3f} m at k = {k} ({expected} expected)"
            for error, k, expected in zip(found.error_m, PREFIXES, EXPECTED_M, strict=True)
        )
        verdict = f"{'passed' if found.passed else 'FAILED'}: {errors}"
        print(f"{'self-test':12} {verdict}; {found.compile_s:.1f} s with compiling, {found.run_s:.2f} s without")
        if not found.passed:
            print(f"{'':12} results of this installation cannot be trusted; please report this with the lines above")
            raise SystemExit(1)

    def _facts(self) -> Iterator[tuple[str, str]]:
        """Name and text of every line but the last."""
        versions = (f"{name} {installed(name) or 'missing'}" for name in _PACKAGES)
        yield "ovibjax", f"{__version__} in {Path(__file__).parents[1]}{_stale()}"
        yield "versions", f"Python {platform.python_version()}, {', '.join(versions)}"
        yield "system", f"{platform.system()} {platform.release()}, {platform.machine()}"
        yield "processor", processor_line()
        import jax

        from ovibjax.runtime.precision_choice import faster_precision
        from ovibjax.runtime.threads import workers

        devices = [f"{device.platform}:{device.id} ({device.device_kind})" for device in jax.devices()]
        yield "devices", f"{', '.join(devices)}; {workers()} cores for this process"
        yield "precision", f"{faster_precision()}, which is what `auto` means on this machine"
        yield "cache", cache_line(cache_folder())
        yield (
            "extras",
            ", ".join(
                f"[{extra}] {'missing ' + ' '.join(lacking) if lacking else 'installed'}"
                for extra, lacking in optional_parts().items()
            ),
        )


def installed(package: str) -> str | None:
    """Version of a package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _stale() -> str:
    """That the installed record is of another version than the code that runs, as a checkout leaves it."""
    recorded = installed("ovibjax")
    return f" (installed as {recorded or 'nothing'}; pip install again)" if recorded != __version__ else ""


def processor_line() -> str:
    """Model and instructions that matter here, where the system tells them."""
    return f"{processor_name()}: {instructions() or 'no vector instructions that are known here'}"


def cache_line(folder: Path) -> str:
    """Where the cache is, its size, and how to empty it."""
    size = 0
    for path in folder.rglob("*") if folder.is_dir() else ():
        try:
            size += path.stat().st_size if path.is_file() else 0
        except OSError:  # another process removed it meanwhile
            continue
    moved = "OVIBJAX_CACHE says where" if os.environ.get("OVIBJAX_CACHE") else "OVIBJAX_CACHE puts it elsewhere"
    return f"{folder}, {size / 1e6:.0f} MB ({moved}); all of it can be made again: to empty it, delete the folder"


def optional_parts() -> dict[str, list[str]]:
    """The extras that users may install, with the packages of each that are missing."""
    parts: dict[str, list[str]] = {}
    for requirement in metadata.requires("ovibjax") or ():
        found = re.match(r"([\w.-]+).*\bextra\s*==\s*['\"]([\w-]+)['\"]", requirement)
        if found is None or found[2] in _FOR_DEVELOPERS:
            continue
        lacking = parts.setdefault(found[2], [])
        if installed(found[1]) is None:
            lacking.append(found[1])
    return parts
