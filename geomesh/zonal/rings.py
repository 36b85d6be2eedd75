"""Find the pixels inside rings: those whose centre an even-odd fill of the ring covers.

It is for polygons of any number of sides, which need not be sound: the pieces of triangles that
are read from tiles. `geomesh.zonal.rasterize` is for triangles, and exact.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import contiguous, float64, int64, kernel, reads, uint8, void, writes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.raster.grid import Window


def fill_rings(
    points: Points, starts: NDArray[np.int64], window: Window, inside: NDArray[np.uint8]
) -> None:
    """Set the pixels to 1 whose centre lies in a ring.

    Parameters
    ----------
    points : float64 (P, 2)
        Pixel-edge coordinates.
    starts : int64 (R + 1,)
        Where each ring begins in `points`, and the end of the last. Rings are closed.
    window : Window
        The pixels of `inside`.
    inside : uint8 (height, width)
        Changed in place.
    """
    most = int(np.diff(starts).max(initial=0))
    _fill(
        contiguous(points, np.float64),
        contiguous(starts, np.int64),
        window.row,
        window.col,
        np.empty(most),
        inside,
    )


@kernel(
    void(reads(float64, 2), reads(int64, 1), int64, int64, writes(float64, 1), writes(uint8, 2))
)
def _fill(
    points: Points,
    starts: NDArray[np.int64],
    row: int,
    col: int,
    crossings: Floats,
    inside: NDArray[np.uint8],
) -> None:
    height, width = inside.shape
    for ring in range(len(starts) - 1):
        start, stop = starts[ring], starts[ring + 1]
        low, high = math.inf, -math.inf
        for k in range(start, stop):
            low, high = min(low, points[k, 1]), max(high, points[k, 1])
        top = max(math.ceil(low - 0.5), row)
        bottom = min(math.ceil(high - 0.5), row + height)
        for r in range(top, bottom):
            y = r + 0.5
            count = 0
            for k in range(start, stop - 1):
                xa, ya, xb, yb = points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
                if ya > yb:  # the same crossing for the rings on both sides
                    xa, ya, xb, yb = xb, yb, xa, ya
                if ya <= y < yb:
                    x = xa + (y - ya) * (xb - xa) / (yb - ya)
                    place = count
                    while place > 0 and crossings[place - 1] > x:
                        crossings[place] = crossings[place - 1]
                        place -= 1
                    crossings[place] = x
                    count += 1
            for k in range(0, count - 1, 2):
                first = max(math.ceil(crossings[k] - 0.5), col)
                last = min(math.ceil(crossings[k + 1] - 0.5), col + width)
                for c in range(first, last):
                    inside[r - row, c - col] = 1
