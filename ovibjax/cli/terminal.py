"""Good manners on a terminal that is not one, or not ours: other encodings, pipes that close, warnings of libraries."""

import codecs
import errno
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from ovibjax.errors import Doubt

_SIGNS = {"•": "*", "·": ".", "–": "-", "—": "-", "−": "-", "…": "...", "“": '"', "”": '"', "‘": "'", "’": "'"}
_SIGNS |= {"×": "x", "→": "->", "←": "<-", "≤": "<=", "≥": ">=", "≈": "~", "±": "+-", "°": " deg", "²": "2", "³": "3"}
_SIGNS |= {"√": "sqrt", "∞": "inf", "Σ": "sum", "Δ": "Delta", "Φ": "Phi", "α": "alpha", "β": "beta", "γ": "gamma"}
_SIGNS |= {"δ": "delta", "ε": "epsilon", "η": "eta", "λ": "lambda", "μ": "mu", "ν": "nu", "σ": "sigma", "ψ": "psi"}
_SIGNS |= dict.fromkeys("─━═╌╍┄┅╴╶╸╺╼╾", "-") | dict.fromkeys("│┃║╎╏", "|")
_SIGNS |= dict.fromkeys("╭╮╰╯┌┐└┘├┤┬┴┼┏┓┗┛┣┫┳┻╋╇╈╡╞╪╤╧", "+")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CACHE = "persistent compilation cache"
_SIGPIPE_CODE = 128 + 13  # as a shell reports of programs that the signal ends


def _replaced(error: UnicodeError) -> tuple[str, int]:
    """What is written for characters that an encoding lacks: a plain word for those of ours, an escape for others."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    plain = (_SIGNS.get(one) or one.encode("ascii", "backslashreplace").decode() for one in lacking)
    return "".join(plain), error.end


codecs.register_error("ovibjax.plain", _replaced)


def open_streams() -> None:
    """Put something in the place of standard output or error that was closed before the start (`>&-`, services)."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


@contextmanager
def civil() -> Iterator[None]:
    """Run a command with output that any terminal takes, and end quietly where nobody reads it any more.

    A doubt about the input (`errors.Doubt`) is one line on standard error, as is the first complaint of jax about the
    folder of compiled programs.

    Raises:
        SystemExit: standard output or error was closed by its reader, or its disk is full.
    """
    logging.getLogger("matplotlib").addFilter(_is_news)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="ovibjax.plain")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", Doubt)
            warnings.filterwarnings("always", f".*{_CACHE}")
            warnings.showwarning = _Notes(warnings.showwarning)
            try:
                yield
            finally:
                sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout, sys.stderr)
        sys.exit(_SIGPIPE_CODE)
    except OSError as error:
        # What could not be written to a stream waits in its buffer, unless it has none (PYTHONUNBUFFERED).
        broken = [stream for stream in (sys.stdout, sys.stderr) if not _flushes(stream)]
        if not broken and error.errno not in _FULL:
            raise
        _discard(*broken)
        where = "" if error.filename is None else f"{error.filename}: "
        with suppress(OSError):  # standard error may be the one
            print(f"ovibjax: {where}cannot write the output ({error.strerror or error})", file=sys.stderr)
        sys.exit(2)


def _is_news(record: logging.LogRecord) -> bool:
    """Whether a message of matplotlib tells more than that its cache goes to a temporary folder."""
    return not any(words in record.getMessage() for words in ("mkdir -p failed", "a temporary cache directory"))


def _flushes(stream: TextIO) -> bool:
    try:
        stream.flush()
    except OSError:
        return False
    return True


def _discard(*streams: TextIO) -> None:
    """Let what is left in the buffers go somewhere when Python ends."""
    for stream in streams:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Notes:
    """Shows doubts as lines, and leaves other warnings to Python."""

    def __init__(self, others: Any) -> None:
        self._others, self._cache_told = others, False

    def __call__(self, message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, Doubt):
            print(f"ovibjax: note: {message}", file=sys.stderr)
        elif _CACHE in str(message):
            if not self._cache_told:
                self._cache_told = True
                folder, text = os.environ.get("JAX_COMPILATION_CACHE_DIR", ""), " ".join(str(message).split())
                said = f"{folder}: compiled programs are not kept ({(text.partition(chr(39) + ': ')[2] or text)[:160]})"
                print(f"ovibjax: note: {said}; set OVIBJAX_CACHE to a folder that can be written", file=sys.stderr)
        else:
            self._others(message, category, *place, **more)
