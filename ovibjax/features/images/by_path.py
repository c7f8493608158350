"""Sources of images by path: a folder or an archive in the released layout, or poses of somebody's own images."""

from collections.abc import Sequence
from pathlib import Path

from ovibjax.errors import InputError, StrPath, refusal
from ovibjax.features.images.archive import TarFiles
from ovibjax.features.images.image_pattern import cameras_of
from ovibjax.features.images.pose_table import PoseOptions
from ovibjax.features.images.released_layout import files_of_towns, read_towns, role_of
from ovibjax.features.images.source import Files, OnStep, Source
from ovibjax.features.images.table import read_table
from ovibjax.features.images.unpacking import packing_of
from ovibjax.features.images.zip_access import ZipFiles

_TABLES = (".csv", ".tsv", ".txt")
_ARCHIVES = (".tar", ".tgz", ".tbz2", ".txz", ".tar.gz", ".tar.bz2", ".tar.xz", ".tar.zst", ".tar.zstd", ".zip")


def open_source(
    path: StrPath,
    images: str | None = None,
    n_views: int | None = None,
    on_step: OnStep | None = None,
    poses: PoseOptions = PoseOptions(),  # noqa: B008 (frozen)
    cameras: Sequence[str] = (),
) -> Source:
    """Find frames, poses and images.

    Args:
        path: a town's folder (or one that holds towns), its archive (`.tar`, packed or not, or `.zip`), or a `.csv`,
            `.tsv` or `.txt` of poses.
        images: for poses, where images lie, e.g. `images/{view}/{frame}.jpg`, relative to their file.
        n_views: 5 (UAV) or 4 (UGV: Front Back Left Right); by default 5 where there are images of Down.
        on_step: progress.
        poses: form, columns and axes of a file of poses, where it does not say them.
        cameras: `VIEW=NAME` for views that are called otherwise in the data.

    Returns:
        The source, with at least one frame; frames without all views or a finite pose are in `skipped`.

    Raises:
        InputError: no such source, not one of the three kinds, a camera is missing altogether, or no frame is left.
    """
    path = Path(path)
    if n_views not in (None, 4, 5):
        raise InputError(f"--views {n_views}: a platform has 5 views (UAV) or 4 (UGV: Front Back Left Right)")
    try:
        kind = "folder" if path.is_dir() else "file" if path.is_file() else ""
    except (OSError, ValueError) as error:
        raise refusal(path, f"unreadable path ({error})") from error
    if not kind:
        raise refusal(path, "no such file or folder")
    names = cameras_of(cameras)
    if kind == "file" and path.suffix.lower() in _TABLES:
        return read_table(path, images, n_views, poses, names)
    if images is not None or poses != PoseOptions():
        option = "--images" if images is not None else "--poses, --columns, --axes or --order"
        raise refusal(path, f"{option} belongs to a table of poses; folders and archives have their own layout")
    files: Files
    if kind == "folder":
        files = files_of_towns(path)
    elif path.name.lower().endswith(_ARCHIVES):
        files = _open_archive(path, on_step)
    else:
        raise refusal(path, "is no folder, archive (.tar, packed or not, .zip) or file of poses (.csv, .tsv, .txt)")
    try:
        return read_towns(files, n_views, names, on_step)
    except BaseException:
        files.close()
        raise


def _open_archive(path: Path, on_step: OnStep | None) -> Files:
    """An archive by what it holds, whatever it is called."""

    def wanted(name: str) -> bool:
        return role_of(name) is not None

    try:
        with path.open("rb") as file:
            packing = packing_of(file.read(8))
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror or error})") from error
    return ZipFiles(path, wanted) if packing == "zip" else TarFiles(path, wanted, on_step)
