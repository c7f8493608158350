"""Where derived data and compiled programs are kept between runs."""

import errno
import hashlib
import os
import platform
from contextlib import suppress
from importlib import resources
from pathlib import Path

import platformdirs

from ovibjax.errors import InputError


def cache_folder() -> Path:
    """Where derived data is kept: `OVIBJAX_CACHE`, or the user's cache folder."""
    return Path(os.environ.get("OVIBJAX_CACHE") or platformdirs.user_cache_dir("ovibjax"))


def made_folder(folder: Path) -> Path:
    """The folder, made if it is missing; looked at before the work whose results are to go there.

    Args:
        folder: inside the cache folder.

    Returns:
        The same path.

    Raises:
        InputError: it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise InputError(
            f"{folder}: the cache folder cannot be made ({error.strerror}); set OVIBJAX_CACHE to a folder that can"
        ) from error
    return folder


def source_code(*modules: str) -> bytes:
    """Text of the project's own modules, for the hash of what derived data depends on.

    Args:
        modules: names below `ovibjax`, such as "world.town.render".

    Returns:
        Their text, joined.
    """
    files = (resources.files("ovibjax").joinpath(f"{name.replace('.', '/')}.py") for name in modules)
    return b"".join(file.read_bytes() for file in files)


def keep_compiled_programs() -> None:
    """Let jax keep compiled programs in the cache folder; has an effect only before jax is imported.

    Most of a short command's time is compiling, which the same command on the same machine need not do twice.
    `JAX_COMPILATION_CACHE_DIR`, where set, is left as it is; an empty one keeps nothing.
    """
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache_folder() / "compiled" / processor()))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


def processor() -> str:
    """A name for this kind of processor, 12 hexadecimal digits: a home folder may be shared by several kinds."""
    known = [platform.machine(), platform.processor()]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        known += sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    return hashlib.sha256("\n".join(known).encode()).hexdigest()[:12]
