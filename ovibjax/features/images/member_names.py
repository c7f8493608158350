"""Names of files inside archives, which somebody else chose."""

from pathlib import Path, PureWindowsPath

from ovibjax.errors import refusal


def clean_name(path: Path, name: str) -> str:
    """A member's name without empty parts and dots.

    Args:
        path: the archive, for messages.
        name: as it stands there, with forward slashes.

    Returns:
        The name.

    Raises:
        InputError: it is absolute or leads out of the archive.
    """
    pure = PureWindowsPath(name)  # knows both separators
    if pure.anchor or name.startswith("/"):
        raise refusal(path, f"member {name} has an absolute path; this archive is not safe")
    if ".." in pure.parts:
        raise refusal(path, f"member {name} leads out of the archive; this archive is not safe")
    return "/".join(part for part in name.split("/") if part not in ("", "."))
