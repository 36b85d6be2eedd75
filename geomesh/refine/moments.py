"""Moments of an image over triangles, summed along their edges.

`prefix_sums` adds up each row of the image once. The sum over one row of a triangle is then the
difference of two entries, where the triangle's sides cross the row. So the sum over a triangle
is the sum of three signed sums, one along each side. A flip needs the sums along one new edge,
and a move those along the edges at its node, whatever the number of pixels in between.

The moments of a side or a triangle are, over valid pixels only: the number of pixels and the
sums of x, y, xx, xy and yy; then for each band the sums of f, xf, yf and ff, where f is the value.
All are exact for whole numbers up to 2^53.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import float64, inner, int64, kernel, named, void, writes
from geomesh.refine.patch import PATCH, Patch

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Mask, Points

# Moments that do not depend on a band, and moments of each band.
OF_PIXELS, OF_BAND = 6, 4

# Crossings are computed this much further left, so that rounding never moves one from a pixel
# centre to its right. It exceeds the rounding errors, and other crossings of sides up to 2^16
# pixels long are at least 2^-32 pixels away from pixel centres: see `geomesh.zonal.rasterize`.
_LEFT = 2.0**-33

# The objective: a linear surface with values at the nodes, or one value for each triangle.
LINEAR, CONSTANT = 0, 1


class Image(NamedTuple):
    """The pixels of a patch.

    Attributes
    ----------
    sums : float64 (h, w + 1, 3 + 3 B)
        Prefix sums of each row: of 1, x, xx over the valid pixels, then of f, xf, ff for each
        band. Entry [y, c] has the pixels of row y with x < c.
    values : float64 (B, h, w)
        NaN where the pixel is not valid.
    crossings : int64 (h + 1,)
        Room for the columns at which one edge crosses the rows.
    """

    sums: Floats
    values: Floats
    crossings: Counts


class Surface(NamedTuple):
    """The values of a patch's nodes, and the moments of its triangles.

    Attributes
    ----------
    values : float64 (n, B)
        Values at the nodes. Not used by the constant model.
    along : float64 (3 m, K)
        Moments along the side opposite to corner k of triangle t, in the direction of the
        triangle, in row 3 t + k.
    moments : float64 (m, K)
        Moments of each triangle: the sum over its sides.
    errors : float64 (m,)
        Sum of the squared errors of each triangle, over pixels and bands; -1 if it is not alive.
    """

    values: Floats
    along: Floats
    moments: Floats
    errors: Floats


IMAGE = named(Image, writes(float64, 3), writes(float64, 3), writes(int64, 1))
SURFACE = named(
    Surface, writes(float64, 2), writes(float64, 2), writes(float64, 2), writes(float64, 1)
)


def image_of(bands: Floats, valid: Mask) -> Image:
    """Return the image of a patch from values (B, h, w) and the mask of valid pixels (h, w)."""
    count, height, width = bands.shape
    sums = np.zeros((height, width + 1, 3 + 3 * count))
    x = np.arange(width, dtype=np.float64)
    known = valid.astype(np.float64)
    values = np.where(valid, bands, 0.0)
    columns = [known, known * x, known * (x * x)]
    for band in values:
        columns += [band, band * x, band * band]
    for k, column in enumerate(columns):
        np.cumsum(column, axis=1, out=sums[:, 1:, k])
    return Image(sums, np.where(valid, bands, np.nan), np.zeros(height + 1, np.int64))


@inner
def moments_along(
    px: float,
    py: float,
    qx: float,
    qy: float,
    sums: Floats,
    crossings: Counts,
    result: Floats,
    i: int,
) -> None:
    """Fill row `i` of `result` with the moments of the pixels left of the edge from p to q.

    They count as positive where the edge goes down (y grows), else as negative.
    """
    sign = 1.0
    if qy < py:
        px, py, qx, qy = qx, qy, px, py
        sign = -1.0
    first, stop = math.ceil(py), math.ceil(qy)
    slope = (qx - px) / (qy - py) if qy > py else 0.0
    px -= _LEFT
    n = x = y = xx = xy = yy = 0.0
    for row in range(first, stop):
        c = math.ceil(px + (row - py) * slope)
        crossings[row - first] = c
        s0, s1 = sums[row, c, 0], sums[row, c, 1]
        n += s0
        x += s1
        xx += sums[row, c, 2]
        y += row * s0
        xy += row * s1
        yy += row * (row * s0)
    result[i, 0], result[i, 1], result[i, 2] = sign * n, sign * x, sign * y
    result[i, 3], result[i, 4], result[i, 5] = sign * xx, sign * xy, sign * yy
    for band in range((sums.shape[2] - 3) // 3):
        at = 3 + 3 * band
        f = xf = yf = ff = 0.0
        for row in range(first, stop):
            c = crossings[row - first]
            s0 = sums[row, c, at]
            f += s0
            xf += sums[row, c, at + 1]
            yf += row * s0
            ff += sums[row, c, at + 2]
        at = OF_PIXELS + OF_BAND * band
        result[i, at], result[i, at + 1] = sign * f, sign * xf
        result[i, at + 2], result[i, at + 3] = sign * yf, sign * ff


@inner
def product(
    m: Floats, i: int, a: float, ax: float, ay: float, b: float, bx: float, by: float
) -> float:
    """Return the sum over pixels of (a + ax x + ay y) (b + bx x + by y), from a row of moments."""
    return float(
        a * (b * m[i, 0] + bx * m[i, 1] + by * m[i, 2])
        + ax * (b * m[i, 1] + bx * m[i, 3] + by * m[i, 4])
        + ay * (b * m[i, 2] + bx * m[i, 4] + by * m[i, 5])
    )


@inner
def squared_error(p: Points, values: Floats, m: Floats, i: int, a: int, b: int, c: int) -> float:
    """Return the sum of the squared errors of the plane through three nodes."""
    if m[i, 0] <= 0:
        return 0.0
    ax, ay = p[a, 0], p[a, 1]
    bx, by = p[b, 0] - ax, p[b, 1] - ay
    cx, cy = p[c, 0] - ax, p[c, 1] - ay
    d = bx * cy - by * cx
    total = 0.0
    for band in range(values.shape[1]):
        start = values[a, band]
        fb, fc = values[b, band] - start, values[c, band] - start
        gx, gy = (fb * cy - fc * by) / d, (fc * bx - fb * cx) / d
        g = start - gx * ax - gy * ay
        at = OF_PIXELS + OF_BAND * band
        total += m[i, at + 3] - 2 * (g * m[i, at] + gx * m[i, at + 1] + gy * m[i, at + 2])
        total += product(m, i, g, gx, gy, g, gx, gy)
    return max(total, 0.0)


@inner
def spread(m: Floats, i: int, bands: int) -> float:
    """Return the sum of the squared differences from the mean, from row `i` of the moments."""
    if m[i, 0] <= 0:
        return 0.0
    total = 0.0
    for band in range(bands):
        at = OF_PIXELS + OF_BAND * band
        total += m[i, at + 3] - m[i, at] * m[i, at] / m[i, 0]
    return max(total, 0.0)


@inner
def error_of(
    p: Points, values: Floats, m: Floats, i: int, a: int, b: int, c: int, model: int
) -> float:
    """Return the sum of the squared errors of a triangle in the given model."""
    if model == CONSTANT:
        return spread(m, i, values.shape[1])
    return squared_error(p, values, m, i, a, b, c)


@inner
def measure_triangle(patch: Patch, surface: Surface, image: Image, t: int, model: int) -> None:
    """Compute the moments and the error of a triangle from its pixels."""
    triangles, p = patch.triangles, patch.points
    along, moments = surface.along, surface.moments
    for k in range(3):
        a, b = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        moments_along(
            p[a, 0], p[a, 1], p[b, 0], p[b, 1], image.sums, image.crossings, along, 3 * t + k
        )
    for i in range(moments.shape[1]):
        moments[t, i] = along[3 * t, i] + along[3 * t + 1, i] + along[3 * t + 2, i]
    surface.errors[t] = error_of(
        p, surface.values, moments, t, triangles[t, 0], triangles[t, 1], triangles[t, 2], model
    )


@kernel(void(PATCH, SURFACE, IMAGE, int64))
def measure_all(patch: Patch, surface: Surface, image: Image, model: int) -> None:
    """Compute the moments and the error of every triangle."""
    for t in range(patch.size[1]):
        if patch.alive[t]:
            measure_triangle(patch, surface, image, t, model)
        else:
            surface.errors[t] = -1.0
