"""The one exception that means: the input is at fault, and here is what to do about it."""


class InputError(ValueError):
    """Bad input from outside (a file, an option, a value); the message names it and says what to do.

    The command line prints the message as one line and exits with code 2; as a library exception it is a `ValueError`.
    """
