"""Units: scale pixel values, so that refinement works alike on all rasters and bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask

# The usual spread of a band in these units, as in an 8-bit image.
_SPREAD = 200.0


@dataclass(frozen=True, eq=False)
class Units:
    """The value of each band that becomes 0, and the difference that becomes 1.

    Parameters
    ----------
    offset, scale : float64 (B,)
    """

    offset: Floats
    scale: Floats

    def scaled(self, bands: NDArray[Any]) -> Floats:
        """Return pixel values (B, h, w) in these units."""
        values = bands.astype(np.float64) - self.offset[:, None, None]
        values /= self.scale[:, None, None]
        return values

    def raw(self, values: Floats) -> Floats:
        """Return node values (N, B) in the raster's units."""
        restored: Floats = values * self.scale + self.offset
        return restored


def even_units(bands: NDArray[Any], valid: Mask) -> Units:
    """Return units in which every band has about the same spread.

    The offset is a whole number and the scale a power of two, so whole numbers stay exact
    multiples of a power of two, and their sums exact. 8-bit bands are only shifted.

    Parameters
    ----------
    bands : (B, h, w)
        A sample of the pixels.
    valid : bool (h, w)
    """
    known = bands[:, valid].astype(np.float64)
    low, middle, high = np.percentile(known, (2, 50, 98), axis=1)
    if bands.dtype == np.uint8:
        return Units(np.rint(middle), np.ones(len(bands)))
    with np.errstate(divide="ignore"):
        power = np.rint(np.log2((high - low) / _SPREAD))
    # A band with hardly any spread keeps its own.
    scale = np.exp2(np.clip(np.where(np.isfinite(power), power, 0), -500, 500))
    step = np.where(scale < 1, scale, 1.0)
    return Units(np.rint(middle / step) * step, scale)


# Heights are kept within this share of the bound, so that it holds for the numbers as written.
_WITHIN = 1 - 1e-4


def bound_units(limits: Sequence[float], offset: Floats) -> Units:
    """Return units in which the bound of each band is a little more than 1.

    Parameters
    ----------
    limits : sequence of float
        The bound of each band, in the raster's units.
    offset : float64 (B,)
        Usual values of the bands.
    """
    return Units(offset, np.array(limits, np.float64) * _WITHIN)


def sampled(points: Floats, pixels: Floats, valid: Mask) -> Floats:
    """Return the values (n, B) of the pixels at nodes, or of a valid pixel beside them, or 0.

    `points` are relative to the centre of the first pixel.
    """
    height, width = valid.shape
    values = np.zeros((len(points), len(pixels)))
    missing = np.ones(len(points), np.bool_)
    # A node on a corner of four pixels takes the first valid one of them.
    for dx, dy in ((0.25, 0.25), (-0.25, 0.25), (0.25, -0.25), (-0.25, -0.25)):
        col = np.clip(np.rint(points[:, 0] + dx).astype(int), 0, width - 1)
        row = np.clip(np.rint(points[:, 1] + dy).astype(int), 0, height - 1)
        found = missing & valid[row, col]
        values[found] = pixels[:, row[found], col[found]].T
        missing &= ~found
    return values
