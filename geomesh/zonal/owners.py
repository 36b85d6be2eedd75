"""The triangle that owns each pixel, as an image of triangle ids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import contiguous, float64, int32, int64, kernel, reads, void, writes
from geomesh.mesh.topology import FILL
from geomesh.zonal.rasterize import column_range, row_range, sort_corners

if TYPE_CHECKING:
    from geomesh.arrays.types import Ids, Points, Triangles
    from geomesh.raster.grid import Window


def find_owners(nodes: Points, triangles: Triangles, window: Window) -> Ids:
    """Return the triangle that owns each pixel of a window.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
        In either orientation.
    window : Window

    Returns
    -------
    int32 (height, width)
        Triangle ids; `FILL` where no triangle owns the pixel. Where triangles overlap,
        the last triangle owns the pixel.
    """
    owners = np.full(window.shape, FILL, np.int32)
    nodes, triangles = contiguous(nodes, np.float64), contiguous(triangles, np.int32)
    _fill_owners(nodes, triangles, window.row, window.col, owners)
    return owners


@kernel(void(reads(float64, 2), reads(int32, 2), int64, int64, writes(int32, 2)))
def _fill_owners(nodes: Points, triangles: Triangles, row: int, col: int, owners: Ids) -> None:
    height, width = owners.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        corners = sort_corners(
            nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        )
        top, bottom = row_range(corners, row, row + height)
        for r in range(top, bottom):
            first, last = column_range(corners, r, col, col + width)
            for k in range(first, last):
                owners[r - row, k - col] = t
