"""Files of poses as other programs write them: TUM, KITTI, EuRoC, AirSim and COLMAP.

| form     | a line                                                         | frame              | axes, world/body |
|----------|----------------------------------------------------------------|--------------------|------------------|
| `tum`    | `time x y z qx qy qz qw`, or with commas                       | the time           | as given, `flu`  |
| `kitti`  | 12 numbers, [R t] by rows                                      | 000000, 000001 ... | `rdf/rdf`        |
| `euroc`  | CSV, `#timestamp [ns], p_RS_R_x [m], ...`                      | the time           | `flu/urf`        |
| `airsim` | tabs, `TimeStamp POS_X ... Q_W Q_X Q_Y Q_Z ImageFile`          | the time           | as given, `flu`  |
| `colmap` | `id qw qx qy qz tx ty tz camera name` and a line of its points | the name of an     | `flu/rdf`        |
|          |                                                                | image of Front     |                  |

COLMAP writes a pose per image: those of the front camera count, which are the images in its folder. Its model must have
been aligned to metres.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ovibjax.errors import InputError, refusal
from ovibjax.features.images.pose_table import PoseOptions, Poses, read_table_of_poses
from ovibjax.runtime.text_tables import ContentLines, number_of, quoted, separator_of

FORMS = ("table", "tum", "kitti", "euroc", "airsim", "colmap")

_AIRSIM = {"frame": "TimeStamp", "x_m": "POS_X", "y_m": "POS_Y", "z_m": "POS_Z"}
_AIRSIM |= {"qw": "Q_W", "qx": "Q_X", "qy": "Q_Y", "qz": "Q_Z"}
_EUROC = {"frame": "timestamp", "x_m": "p_RS_R_x", "y_m": "p_RS_R_y", "z_m": "p_RS_R_z"}
_EUROC |= {"qw": "q_RS_w", "qx": "q_RS_x", "qy": "q_RS_y", "qz": "q_RS_z"}
_COLMAP_NUMBERS = 8
_SLACK = 0.02  # of a rotation written with few digits


def read_poses(path: Path, text: str, options: PoseOptions, front: str) -> Poses:
    """Poses of a file in whichever form it is, or is said to be.

    Args:
        path: what to call the file.
        text: its content.
        options: form and columns.
        front: folder of the front camera, for COLMAP.

    Returns:
        The poses.

    Raises:
        InputError: the file is not in the form that is asked for or found, or in none that is known.
    """
    if options.form not in (None, *FORMS):
        raise InputError(f"--poses {options.form}: no such form; there are {', '.join(FORMS)}")
    form = options.form or _form(path, text)
    if form != "table" and (options.columns or options.order):
        option = "--columns" if options.columns else "--order"
        raise refusal(path, f"is read as {form}, whose columns are fixed; leave out {option}, or add --poses table")
    if form == "table":
        return read_table_of_poses(path, text, options.columns, options.order)
    if form == "colmap":
        return _colmap(path, text, front)
    return _READERS[form](path, text)


def _form(path: Path, text: str) -> str:
    """What a file is by its first lines."""
    if re.search(r"^#.*\bIMAGE_ID, QW, QX, QY, QZ", text[:2000], re.MULTILINE):
        return "colmap"
    if re.match(r"\s*#\s*timestamp\b[^\n]*p_RS_R_x", text):
        return "euroc"
    line = next(iter(ContentLines(text)), "")
    first = _words(line, separator_of(line))
    if {"POS_X", "Q_W"} <= set(first):
        return "airsim"
    numbers = sum(number_of(word) is not None for word in first)
    if numbers == len(first) and numbers in (8, 12):
        return "tum" if numbers == 8 else "kitti"
    if len(first) == 10 and numbers >= 9 and path.name == "images.txt":
        return "colmap"
    if first and numbers == len(first):
        known = "8 (TUM: time x y z qx qy qz qw) or 12 (KITTI)"
        raise refusal(path, f"{numbers} numbers in its first line, not {known}; a table needs a line of names", 1)
    return "table"


def _tum(path: Path, text: str) -> Poses:
    poses = Poses("TUM (time x y z qx qy qz qw)")
    for line, words, numbers in _numbers(path, text, 8):
        wrong = "" if abs(np.linalg.norm(numbers[4:]) - 1) < 0.1 else "quaternion is not of length 1"
        poses.add(line, words[0], numbers[1:4], numbers[4:], wrong)
    return poses


def _kitti(path: Path, text: str) -> Poses:
    poses = Poses("KITTI (12 numbers, [R t])", axes="rdf/rdf")
    for row, (line, _words, numbers) in enumerate(_numbers(path, text, 12)):
        matrix = np.array(numbers).reshape(3, 4)
        turn = matrix[:, :3]
        good = np.isfinite(matrix).all() and np.abs(turn @ turn.T - np.eye(3)).max() < _SLACK
        wrong = "" if good and np.linalg.det(turn) > 0 else "its 12 numbers hold no rotation"
        quaternion = (0.0, 0.0, 0.0, 1.0) if wrong else Rotation.from_matrix(turn).as_quat()
        poses.add(line, f"{row:06d}", matrix[:, 3].tolist(), tuple(map(float, quaternion)), wrong)
    return poses


def _euroc(path: Path, text: str) -> Poses:
    # Its header is a comment with units in brackets, `#timestamp [ns], p_RS_R_x [m]`, or without brackets.
    head, _, rest = text.lstrip().lstrip("#").partition("\n")
    names = [re.split(r"[\s\[]", name.strip())[0] for name in head.split(",")]
    poses = read_table_of_poses(path, ",".join(names) + "\n" + rest, [f"{k}={v}" for k, v in _EUROC.items()])
    poses.form, poses.axes = "EuRoC (p_RS_R, q_RS)", "flu/urf"
    return poses


def _airsim(path: Path, text: str) -> Poses:
    columns = _AIRSIM | ({"Front": "ImageFile"} if "ImageFile" in text.partition("\n")[0] else {})
    poses = read_table_of_poses(path, text, [f"{k}={v}" for k, v in columns.items()])
    poses.form = "AirSim recording (POS, Q)"
    for cells in poses.cells:
        cells["ImageFile"] = cells.pop("Front", "")
    return poses


def name_recorded_files(path: Path, poses: Poses, cameras: Mapping[str, str]) -> None:
    """Give each view of a recording the file of its camera among those of `ImageFile`, for `{file}`.

    Args:
        path: what to call the file of poses.
        poses: those of AirSim; others stay as they are. Files are `img_<vehicle>_<camera>_<type>_<time>.png`, type 0 a
            photo, with `;` between them.
        cameras: what each view is called there.

    Raises:
        InputError: the first frame has no file of a camera; the message says what there is.
    """
    for row, cells in enumerate(poses.cells):
        files = [name for name in re.split(r"[;,]", cells.pop("ImageFile", "")) if name]
        for view, camera in cameras.items():
            mine = [name for name in files if name.rsplit("_", 2)[0].endswith(f"_{camera}")]
            mine.sort(key=lambda name: "0" not in name.split("_")[-2:-1])  # stable
            if mine:
                cells[view] = mine[0]
            elif files and row == 0 and view != "Down":
                has = f"ImageFile has no image of camera {camera!r} for {view}, but {', '.join(files)[:100]}"
                ways = "--cameras Front=0 Back=4 ..., or name files yourself, --images 'img_{view}_{frame}.jpg'"
                raise refusal(path, f"{has}: say which is which, {ways}", poses.line[row])


def _colmap(path: Path, text: str, front: str) -> Poses:
    """Camera centres and rotations from the world-to-camera poses of the front camera's images."""
    poses = Poses(f"COLMAP images of the camera {front}", axes="flu/rdf")
    names, folders, expected = [], set[str](), True
    for line, content in enumerate(text.splitlines(), start=1):
        if content.startswith("#"):
            continue
        if not expected or not content.strip():
            expected = True  # the points of an image, possibly none
            continue
        words = content.split(maxsplit=9)
        numbers = [number_of(word) for word in words[:_COLMAP_NUMBERS]]
        if len(words) != 10 or any(number is None for number in numbers):
            raise refusal(path, "no pose of an image (id qw qx qy qz tx ty tz camera name)", line)
        expected = False
        folder, _, name = words[9].strip().rpartition("/")
        folders.add(folder.rpartition("/")[2])
        if folder and folder.rpartition("/")[2] != front:
            continue
        values = [float(number or 0.0) for number in numbers[1:]]
        quaternion = (*values[1:4], values[0])
        wrong = "" if abs(np.linalg.norm(quaternion) - 1) < 0.1 else "quaternion is not of length 1"
        into_world = Rotation.identity() if wrong else Rotation.from_quat(quaternion).inv()
        centre = -into_world.apply(values[4:7])
        names.append(name)
        poses.add(line, name.rpartition(".")[0] or name, centre.tolist(), into_world.as_quat().tolist(), wrong)
    if not names:
        has = ", ".join(sorted(folders)[:8])
        raise refusal(path, f"no image in a folder {front!r}, there are {has!r}; name it: --cameras Front=FOLDER")
    return poses


def _numbers(path: Path, text: str, count: int) -> list[tuple[int, list[str], list[float]]]:
    """Lines of so many numbers."""
    lines = ContentLines(text)
    separator = separator_of(next(iter(ContentLines(text)), ""))
    found = []
    for content in lines:
        words = _words(content, separator)
        numbers = [number_of(word) for word in words]
        if len(words) != count:
            raise refusal(path, f"{len(words)} values, expected {count}", lines.number)
        for word, number in zip(words, numbers, strict=True):
            if number is None:
                raise refusal(path, f"{quoted(word)} is not a number", lines.number)
        found.append((lines.number, words, [number for number in numbers if number is not None]))
    return found


def _words(line: str, separator: str) -> list[str]:
    """Cells of a line, between commas where the file has those."""
    return [word.strip() for word in line.split(",")] if separator == "," else line.split()


_READERS: dict[str, Callable[[Path, str], Poses]] = {"tum": _tum, "kitti": _kitti, "euroc": _euroc, "airsim": _airsim}
