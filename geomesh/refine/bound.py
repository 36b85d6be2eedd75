"""The greatest error of a surface over its pixels, and what heights of a node keep it in bounds.

Values are in units of the bound: the error of every valid pixel, in each band, must be at most 1.
Loops go over the pixels of a triangle, one band after another; NaN pixels count for nothing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.arrays.jit import float64, inner, int64, kernel, void, writes
from geomesh.refine.patch import PATCH, Patch
from geomesh.refine.scan import columns_of
from geomesh.zonal.rasterize import sort_corners

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Points
    from geomesh.refine.star import Star

# The bound, with room for the rounding of float64.
BOUND = 1 + 1e-9

# Heights of a node are unbounded beyond this: no pixel depends on them.
UNBOUNDED = 1e30

# Weight of a node below which its height has no influence on a pixel.
_NO_WEIGHT = 1e-7


@inner
def triangle_error(
    values: Floats,
    image: Floats,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    cx: float,
    cy: float,
    heights: Floats,
    a: int,
    b: int,
    c: int,
) -> tuple[float, int, int, float]:
    """Return the greatest error of a triangle, its column and row, and the sum of error^8.

    The first corner has the heights ``heights[a]``, the others those in `values`.
    """
    corners = sort_corners(ax, ay, bx, by, cx, cy)
    ux, uy, wx, wy = bx - ax, by - ay, cx - ax, cy - ay
    d = ux * wy - uy * wx
    first_row, stop_row = math.ceil(corners[1]), math.ceil(corners[5])
    worst, col, row, total = 0.0, -1, -1, 0.0
    for band in range(image.shape[0]):
        start = heights[a, band]
        fb, fc = values[b, band] - start, values[c, band] - start
        gx, gy = (fb * wy - fc * uy) / d, (fc * ux - fb * wx) / d
        base = start - gx * ax - gy * ay
        for y in range(first_row, stop_row):
            first, stop = columns_of(corners, y)
            height = base + gy * y
            for x in range(first, stop):
                error = image[band, y, x] - height - gx * x
                square = error * error
                if square > worst:
                    worst, col, row = square, x, y
                if square == square:  # noqa: PLR0124  not NaN
                    total += (square * square) * (square * square)
    return math.sqrt(worst), col, row, total


@inner
def measure(
    p: Points,
    triangles: Counts,
    values: Floats,
    image: Floats,
    t: int,
    worst: Floats,
    total: Floats,
    pixel: Counts,
) -> None:
    """Set the greatest error of triangle `t`, its pixel, and the sum of error^8."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    worst[t], pixel[t, 0], pixel[t, 1], total[t] = triangle_error(
        values, image, p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1], values, a, b, c
    )


@kernel(
    void(
        *(PATCH, writes(float64, 2), writes(float64, 3)),
        *(writes(float64, 1), writes(float64, 1), writes(int64, 2)),
    )
)
def measure_bound(
    patch: Patch,
    values: Floats,
    image: Floats,
    worst: Floats,
    total: Floats,
    pixel: Counts,
) -> None:
    """Measure all triangles of a patch.

    Parameters
    ----------
    values : float64 (n, B)
        Heights of the nodes, in units of the bound.
    image : float64 (B, h, w)
    worst : float64 (m,)
        Gets the greatest error of each triangle; 0 if it has no pixel or is not alive.
    total : float64 (m,)
        Gets the sum of error^8.
    pixel : int64 (m, 2)
        Gets the column and row of the greatest error; -1 if there is none.
    """
    for t in range(patch.size[1]):
        worst[t], total[t] = 0.0, 0.0
        if patch.alive[t]:
            measure(patch.points, patch.triangles, values, image, t, worst, total, pixel)


@inner
def heights_of(
    p: Points,
    values: Floats,
    image: Floats,
    star: Star,
    m: int,
    x: float,
    y: float,
    interval: Floats,
) -> float:
    """Find the heights of a node at (x, y) that keep its triangles in bounds.

    Fill ``interval[0]`` with the lowest height of each band and ``interval[1]`` with the highest.
    Return half of the least width; -1 if no height will do.
    """
    least = UNBOUNDED
    for band in range(image.shape[0]):
        low, high = -UNBOUNDED, UNBOUNDED
        base = values[star.first[0], band]
        for j in range(m):
            b, c = star.first[j], star.second[j]
            bx, by, cx, cy = p[b, 0], p[b, 1], p[c, 0], p[c, 1]
            ux, uy, wx, wy = bx - x, by - y, cx - x, cy - y
            d = ux * wy - uy * wx
            # The surface is base + g * (1, x, y) + weight * (height - base).
            weight_x, weight_y = (uy - wy) / d, (wx - ux) / d
            weight_0 = 1 - weight_x * x - weight_y * y
            fb, fc = values[b, band] - base, values[c, band] - base
            gx, gy = (fb * wy - fc * uy) / d, (fc * ux - fb * wx) / d
            start = base - gx * x - gy * y
            corners = sort_corners(x, y, bx, by, cx, cy)
            for row in range(math.ceil(corners[1]), math.ceil(corners[5])):
                first, stop = columns_of(corners, row)
                height, weight_row = start + gy * row, weight_0 + weight_y * row
                for col in range(first, stop):
                    error = image[band, row, col] - height - gx * col
                    weight = weight_row + weight_x * col
                    if weight < _NO_WEIGHT:
                        if abs(error) > BOUND:
                            return -1.0
                        continue
                    inverse = 1 / weight
                    one, other = (error - 1) * inverse, (error + 1) * inverse
                    if one > low:  # noqa: PLR1730  not NaN
                        low = one
                    if other < high:  # noqa: PLR1730
                        high = other
                if low > high:
                    return -1.0
        interval[0, band], interval[1, band] = base + low, base + high
        least = min(least, (high - low) / 2)
    return least


@inner
def take_middle(values: Floats, v: int, interval: Floats, row: int) -> None:
    """Give node `v` the middle of the intervals in two rows; leave heights that have none."""
    for band in range(values.shape[1]):
        low, high = interval[row, band], interval[row + 1, band]
        if high - low < UNBOUNDED:
            values[v, band] = (low + high) / 2
