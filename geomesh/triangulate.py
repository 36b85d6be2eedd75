"""Stage 4: Delaunay and constrained Delaunay triangulation, by CDT."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pythoncdt
from numpy.typing import NDArray

from geomesh.jit import kernel
from geomesh.topology import Triangles


class Triangulation(NamedTuple):
    """Triangles over a set of points.

    Attributes
    ----------
    triangles : int32 (T, 3)
        Indices into the points, counter-clockwise in (x, y); each triangle begins
        with its lowest index, and rows are in lexicographic order.
    used : intp (M,)
        Indices of the points that occur in a triangle.
    """

    triangles: Triangles
    used: NDArray[np.intp]


def delaunay(points: NDArray[np.float64]) -> Triangulation:
    """Return the Delaunay triangulation of the points' convex hull.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.

    Returns
    -------
    Triangulation
        Without triangles if there are fewer than three points or all lie on a line.
    """
    if not _spans_area(points):
        return Triangulation(np.empty((0, 3), np.int32), np.empty(0, np.intp))
    engine, order = _engine(points)
    # What hangs on the vertices of the super-triangle, the first three, goes.
    return _finish(engine, order, auxiliary=3)


def constrained_delaunay(
    points: NDArray[np.float64], segments: NDArray[np.integer]
) -> Triangulation:
    """Return the constrained Delaunay triangulation of the area inside closed loops.

    What lies outside, or in a hole, is removed by the number of segments between
    it and infinity, so loops may nest.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.
    segments : int (S, 2)
        Pairs of points; together closed loops that do not cross.

    Raises
    ------
    RuntimeError
        If segments cross.
    """
    engine, order = _engine(points)
    place = np.empty(len(order), np.uintc)
    place[order] = np.arange(len(order), dtype=np.uintc)
    engine.insert_edges(place[segments])
    engine.erase_outer_triangles_and_holes()
    return _finish(engine, order, auxiliary=0)


def _engine(points: NDArray[np.float64]) -> tuple[Any, NDArray[np.int32]]:
    """Return the engine with all points inserted, and the order in which it got them."""
    # Typed Any: that arrays are buffers is known to their type from Python 3.12 on only.
    engine: Any = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    order = _along_curve(points)
    # Small numbers keep the most precision for the predicates.
    engine.insert_vertices(points[order] - np.floor(points.min(axis=0)))
    return engine, order


def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Order of the points along a Z-order curve: neighbours on the plane lie close in memory."""
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), np.finfo(np.float64).tiny)
    key = np.zeros(len(points), np.uint32)
    for axis in (0, 1):
        bits = ((points[:, axis] - low[axis]) * (65535 / extent)).astype(np.uint32)
        for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
            bits = (bits | (bits << np.uint32(shift))) & np.uint32(mask)
        key |= bits << np.uint32(axis)
    return np.argsort(key, kind="stable").astype(np.int32)


def _finish(engine: Any, order: NDArray[np.int32], auxiliary: int) -> Triangulation:
    """Return the engine's triangles in canonical form, less those on its own vertices."""
    raw = engine.triangles_array()["vertices"]
    triangles = np.empty((len(raw), 3), np.int32)
    used = np.zeros(len(order), np.bool_)
    count = _canonical(raw, auxiliary, order, triangles, used)
    return Triangulation(triangles[:count].copy(), np.flatnonzero(used))


@kernel
def _canonical(
    raw: NDArray[np.uint32],
    auxiliary: int,
    order: NDArray[np.int32],
    triangles: NDArray[np.int32],
    used: NDArray[np.bool_],
) -> int:
    """Fill `triangles` and `used`: renumbered, turned to the lowest index and sorted.

    A counting sort by the lowest index; of the few triangles that share it, no two
    have the same second one.
    """
    starts = np.zeros(len(order) + 1, np.int64)
    for t in range(len(raw)):
        a, b, c = raw[t]
        if min(a, b, c) >= auxiliary:
            a, b, c = order[a - auxiliary], order[b - auxiliary], order[c - auxiliary]
            used[a] = used[b] = used[c] = True
            starts[min(a, b, c) + 1] += 1
    for k in range(len(order)):
        starts[k + 1] += starts[k]
    stops = starts[:-1].copy()
    for t in range(len(raw)):
        a, b, c = raw[t]
        if min(a, b, c) >= auxiliary:
            a, b, c = order[a - auxiliary], order[b - auxiliary], order[c - auxiliary]
            if b < a and b < c:
                a, b, c = b, c, a
            elif c < a and c < b:
                a, b, c = c, a, b
            k = stops[a]
            stops[a] += 1
            while k > starts[a] and triangles[k - 1, 1] > b:
                triangles[k] = triangles[k - 1]
                k -= 1
            triangles[k, 0], triangles[k, 1], triangles[k, 2] = a, b, c
    return int(starts[len(order)])


def _spans_area(points: NDArray[np.float64]) -> bool:
    if len(points) < 3:
        return False
    offsets = points - points[0]
    far = offsets[np.abs(offsets).sum(axis=1).argmax()]
    return bool((offsets[:, 0] * far[1] != offsets[:, 1] * far[0]).any())
