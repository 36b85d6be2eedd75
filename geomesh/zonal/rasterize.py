"""Whose pixel is it: the one walk over the pixels of a triangle.

Statistics, rendering and refinement all walk triangles with the functions
below, so that a pixel has the same owner everywhere. The rule is half-open, on
pixel centres, in pixel-edge coordinates: a triangle owns the pixel (row, col) if

- its lowest y <= row + 0.5 < its highest y, and
- xl <= col + 0.5 < xr, where xl and xr are the two places at which its sides
  cross the line y = row + 0.5.

A side from (xa, ya) to (xb, yb), with ya < yb, crosses the lines ya <= y < yb,
at ``xa + (y - ya) * (xb - xa) / (yb - ya)``, product first; a horizontal side
crosses none. So a line crosses two sides of a triangle, or none.

Why each pixel has one owner. The crossing does not depend on the triangle: both
triangles on an edge start from its end of lower y and get the same float. So a
line that runs through the mesh is cut into half-open intervals that share their
ends, and a pixel centre can be lost or owned twice only if rounding swaps two
crossings around it. Nodes lie on a grid of 2^-8 pixels; there, for sides up to
2^16 pixels long in images up to 2^20 pixels wide, no rounding can:

- the product of two multiples of 2^-8 up to 2^16 has at most 49 bits: exact;
- a crossing that meets a pixel centre does so exactly, because quotient and sum
  are then multiples of 2^-8, which float64 holds; at a node that is the start of
  the side, the quotient is zero;
- any other crossing is at least 2^-16 / (yb - ya) >= 2^-32 pixels away from
  every pixel centre, while quotient and sum err by less than 2^-33 together.

So the comparisons with pixel centres come out as in exact arithmetic. With nodes
off the grid, a pixel may get more than one owner only where two sides pass
within rounding error of its centre.
"""

from __future__ import annotations

import math

from geomesh.arrays.jit import inner

Corners = tuple[float, float, float, float, float, float]


@inner
def sort_corners(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> Corners:
    """Return a triangle's corners by rising y, as (x0, y0, x1, y1, x2, y2).

    What `row_range` and `column_range` start from; the orientation does not matter.
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
    """Return the rows that a triangle's pixels lie in, clipped to [start, stop).

    Half-open, as `range` takes it; empty where the first is not below the second.
    """
    first, last = math.ceil(corners[1] - 0.5), math.ceil(corners[5] - 0.5)
    return max(first, start), min(last, stop)


@inner
def column_range(corners: Corners, row: int, start: int, stop: int) -> tuple[int, int]:
    """Return the columns that a triangle owns in `row`, clipped to [start, stop).

    Half-open, as `range` takes it; empty where the first is not below the second.
    `row` has to be one of the triangle's `row_range`.
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
