"""Insert nodes where a patch is out of bounds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel, reads, writes
from geomesh.refine.bound import BOUND, heights_of, measure
from geomesh.refine.patch import OTHER_PATCH, PATCH, SHARED, Patch
from geomesh.refine.shape import on_lattice
from geomesh.refine.split import LOG, Log, insert_node
from geomesh.refine.star import STAR, Star, around

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Mask, Points

# Squared distance in pixels from a node at which its height is changed instead.
_NEAR_NODE = 0.8

# Squared distance in pixels from a hard side at which that is split instead.
_NEAR_SIDE = 2.3

# Ways to correct a triangle: the height of a node nearby, or a node at one of five places.
_CHOICES = 6


@kernel(
    int64(
        *(PATCH, writes(float64, 2), writes(float64, 3), STAR, LOG),
        *(writes(float64, 1), writes(float64, 1), writes(int64, 2)),
        *(reads(int64, 1), writes(boolean, 1), writes(float64, 2), float64),
    )
)
def insert_violating(
    patch: Patch,
    values: Floats,
    image: Floats,
    star: Star,
    log: Log,
    worst: Floats,
    total: Floats,
    pixel: Counts,
    order: NDArray[np.int64],
    touched: Mask,
    interval: Floats,
    floor: float,
) -> int:
    """Insert a node into each violating triangle in `order`; return how many were changed.

    Tried are the worst pixel, the foot of its perpendicular on a hard side nearby, half of the
    way to the centroid, the centroid, and the middle of the longest side. If the pixel lies at a
    node whose height can be changed so that all is well around it, that is done instead. A
    triangle that was changed is left for the next batch.

    Parameters
    ----------
    values, image, worst, total, pixel
        See `measure_bound`; measured before, and kept up to date.
    order : int64 (k,)
        Triangles.
    touched : bool (m,)
        Room, all False.
    interval : float64 (4, B)
        Room.
    floor : float
        `sharpness` below which no new triangle may fall.
    """
    triangles, across, p = patch.triangles, patch.across, patch.points
    changed = 0
    for i in range(len(order)):
        t = order[i]
        if patch.size[0] + 1 > len(p) or patch.size[1] + 4 > len(triangles):
            break
        if touched[t] or not patch.alive[t] or worst[t] <= BOUND:
            continue
        col, row = float(pixel[t, 0]), float(pixel[t, 1])
        near = -1
        for k in range(3):
            v = triangles[t, k]
            distance = (p[v, 0] - col) ** 2 + (p[v, 1] - row) ** 2
            if distance < _NEAR_NODE and patch.held[v] < SHARED:
                near = v
        for choice in range(_CHOICES):
            if choice == 0:
                v = near
            else:
                x, y = _place(triangles, across, patch.hard, p, t, col, row, choice)
                if math.isnan(x):
                    continue
                v = insert_node(patch, t, on_lattice(x), on_lattice(y), floor, log)
            if v < 0:
                continue
            m, _ = around(triangles, across, patch.at[v], v, star)
            if m == 0:
                continue
            x, y = p[v, 0], p[v, 1]
            fits = heights_of(p, values, image, star, m, x, y, interval) >= 0
            if choice > 0:
                _first_heights(values, image, v, x, y, star, m)
            if fits:
                for band in range(values.shape[1]):
                    height = max(values[v, band], interval[0, band])
                    values[v, band] = min(height, interval[1, band])
            elif choice == 0:
                continue
            for j in range(m):
                touched[star.triangles[j]] = True
                measure(p, triangles, values, image, star.triangles[j], worst, total, pixel)
            changed += 1
            break
    return changed


@inner
def _place(
    triangles: Counts,
    across: Counts,
    hard: NDArray[np.uint8],
    p: Points,
    t: int,
    col: float,
    row: float,
    choice: int,
) -> tuple[float, float]:
    """Return where to try a node in triangle `t` for its pixel (col, row); NaN for nowhere."""
    if choice == 1:
        return col, row
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    mx, my = (p[a, 0] + p[b, 0] + p[c, 0]) / 3, (p[a, 1] + p[b, 1] + p[c, 1]) / 3
    if choice == 3:
        return (col + mx) / 2, (row + my) / 2
    if choice == 4:
        return mx, my
    nearest, longest = _NEAR_SIDE, -1.0
    fx, fy, lx, ly = math.nan, math.nan, 0.0, 0.0
    for k in range(3):
        one, other = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        ux, uy = p[other, 0] - p[one, 0], p[other, 1] - p[one, 1]
        length = ux * ux + uy * uy
        if length > longest:
            longest = length
            lx, ly = (p[one, 0] + p[other, 0]) / 2, (p[one, 1] + p[other, 1]) / 2
        if hard[t, k] and across[t, k] != OTHER_PATCH:
            along = ((col - p[one, 0]) * ux + (row - p[one, 1]) * uy) / length
            x, y = p[one, 0] + along * ux, p[one, 1] + along * uy
            distance = (x - col) ** 2 + (y - row) ** 2
            if distance < nearest and 0 < along < 1:
                nearest, fx, fy = distance, x, y
    if choice == 2:
        return fx, fy
    return lx, ly


@inner
def _first_heights(
    values: Floats, image: Floats, v: int, x: float, y: float, star: Star, m: int
) -> None:
    """Give node `v` the value of its pixel; where that is not valid, the mean height nearby."""
    col = min(max(int(np.rint(x)), 0), image.shape[2] - 1)
    row = min(max(int(np.rint(y)), 0), image.shape[1] - 1)
    for band in range(values.shape[1]):
        height = image[band, row, col]
        if math.isnan(height):
            height = 0.0
            for j in range(m):
                height += (values[star.first[j], band] + values[star.second[j], band]) / (2 * m)
        values[v, band] = height
