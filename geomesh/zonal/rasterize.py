"""Rasterize a triangle: find the rows and columns of the pixels that it owns.

Statistics and rendering both use the functions below, so a pixel has the same owner
everywhere. The rule is half-open and uses pixel centres, in pixel-edge coordinates. A
triangle owns the pixel (row, col) if

- its lowest y <= row + 0.5 < its highest y, and
- xl <= col + 0.5 < xr, where xl and xr are the two places at which its sides cross the
  line y = row + 0.5.

A side from (xa, ya) to (xb, yb), with ya < yb, crosses the lines ya <= y < yb, at
``xa + (y - ya) * (xb - xa) / (yb - ya)``. The product is computed first. A horizontal side
crosses no line. So a line crosses two sides of a triangle, or none.

Why each pixel has exactly one owner: The crossing does not depend on the triangle. Both
triangles of an edge start from its end with the lower y and get the same float. So the
crossings cut a line through the mesh into half-open intervals that share their ends. A
pixel centre could have no owner or two owners only if rounding swapped two crossings
around it. Nodes lie on a grid of 2^-8 pixels. For such nodes, sides up to 2^16 pixels long
and images up to 2^20 pixels wide, rounding cannot do this:

- The product of two multiples of 2^-8, each up to 2^16, has at most 49 bits: it is exact.
- A crossing at a pixel centre is computed exactly, because quotient and sum are then
  multiples of 2^-8, which float64 can represent. At the node where the side starts, the
  quotient is zero.
- Any other crossing is at least 2^-16 / (yb - ya) >= 2^-32 pixels away from every pixel
  centre. The errors of quotient and sum together are less than 2^-33.

So comparisons with pixel centres give the same result as exact arithmetic. If nodes are
not on the grid, a pixel can have more than one owner, but only where two sides are within
the rounding error of its centre.
"""

from __future__ import annotations

import math

from geomesh.arrays.jit import inner

Corners = tuple[float, float, float, float, float, float]


@inner
def sort_corners(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> Corners:
    """Return the corners of a triangle by increasing y, as (x0, y0, x1, y1, x2, y2).

    `row_range` and `column_range` need this order. The orientation does not matter.
    """
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    if by > cy:
        bx, by, cx, cy = cx, cy, bx, by
        if ay > by:
            ax, ay, bx, by = bx, by, ax, ay
    return ax, ay, bx, by, cx, cy


@inner
def row_range(corners: Corners, start: int, stop: int) -> tuple[int, int]:
    """Return the first and stop row of a triangle's pixels, clipped to [start, stop).

    The range is half-open, as in `range`; it is empty if first >= stop.
    """
    first, last = math.ceil(corners[1] - 0.5), math.ceil(corners[5] - 0.5)
    return max(first, start), min(last, stop)


@inner
def column_range(corners: Corners, row: int, start: int, stop: int) -> tuple[int, int]:
    """Return the first and stop column that a triangle owns in `row`, clipped to [start, stop).

    The range is half-open, as in `range`; it is empty if first >= stop. `row` must be in the
    `row_range` of the triangle.
    """
    x0, y0, x1, y1, x2, y2 = corners
    y = row + 0.5
    one = x0 + (y - y0) * (x2 - x0) / (y2 - y0)
    if y < y1:
        other = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    else:
        other = x1 + (y - y1) * (x2 - x1) / (y2 - y1)
    first, last = math.ceil(min(one, other) - 0.5), math.ceil(max(one, other) - 0.5)
    return max(first, start), min(last, stop)
