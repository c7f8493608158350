"""Small data sets on disk, a backbone without a network, and what comes of the one with the other."""

import io
import json
import tarfile
from pathlib import Path

import numpy as np
from PIL import Image

from ovibjax.features.backbones.by_name import Backbone
from ovibjax.features.images.by_path import open_source
from ovibjax.features.images.extraction import extract
from ovibjax.views import VIEWS

WIDTH, HEIGHT = 12, 9
N, BATCH = 11, 2
MIX = np.random.default_rng(7).normal(size=(3 * 4 * 4, 6)).astype(np.float32)


def pixels(*seed: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def encode(rgb: np.ndarray, kind: str = "png", **options) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, kind, **options)
    return stream.getvalue()


def about(frame: int, **changes) -> dict:
    """Metadata as CARLA's collector writes them."""
    state = {
        "position": {"x": 3.0 * frame, "y": -2.5 * frame, "z": 30.0},
        "rotation": {"pitch": 0.0, "yaw": 15.0 * frame, "roll": 0.0},
    }
    return {"frame_id": f"{frame:06d}", "timestamp": 0.1 * frame, "uav_state": state, "map_name": "Town05"} | changes


def write(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def write_layout(root: Path, n: int = 3, views=VIEWS, kind: str = "png", **changes) -> Path:
    """A town in the released layout; the images of frame i and view m are `pixels(i, m)`."""
    for frame in range(n):
        for view, camera in enumerate(views):
            content = encode(pixels(frame, view), "jpeg" if kind == "jpg" else kind)
            write(root / "rgb" / camera / f"{frame:06d}.{kind}", content)
        write(root / "metadata" / f"{frame:06d}.json", json.dumps(about(frame, **changes)).encode())
    return root


def write_table(root: Path, n: int = 3, views=VIEWS) -> Path:
    """`my.csv` with images in `images/{view}/{frame}.png`."""
    rows = ["frame,x_m,y_m,z_m,yaw_deg"]
    for frame in range(n):
        for view, camera in enumerate(views):
            write(root / "images" / camera / f"{frame}.png", encode(pixels(frame, view)))
        rows.append(f"{frame},{3 * frame},{2 * frame},30,{15 * frame}")
    return write(root / "my.csv", "\n".join(rows).encode())


def pack(folder: Path, archive: Path, mode: str = "w") -> Path:
    """The folder's content as an archive, in the order of names."""
    with tarfile.open(archive, mode) as tar:
        for file in sorted(folder.rglob("*")):
            tar.add(file, str(file.relative_to(folder)), recursive=False)
    return archive


def preprocess(rgb: np.ndarray) -> np.ndarray:
    return np.asarray(Image.fromarray(rgb).resize((4, 4), Image.Resampling.BOX), np.float32) / 255


def embed(inputs: np.ndarray) -> np.ndarray:
    return (inputs.reshape(len(inputs), -1) - np.float32(0.5)) @ MIX


def tiny_backbone(name: str = "tiny", fingerprint: str = "00", embed=embed) -> Backbone:
    return Backbone(name, fingerprint, preprocess, embed)


def run(town, out, backbone=None, **options):
    source = open_source(town)
    try:
        return extract(source, backbone or tiny_backbone(), out, **{"batch": BATCH, **options})
    finally:
        source.close()


def listing(folder):
    return sorted(entry.name for entry in folder.iterdir())


def frames_of(path, **options):
    source = open_source(path, **options)
    images = [[source.read(image) for image in frame.images] for frame in source.frames]
    source.close()
    return source, images
