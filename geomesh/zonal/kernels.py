"""Compiled loops of `geomesh.zonal`: the pixels of triangles, and moments of their values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.arrays.jit import boolean, float64, int32, int64, kernel, reads, void, writes
from geomesh.zonal.rasterize import column_range, row_range, sort_corners

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Ids, Mask, Points, Triangles


@kernel(
    void(
        reads(float64, 2),
        reads(int32, 2),
        reads(boolean, 2),
        reads(int64, 1),
        reads(int64, 1),
        writes(int64, 1),
        writes(int64, 1),
        writes(int32, 1),
    )
)
def collect_pixels(
    nodes: Points,
    triangles: Triangles,
    valid: Mask,
    origin: NDArray[np.int64],
    box: NDArray[np.int64],
    pixels: Counts,
    stops: Counts,
    members: Ids,
) -> None:
    """List the flat indices of the valid pixels of triangles, one triangle after the other.

    Parameters
    ----------
    valid : bool (h, w)
        Its first pixel is `origin` (row, col).
    box : int64 (4,)
        First and stop row, first and stop column: only pixels inside are counted.
    pixels : int64 (T,)
        Output: number of pixels that each triangle owns.
    stops : int64 (T,)
        Output: where the pixels of each triangle end in `members`.
    members : int32 (P + 1,)
        Output, with space for the P pixels of the box and one more.
    """
    width, found = valid.shape[1], 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        corners = sort_corners(
            nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        )
        owned = 0
        top, bottom = row_range(corners, box[0], box[1])
        for row in range(top, bottom):
            first, last = column_range(corners, row, box[2], box[3])
            owned += max(last - first, 0)
            r = row - origin[0]
            for col in range(first - origin[1], last - origin[1]):
                # Always written, but counted only if valid: a branch would be slower.
                members[found] = r * width + col
                found += valid[r, col]
        pixels[t] = owned
        stops[t] = found


@kernel(void(reads(float64, 1), reads(int32, 1), reads(int64, 1), writes(float64, 2)))
def find_moments(values: Floats, members: Ids, stops: Counts, moments: Floats) -> None:
    """Compute mean, sum of squared deviations, minimum and maximum of each triangle's pixels.

    Sums are relative to the triangle's first value. Because it is one of the values, the
    correction subtracted at the end is of the same order as the sum itself. For integers of
    up to 16 bits every sum is exact.

    Parameters
    ----------
    values : float64 (P,)
    members, stops
        The output of `collect_pixels`.
    moments : float64 (4, T)
        Output; not changed for triangles without a pixel.
    """
    start = 0
    for t in range(len(stops)):
        stop = stops[t]
        if stop > start:
            origin = values[members[start]]
            total, squares, low, high = 0.0, 0.0, origin, origin
            for i in range(start, stop):
                value = values[members[i]]
                difference = value - origin
                total += difference
                squares += difference * difference
                low, high = min(low, value), max(high, value)
            shift = total / (stop - start)
            moments[0, t], moments[1, t] = origin + shift, max(squares - total * shift, 0.0)
            moments[2, t], moments[3, t] = low, high
        start = stop


@kernel(
    void(
        reads(float64, 2), reads(float64, 1), reads(boolean, 2), reads(int64, 1), writes(float64, 1)
    )
)
def blend_pixels(
    points: Points, values: Floats, valid: Mask, origin: NDArray[np.int64], blended: Floats
) -> None:
    """Compute values at points, interpolated bilinearly between the four pixels around each.

    Pixels that are not valid, or outside the image, have no weight; the others get more.
    Values are computed relative to one of the pixels: if all are equal, the result is equal
    to them to the last bit. Without a valid pixel the result is NaN.

    Parameters
    ----------
    points : float64 (P, 2)
        Pixel-edge coordinates.
    values : float64 (h * w,)
        Values of the pixels of `valid` (h, w), whose first pixel is `origin` (row, col).
    blended : float64 (P,)
        Output.
    """
    height, width = valid.shape
    for p in range(len(points)):
        x, y = points[p, 0] - 0.5 - origin[1], points[p, 1] - 0.5 - origin[0]
        left, top = math.floor(x), math.floor(y)
        total, base, above = 0.0, values[0], 0.0
        for corner in range(4):
            row, col = top + corner // 2, left + corner % 2
            if 0 <= row < height and 0 <= col < width and valid[row, col]:
                value = values[row * width + col]
                weight = (1 - abs(x - col)) * (1 - abs(y - row))
                if total == 0:
                    base = value
                total += weight
                above += weight * (value - base)
        blended[p] = base + above / total
