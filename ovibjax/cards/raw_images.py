"""Raw-image offloading: what the five views of a frame take as image files, and how long their upload takes.

The paper's 891.5 KB are 12 bit a pixel at the released 400 x 300, which no lossy codec spends: PNG files, as its data
set has them. At 2 Mbps they take 3.57 s, the 99.3 % of its 3.59 s that it says the upload takes (KB of 1,000 bytes).
"""

import numpy as np
from numpy.typing import NDArray

from ovibjax.cards.retrieval_benchmark import town_of
from ovibjax.link.latency import transmit_s
from ovibjax.world.town.files import png
from ovibjax.world.town.layout import make_town
from ovibjax.world.town.render import FRAME_CAMERA, Camera, render_frames
from ovibjax.world.town.route import make_route

UPLINK_BPS = 2e6
"""The paper: "Raw-image retrieval uses a 2 Mbps uplink." """
PAPER_KB, PAPER_UPLOAD_S = 891.5, 0.993 * 3.59
"""The paper's mean payload, and the part of raw-image offloading that is upload."""

_DRIVE = 200  # frames; those taken lie evenly along it
# The size of the released images, with the programs that rendered the drives.
_CAMERA = Camera(FRAME_CAMERA.height_px, FRAME_CAMERA.width_px)


def raw_payload_bytes(towns: int, frames: int) -> NDArray[np.int64]:
    """Size of the five views of some frames as PNG files.

    Args:
        towns: scenes of the retrieval benchmark.
        frames: how many frames of each.

    Returns:
        [towns * frames] bytes a frame.
    """
    sizes = []
    for scene in range(towns):
        config = town_of(scene)
        town = make_town(config)
        route = make_route(town, config, _DRIVE, seed=0)
        taken = np.linspace(0, _DRIVE - 1, frames).astype(np.int64)
        for _, views in render_frames(town, route, taken, _CAMERA):
            pixels = np.round(np.asarray(views.rgb) * 255).astype(np.uint8)
            sizes.append(sum(len(png(view)) for view in pixels))
    return np.array(sizes, np.int64)


def upload_s(payload_bytes: NDArray[np.int64]) -> NDArray[np.float32]:
    """Seconds that payloads take on the uplink of raw images.

    Args:
        payload_bytes: [n] bytes.

    Returns:
        [n] seconds.
    """
    return np.asarray(transmit_s(payload_bytes, UPLINK_BPS))
