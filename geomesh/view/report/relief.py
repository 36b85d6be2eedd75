"""Heights as a picture: a colour for each height, and light from the upper left."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats

# Colours from the lowest height to the highest. Each is lighter than the one before, so they
# differ also for those who see few colours, and in gray print.
_TINTS = np.array(
    [
        (38, 70, 83),
        (62, 113, 104),
        (122, 152, 102),
        (196, 184, 124),
        (232, 219, 180),
        (250, 246, 238),
    ],
    np.float64,
)

# Percentiles of the heights that get the first and the last colour, and that of the slopes that
# are lit as if they were 45 degrees.
_ENDS = (1, 99)
_STEEP = 90

# Direction to the light: left, up on the page, and towards the reader.
_LIGHT = np.array([-1.0, -1.0, 1.2]) / np.linalg.norm([-1.0, -1.0, 1.2])

# Brightness of what faces away from the light.
_SHADE = 0.35


class Scale(NamedTuple):
    """The heights of the first and the last colour, and the slope that is lit as 45 degrees."""

    low: float
    high: float
    steep: float


def find_scale(heights: Floats, step: float = 1.0) -> Scale:
    """Return the scale that suits heights (h, w), which are `step` apart; NaN: none."""
    known = heights[np.isfinite(heights)]
    if not known.size:
        return Scale(0.0, 1.0, 1.0)
    low, high = np.percentile(known, _ENDS)
    slopes = np.hypot(*_gradients(heights, step))
    slopes = slopes[np.isfinite(slopes)]
    steep = float(np.percentile(slopes, _STEEP)) if slopes.size else 0.0
    return Scale(float(low), float(high), steep if steep > 0 else 1.0)


def shaded(heights: Floats, scale: Scale, step: float = 1.0) -> NDArray[np.uint8]:
    """Return the picture of heights.

    Parameters
    ----------
    heights : float64 (h, w)
        Down the page; NaN where there are none.
    scale : Scale
    step : float
        Distance of two pixels, in the unit of the scale's slope.

    Returns
    -------
    uint8 (h, w, 4)
        Red, green, blue and opacity.
    """
    known = np.isfinite(heights)
    spread = scale.high - scale.low
    share = np.clip((np.where(known, heights, scale.low) - scale.low) / (spread or 1.0), 0, 1)
    at = np.linspace(0, 1, len(_TINTS))
    colors = np.stack([np.interp(share, at, _TINTS[:, k]) for k in range(3)], axis=-1)
    down, right = (np.nan_to_num(each / scale.steep) for each in _gradients(heights, step))
    # The normal of the surface is (-right, -down, 1), of length:
    length = np.sqrt(right**2 + down**2 + 1)
    light = (-right * _LIGHT[0] - down * _LIGHT[1] + _LIGHT[2]) / length
    flat = _LIGHT[2]
    bright = _SHADE + (1 - _SHADE) * np.clip(light / flat, 0, 1.15)
    image = np.zeros((*heights.shape, 4), np.uint8)
    image[..., :3] = np.clip(np.rint(colors * bright[..., None]), 0, 255).astype(np.uint8)
    image[..., 3] = np.where(known, 255, 0)
    return image


def _gradients(heights: Floats, step: float) -> tuple[Floats, Floats]:
    """Return the slopes down and right. Where a neighbour has no height, they are NaN."""
    if min(heights.shape) < 2:
        return np.zeros_like(heights), np.zeros_like(heights)
    with np.errstate(invalid="ignore"):
        down, right = np.gradient(heights, step)
    return np.asarray(down), np.asarray(right)
