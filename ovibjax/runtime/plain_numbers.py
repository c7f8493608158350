"""Numbers as people and instruments write them; Python itself would also read `1_000` and digits of other scripts."""


def plain_float(text: str) -> float:
    """A real number in plain notation; `nan` and `inf` are numbers here.

    Args:
        text: what stands in a file or was typed.

    Returns:
        The number.

    Raises:
        ValueError: anything else, `1_000` among it.
    """
    return float(_plain(text))


def plain_int(text: str) -> int:
    """A whole number in plain notation.

    Args:
        text: what stands in a file or was typed.

    Returns:
        The number.

    Raises:
        ValueError: anything else, `1_000` among it.
    """
    return int(_plain(text))


def _plain(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is not a number in plain notation")
    return text
