"""The Hilbert curve: places that are near each other on it are near each other in the plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def along_hilbert(x: NDArray[np.int64], y: NDArray[np.int64], bits: int) -> NDArray[np.int64]:
    """Return the place along the curve (n,) of cells of a square of 2**bits cells a side.

    Parameters
    ----------
    x, y : int64 (n,)
        0 to 2**bits - 1. The curve begins at (0, 0), as that of PMTiles.
    bits : int
    """
    x, y = x.astype(np.int64), y.astype(np.int64)
    places = np.zeros(len(x), np.int64)
    for side in (1 << level for level in reversed(range(bits))):
        right, below = (x & side) > 0, (y & side) > 0
        places += side * side * ((3 * right) ^ below)
        turned = right & ~below
        x, y = np.where(turned, side - 1 - x, x), np.where(turned, side - 1 - y, y)
        x, y = np.where(below, x, y), np.where(below, y, x)
    return places
