"""Compiled loops that fit a surface to pixels, and measure how far it is from them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.arrays.jit import boolean, float64, inner, int32, int64, kernel, reads, void, writes
from geomesh.zonal.rasterize import column_range, row_range, sort_corners

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Mask, Points, Triangles

Weights = tuple[float, float, float, float, float, float]


@inner
def barycentric_matrix(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> Weights:
    """Return the first corner and the 2 x 2 matrix that `barycentric` needs for a triangle."""
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    return ax, ay, (cy - ay) / area, (ax - cx) / area, (ay - by) / area, (bx - ax) / area


@inner
def barycentric(weights: Weights, row: int, col: int) -> tuple[float, float]:
    """Return the barycentric coordinates of a pixel centre for the second and third corner."""
    ax, ay, bx, by, cx, cy = weights
    x, y = col + 0.5 - ax, row + 0.5 - ay
    return x * bx + y * by, x * cx + y * cy


@kernel(
    void(
        reads(float64, 2),
        reads(int32, 2),
        reads(float64, 2),
        reads(float64, 3),
        reads(boolean, 2),
        int64,
        int64,
        writes(float64, 2),
        writes(float64, 2),
    )
)
def project(
    nodes: Points,
    triangles: Triangles,
    values: Floats,
    bands: NDArray[np.float64],
    valid: Mask,
    row: int,
    col: int,
    gram: Floats,
    moments: Floats,
) -> None:
    """Add the normal equations of the valid pixels to `gram` and `moments`.

    The first pixel of `valid` (h, w) is (row, col). Let p, q, r be the barycentric
    coordinates of a pixel centre. In the row of the triangle, pp, pq, pr, qq, qr and rr are
    added to `gram` (T, 6). In the rows of the three corners, the difference between `bands`
    (B, h, w) and the surface of `values` (N, B), times p, q and r, is added to `moments`
    (N, B).
    """
    height, width = valid.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        one = nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        corners, weights = sort_corners(*one), barycentric_matrix(*one)
        top, bottom = row_range(corners, row, row + height)
        for r in range(top, bottom):
            first, last = column_range(corners, r, col, col + width)
            for k in range(first, last):
                if not valid[r - row, k - col]:
                    continue
                u, v = barycentric(weights, r, k)
                w = 1 - u - v
                gram[t, 0] += w * w
                gram[t, 1] += w * u
                gram[t, 2] += w * v
                gram[t, 3] += u * u
                gram[t, 4] += u * v
                gram[t, 5] += v * v
                for band in range(len(bands)):
                    start = values[a, band]
                    surface = start + u * (values[b, band] - start) + v * (values[c, band] - start)
                    above = bands[band, r - row, k - col] - surface
                    moments[a, band] += w * above
                    moments[b, band] += u * above
                    moments[c, band] += v * above


@kernel(
    void(
        reads(float64, 2),
        reads(int32, 2),
        reads(float64, 2),
        reads(float64, 2),
        reads(boolean, 2),
        int64,
        int64,
        writes(int64, 1),
        writes(float64, 2),
        writes(float64, 1),
    )
)
def measure_errors(
    nodes: Points,
    triangles: Triangles,
    values: Floats,
    band: Floats,
    valid: Mask,
    row: int,
    col: int,
    count: Counts,
    errors: Floats,
    limits: Floats,
) -> None:
    """Measure how far the valid pixels of each triangle are from the surface of one band.

    The first pixel of `band` and `valid` (h, w) is (row, col). The surface is the one that
    `geomesh.surface.paint_kernel` paints. A pixel at which it is not finite has an infinite error.

    Parameters
    ----------
    values : float64 (T, 3)
        At the corners of each triangle.
    count : int64 (T,)
        Output: number of valid pixels.
    errors : float64 (2, T)
        Output: the greatest error, and the square root of the sum of the squared errors. The
        sum is of squares relative to the greatest error so far: so it does not overflow.
    limits : float64 (2,)
        Changed to the minimum and maximum of the band in these pixels, and before.
    """
    height, width = valid.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        one = nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        corners, weights = sort_corners(*one), barycentric_matrix(*one)
        start, second, third = (
            values[t, 0],
            values[t, 1] - values[t, 0],
            values[t, 2] - values[t, 0],
        )
        found, greatest, squares = 0, 0.0, 0.0
        top, bottom = row_range(corners, row, row + height)
        for r in range(top, bottom):
            first, last = column_range(corners, r, col, col + width)
            for k in range(first, last):
                if not valid[r - row, k - col]:
                    continue
                u, v = barycentric(weights, r, k)
                value = band[r - row, k - col]
                error = abs(value - (start + u * second + v * third))
                found += 1
                limits[0], limits[1] = min(limits[0], value), max(limits[1], value)
                if not error < math.inf:  # also if it is NaN
                    greatest, squares = math.inf, 1.0
                elif error > greatest:
                    ratio = greatest / error
                    greatest, squares = error, squares * ratio * ratio + 1
                elif error > 0:
                    ratio = error / greatest
                    squares += ratio * ratio
        count[t] = found
        errors[0, t], errors[1, t] = greatest, greatest * math.sqrt(squares)
