"""The one exception that means: the input is at fault, and here is what to do about it; and how its line is worded."""

import os
import warnings

StrPath = str | os.PathLike[str]
"""A path, as text or as an object."""


class InputError(ValueError):
    """Bad input from outside (a file, an option, a value); the message names it and says what to do.

    The command line prints the message as one line and exits with code 2; as a library exception it is a `ValueError`.
    """


class Doubt(UserWarning):
    """Input that is taken, but may not mean what it says; the message names the doubt and what settles it.

    The command line prints it as one line; in Python it is a warning like any other.
    """


def doubt(source: StrPath, reason: str) -> None:
    """Warn of input that may not mean what it says, on one line: `source: reason`."""
    warnings.warn(str(refusal(source, reason)), Doubt, stacklevel=2)


def refusal(source: StrPath, reason: str, line: int | None = None) -> InputError:
    """The error for one bad input: `source: line 3: reason` on one line, whatever the file is called or holds."""
    # Corrupt headers can put thousands of characters into a reason.
    short = reason if len(reason) <= 300 else reason[:297] + "..."
    place = os.fspath(source) if line is None else f"{os.fspath(source)}: line {line}"
    return InputError("".join(c if c.isprintable() else ascii(c)[1:-1] for c in f"{place}: {short}"))


def unreadable(path: StrPath, what: str, error: BaseException) -> InputError:
    """A refusal that quotes the beginning of the underlying error."""
    text = " ".join(str(error).split())[:120]
    return refusal(path, f"{what} ({type(error).__name__}{': ' if text else ''}{text})")


def one_line(error: BaseException, at_most: int | None = None) -> str:
    """What an error says, without line breaks, for a message that quotes it.

    Args:
        error: anything that was raised.
        at_most: characters.

    Returns:
        The text; the name of its type where it says nothing.
    """
    return " ".join(str(error).split())[:at_most] or type(error).__name__
