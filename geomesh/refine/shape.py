"""Shapes of triangles, and places on the lattice of 1/256 pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import inner

if TYPE_CHECKING:
    from geomesh.arrays.types import Points

LATTICE = 256.0

# Doubled area in square pixels below which no triangle is made.
LEAST_AREA = 0.1


@inner
def doubled_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inner
def sharpness(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return the squared sine of the smallest angle; -1 if the triangle is not positive."""
    d = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if d < LEAST_AREA:
        return -1.0
    a = (bx - cx) * (bx - cx) + (by - cy) * (by - cy)
    b = (cx - ax) * (cx - ax) + (cy - ay) * (cy - ay)
    c = (ax - bx) * (ax - bx) + (ay - by) * (ay - by)
    return d * d / max(a * b, b * c, c * a)


@inner
def corner_sharpness(p: Points, a: int, b: int, c: int) -> float:
    """Return `sharpness` of the triangle of three of the points."""
    return sharpness(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1])


@inner
def on_lattice(value: float) -> float:
    """Return the coordinate rounded to the lattice of 1/256 pixel."""
    return float(np.rint(value * LATTICE) / LATTICE)


@inner
def lattice_step(dx: float, dy: float) -> tuple[float, float, int]:
    """Return the smallest step along (dx, dy) between points of the lattice, and their number."""
    i, j = int(abs(dx) * LATTICE), int(abs(dy) * LATTICE)
    while j:
        i, j = j, i % j
    if i == 0:
        return 0.0, 0.0, 0
    return dx / i, dy / i, i


@inner
def straight(p: Points, v: int, one: int, other: int) -> bool:
    """Return whether `v` lies exactly on the line between two other nodes."""
    ux, uy = p[one, 0] - p[v, 0], p[one, 1] - p[v, 1]
    wx, wy = p[other, 0] - p[v, 0], p[other, 1] - p[v, 1]
    return bool(ux * wy == uy * wx and ux * wx + uy * wy < 0)


@inner
def convex(p: Points, a: int, b: int, d: int, e: int) -> bool:
    """Return whether triangles (a, b, d) and (e, d, b) can become (a, b, e) and (a, e, d)."""
    return (
        doubled_area(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[e, 0], p[e, 1]) >= LEAST_AREA
        and doubled_area(p[a, 0], p[a, 1], p[e, 0], p[e, 1], p[d, 0], p[d, 1]) >= LEAST_AREA
    )
