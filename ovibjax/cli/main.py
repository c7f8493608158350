"""The command line, from its first line to its exit code: 2 and one line for bad input, 130 and one line for Ctrl-C.

With the tests' `conftest.py` the only place where process-wide settings are made. Little is imported before Ctrl-C is
handled: the commands take a second to load.
"""

import os
import sys

from ovibjax.cli.interrupts import watched


def main() -> None:
    """Entry point of the console script."""
    with watched() as presses:
        try:
            from ovibjax.cli.terminal import civil, open_streams

            open_streams()
            from ovibjax.cli.commands import run
            from ovibjax.errors import InputError

            with civil():
                try:
                    run(sys.argv[1:])
                except InputError as error:
                    # What somebody's own function ran into may be this, in other words.
                    _end((error.__cause__ is not None and _no_device()) or str(error), 2)
                except Exception:
                    if said := _no_device():
                        _end(said, 2)
                    raise
        except BaseException as error:
            # An interrupted import may come as another error.
            if isinstance(error, KeyboardInterrupt) or (presses.came and isinstance(error, Exception)):
                presses.over()
                _leave(error)
            raise


def _end(said: str, code: int) -> None:
    print(f"ovibjax: {said}", file=sys.stderr)
    sys.exit(code)


def _no_device() -> str:
    """Why jax found nothing to compute on, as the cause of whatever went wrong; empty where it did."""
    wanted = os.environ.get("JAX_PLATFORMS")
    if not wanted or "jax" not in sys.modules:
        return ""
    from ovibjax.errors import one_line

    try:
        sys.modules["jax"].devices()
    except Exception as error:
        reason = f" ({one_line(error).partition(' (')[0][:160]})" if str(error) else ""
        return f"JAX_PLATFORMS={wanted}: jax finds no such device here{reason}; unset it, or set it to cpu"
    return ""


def _leave(error: BaseException) -> None:
    """Say that the program was interrupted, and go."""
    said = str(error).strip() if isinstance(error, KeyboardInterrupt) else ""
    print(f"ovibjax: {said or 'interrupted'}", file=sys.stderr)
    sys.stderr.flush()
    # Compiled programs still running in worker threads cannot be stopped; do not wait for them.
    os._exit(130)
