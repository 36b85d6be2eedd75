"""Insert nodes where a patch shows the image worst."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel, reads, writes
from geomesh.refine.moments import (
    CONSTANT,
    IMAGE,
    OF_BAND,
    OF_PIXELS,
    SURFACE,
    Image,
    Surface,
    measure_triangle,
)
from geomesh.refine.patch import PATCH, Patch
from geomesh.refine.scan import columns_of, rows_of
from geomesh.refine.shape import doubled_area, on_lattice
from geomesh.refine.split import LOG, Log, insert_node

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask

# Squared distance in pixels from a triangle's corners at which a new node may lie.
_APART = 0.8


@inner
def _worst_pixel(
    patch: Patch, surface: Surface, image: Image, t: int, model: int
) -> tuple[int, int]:
    """Return the column and row of a triangle's pixel with the largest error; -1 for none.

    Pixels next to a corner do not count.
    """
    triangles, p, values = patch.triangles, patch.points, surface.values
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    ax, ay, bx, by, cx, cy = p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1]
    d = doubled_area(ax, ay, bx, by, cx, cy)
    bands = values.shape[1]
    m = surface.moments
    worst, col, row = -1.0, -1, -1
    corners = rows_of(triangles, p, t)
    for y in range(math.ceil(corners[1]), math.ceil(corners[5])):
        first, stop = columns_of(corners, y)
        for x in range(first, stop):
            u = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / d
            w = ((ax - x) * (by - y) - (ay - y) * (bx - x)) / d
            error = 0.0
            for band in range(bands):
                if model == CONSTANT:
                    shown = m[t, OF_PIXELS + OF_BAND * band] / m[t, 0]
                else:
                    start = values[a, band]
                    shown = start + u * (values[b, band] - start) + w * (values[c, band] - start)
                difference = image.values[band, y, x] - shown
                error += difference * difference
            if error > worst:
                near = min(
                    (ax - x) * (ax - x) + (ay - y) * (ay - y),
                    (bx - x) * (bx - x) + (by - y) * (by - y),
                    (cx - x) * (cx - x) + (cy - y) * (cy - y),
                )
                if near >= _APART:
                    worst, col, row = error, x, y
    return col, row


@inner
def interpolate(patch: Patch, values: Floats, t: int, x: float, y: float, v: int) -> None:
    """Give node `v` at (x, y) the values of the plane of triangle `t`."""
    triangles, p = patch.triangles, patch.points
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    d = doubled_area(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1])
    u = doubled_area(p[c, 0], p[c, 1], p[a, 0], p[a, 1], x, y) / d
    w = doubled_area(p[a, 0], p[a, 1], p[b, 0], p[b, 1], x, y) / d
    for band in range(values.shape[1]):
        start = values[a, band]
        values[v, band] = start + u * (values[b, band] - start) + w * (values[c, band] - start)


@inner
def _take_pixel(image: Image, values: Floats, v: int, x: float, y: float) -> None:
    """Give node `v` the values of the valid pixel around (x, y), if there is one."""
    height, width = image.values.shape[1], image.values.shape[2]
    col = min(max(int(np.rint(x)), 0), width - 1)
    row = min(max(int(np.rint(y)), 0), height - 1)
    if not math.isnan(image.values[0, row, col]):
        for band in range(values.shape[1]):
            values[v, band] = image.values[band, row, col]


@kernel(
    int64(PATCH, SURFACE, IMAGE, LOG, reads(int64, 1), writes(boolean, 1), float64, int64, int64)
)
def insert_where_worst(
    patch: Patch,
    surface: Surface,
    image: Image,
    log: Log,
    order: NDArray[np.int64],
    touched: Mask,
    floor: float,
    wanted: int,
    model: int,
) -> int:
    """Insert a node into each triangle in `order`, until there are enough; return how many.

    Tried are the worst pixel, half of the way from there to the centroid, the centroid, and the
    middle of the longest side. A triangle that an insertion has changed is left for the next
    batch.

    Parameters
    ----------
    order : int64 (k,)
        Triangles, the worst first.
    touched : bool (m,)
        Room, all False.
    floor : float
        `sharpness` below which no new triangle may fall.
    wanted : int
        Number of nodes to insert.
    model : int
        `LINEAR` or `CONSTANT`.
    """
    triangles, p, values = patch.triangles, patch.points, surface.values
    added = 0
    for i in range(len(order)):
        t = order[i]
        if added >= wanted or patch.size[0] + 1 > len(p) or patch.size[1] + 4 > len(triangles):
            break
        if touched[t] or not patch.alive[t] or surface.errors[t] <= 0:
            continue
        col, row = _worst_pixel(patch, surface, image, t, model)
        if col < 0:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        mx, my = (p[a, 0] + p[b, 0] + p[c, 0]) / 3, (p[a, 1] + p[b, 1] + p[c, 1]) / 3
        longest, lx, ly = -1.0, 0.0, 0.0
        for k in range(3):
            one, other = triangles[t, k], triangles[t, (k + 1) % 3]
            length = (p[one, 0] - p[other, 0]) ** 2 + (p[one, 1] - p[other, 1]) ** 2
            if length > longest:
                longest = length
                lx, ly = (p[one, 0] + p[other, 0]) / 2, (p[one, 1] + p[other, 1]) / 2
        for choice in range(4):
            x, y = float(col), float(row)
            if choice == 1:
                x, y = (x + mx) / 2, (y + my) / 2
            elif choice == 2:
                x, y = mx, my
            elif choice == 3:
                x, y = lx, ly
            x, y = on_lattice(x), on_lattice(y)
            v = patch.size[0]
            interpolate(patch, values, t, x, y, v)
            v = insert_node(patch, t, x, y, floor, log)
            if v < 0:
                continue
            _take_pixel(image, values, v, p[v, 0], p[v, 1])
            for j in range(log.size[1]):
                touched[log.changed[j]] = True
                measure_triangle(patch, surface, image, log.changed[j], model)
            added += 1
            break
    return added
