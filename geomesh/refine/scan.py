"""Which pixels a triangle owns: every pixel belongs to one triangle, whatever is changed.

The corners are on the lattice of 1/256 pixel, so the columns at which a side crosses the rows are
the same for the two triangles at the side. The rule is that of `geomesh.zonal.rasterize`, with
coordinates relative to pixel centres.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.arrays.jit import inner
from geomesh.zonal.rasterize import Corners, sort_corners

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Points


@inner
def rows_of(triangles: Counts, p: Points, t: int) -> Corners:
    """Return the corners of triangle `t` sorted by y."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    return sort_corners(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1])


@inner
def columns_of(corners: Corners, row: int) -> tuple[int, int]:
    """Return the first and stop column that a triangle with these sorted corners owns."""
    ax, ay, bx, by, cx, cy = corners
    one = ax + (row - ay) * (cx - ax) / (cy - ay)
    if row < by:
        other = ax + (row - ay) * (bx - ax) / (by - ay)
    else:
        other = bx + (row - by) * (cx - bx) / (cy - by)
    return math.ceil(min(one, other)), math.ceil(max(one, other))
