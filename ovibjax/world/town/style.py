"""What a town looks like, drawn from a number: façades, windows, heights, greenery, ground, and the light of its day.

Style 0 is the default town's. The ranges of the others are what the towns of CARLA, in which the paper flies, span by
eye: villages of two storeys to downtowns of glass, sparse to leafy streets, and its weather presets from a low sun in
haze to a clear noon. They were set once, before any retrieval was run on them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROAD, WALK, YARD, GRASS = range(4)
"""Rows of `Look.ground`."""

_PALETTE = np.array(
    [
        *([0.72, 0.66, 0.58], [0.60, 0.32, 0.24], [0.80, 0.78, 0.74], [0.45, 0.50, 0.56], [0.76, 0.56, 0.36]),
        *([0.52, 0.58, 0.48], [0.86, 0.80, 0.62], [0.36, 0.40, 0.46], [0.68, 0.44, 0.40], [0.58, 0.66, 0.72]),
        *([0.84, 0.70, 0.66], [0.44, 0.34, 0.30]),
    ],
    np.float32,
)
_SUN = (0.46, -0.54, 0.705)
_SUNLIGHT, _SKYLIGHT = (0.95, 0.89, 0.78), (0.38, 0.44, 0.54)
_SKY_TOP, _HORIZON = (0.10, 0.26, 0.62), (0.56, 0.66, 0.78)
_GROUND = ((0.97, 0.98, 1.04), (1.04, 1.0, 0.94), (1.08, 1.0, 0.86), (0.24, 0.36, 0.13))
_LEAF = ((0.16, 0.30, 0.10), (0.20, 0.08, 0.0))
_GLASS = (0.8, 0.95, 1.1)
_DRY, _OVERCAST = np.array([0.40, 0.34, 0.16]), np.array([0.52, 0.56, 0.60])
_MATERIALS = 5  # colours that a town builds with


class Look(NamedTuple):
    """Numbers that the renderer shades with; float32 arrays, so that all towns share its programs.

    Attributes:
        sun: [3] unit direction towards the sun.
        sun_inverse: [3] one over each component, for the slab test of shadows.
        sunlight: [3] colour of direct light.
        skylight: [3] colour of light from all around.
        haze_m: scalar, distance at which 63 % of a colour is haze.
        sky_top: [3] colour of the sky overhead.
        horizon: [3] colour of the sky at the horizon, and of haze.
        clear: scalar, the share of noise below which there is no cloud.
        ground: [4, 3] tints of carriageway, pavement, yards and lawns.
        leaf: [2, 3] colour of crowns, and what is added for a warm one.
        glass: [3] tint of window panes.
    """

    sun: Any
    sun_inverse: Any
    sunlight: Any
    skylight: Any
    haze_m: Any
    sky_top: Any
    horizon: Any
    clear: Any
    ground: Any
    leaf: Any
    glass: Any


class TownStyle(NamedTuple):
    """How a town is built and lit.

    Attributes:
        look: what the renderer shades with.
        palette: [12, 3] colours of façades, drawn from evenly.
        height: factor of the heights of buildings.
        bay: factor of the distance between windows.
        storey: factor of the heights of storeys.
        window: factor of the share of a bay that is glass.
        trees: factor of the number of trees.
        crown: factor of the radius of crowns.
    """

    look: Look
    palette: NDArray[np.float32]
    height: float = 1.0
    bay: float = 1.0
    storey: float = 1.0
    window: float = 1.0
    trees: float = 1.0
    crown: float = 1.0


def make_style(number: int) -> TownStyle:
    """Draw a style.

    Args:
        number: which style, not negative; 0 is the default town's.

    Returns:
        The style; equal numbers give equal styles.
    """
    if number == 0:
        return TownStyle(DEFAULT_LOOK, _PALETTE)
    rng = np.random.default_rng([number, 0x57])
    # A town builds with a few materials, all of them a little warmer or colder, lighter or darker than elsewhere.
    materials = _PALETTE[rng.choice(len(_PALETTE), _MATERIALS, replace=False)] * rng.uniform(0.85, 1.15, 3)
    palette = np.clip(materials, 0.08, 0.95)[np.arange(len(_PALETTE)) % _MATERIALS]
    return TownStyle(
        look=_draw_look(rng),
        palette=palette.astype(np.float32),
        height=rng.uniform(0.6, 1.4),
        bay=rng.uniform(0.75, 1.5),
        storey=rng.uniform(0.9, 1.2),
        window=rng.uniform(0.6, 1.3),
        trees=rng.uniform(0.3, 2.0),
        crown=rng.uniform(0.8, 1.25),
    )


def _draw_look(rng: np.random.Generator) -> Look:
    """Light of an hour and a weather, and the colours of ground and leaves under it."""
    # The sun keeps off the axes of the streets, so that no wall is lit along its plane.
    azimuth = np.deg2rad(90.0 * rng.integers(4) + rng.uniform(15.0, 75.0))
    elevation_deg, cloud, dry = rng.uniform(20.0, 70.0), rng.uniform(), rng.uniform(0.0, 0.6)
    elevation = np.deg2rad(elevation_deg)
    low_sun = (70.0 - elevation_deg) / 50.0
    sun = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    # A low sun is redder; clouds take light from it, give some to the sky, and grey it.
    sunlight = np.array(_SUNLIGHT) * (1.1 - 0.5 * cloud) * (1 - low_sun * np.array([0.0, 0.12, 0.3]))
    grey = 0.7 * cloud * _OVERCAST
    green = rng.uniform(0.75, 1.25) * (1 - dry)
    ground = np.array(_GROUND) * rng.uniform(0.75, 1.25, (4, 1)) * rng.uniform(0.94, 1.06, (4, 3))
    ground[GRASS] = (1 - dry) * ground[GRASS] + dry * _DRY
    return _look(
        sun=sun,
        sunlight=sunlight,
        skylight=np.array(_SKYLIGHT) * (0.9 + 0.3 * cloud),
        haze_m=np.exp(rng.uniform(np.log(120.0), np.log(500.0))),
        sky_top=(1 - 0.7 * cloud) * np.array(_SKY_TOP) + grey,
        horizon=((1 - 0.7 * cloud) * np.array(_HORIZON) + grey) * (1 - low_sun * np.array([-0.1, 0.05, 0.15])),
        clear=0.62 - 0.3 * cloud,
        ground=ground,
        leaf=np.array([green * np.array(_LEAF[0]) + dry * _DRY, _LEAF[1]]),
        glass=np.array(_GLASS) * rng.uniform(0.8, 1.2, 3),
    )


def _look(**fields: Any) -> Look:
    arrays = {name: np.asarray(value, np.float32) for name, value in fields.items()}
    inverse = (1 / np.asarray(fields["sun"], np.float64)).astype(np.float32)
    return Look(**arrays, sun_inverse=inverse)


DEFAULT_LOOK = _look(
    sun=_SUN,
    sunlight=_SUNLIGHT,
    skylight=_SKYLIGHT,
    haze_m=210.0,
    sky_top=_SKY_TOP,
    horizon=_HORIZON,
    clear=0.48,
    ground=_GROUND,
    leaf=_LEAF,
    glass=_GLASS,
)
"""The light and colours of style 0."""
