"""Stage 4: Delaunay and constrained Delaunay triangulation, by CDT."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pythoncdt
from numpy.typing import NDArray

from geomesh.errors import CertificateError, one_line
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
    CertificateError
        If segments cross.
    """
    engine, order = _engine(points)
    place = np.empty(len(order), np.uintc)
    place[order] = np.arange(len(order), dtype=np.uintc)
    try:
        engine.insert_edges(place[segments])
    except RuntimeError as error:
        raise CertificateError(
            f"the outline of the data crosses itself ({one_line(error)}). This is a defect of "
            "geomesh: please report it with the source raster"
        ) from error
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
    order, moved = _along_curve(points)
    engine.insert_vertices(moved)
    return engine, order


@kernel
def _along_curve(points: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Order of the points along a Z-order curve through 256 x 256 cells, and the points in it.

    Neighbours on the plane then lie close in memory. The points are moved to near
    the origin: small numbers keep the most precision for the predicates.
    """
    count = len(points)
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for p in range(count):
        low_x, high_x = min(low_x, points[p, 0]), max(high_x, points[p, 0])
        low_y, high_y = min(low_y, points[p, 1]), max(high_y, points[p, 1])
    scale = 255.5 / max(high_x - low_x, high_y - low_y, 1e-300)
    keys = np.empty(count, np.uint16)
    starts = np.zeros(65_537, np.int64)
    for p in range(count):
        col, row = int((points[p, 0] - low_x) * scale), int((points[p, 1] - low_y) * scale)
        key = 0
        for bit in range(8):
            key |= ((col >> bit) & 1) << (2 * bit) | ((row >> bit) & 1) << (2 * bit + 1)
        keys[p] = key
        starts[key + 1] += 1
    for key in range(65_536):
        starts[key + 1] += starts[key]
    order = np.empty(count, np.int32)
    moved = np.empty((count, 2))
    left, bottom = math.floor(low_x), math.floor(low_y)
    for p in range(count):
        place = starts[keys[p]]
        starts[keys[p]] += 1
        order[place] = p
        moved[place, 0], moved[place, 1] = points[p, 0] - left, points[p, 1] - bottom
    return order, moved


def _finish(engine: Any, order: NDArray[np.int32], auxiliary: int) -> Triangulation:
    """Return the engine's triangles in canonical form, less those on its own vertices."""
    raw = engine.triangles_array(copy=False)["vertices"]
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
    turned = np.empty_like(triangles)
    count = 0
    for t in range(len(raw)):
        a, b, c = raw[t, 0], raw[t, 1], raw[t, 2]
        if min(a, b, c) >= auxiliary:
            a, b, c = order[a - auxiliary], order[b - auxiliary], order[c - auxiliary]
            used[a] = used[b] = used[c] = True
            if b < a and b < c:
                a, b, c = b, c, a
            elif c < a and c < b:
                a, b, c = c, a, b
            turned[count, 0], turned[count, 1], turned[count, 2] = a, b, c
            starts[a + 1] += 1
            count += 1
    for k in range(len(order)):
        starts[k + 1] += starts[k]
    stops = starts[:-1].copy()
    for t in range(count):
        a, b, c = turned[t, 0], turned[t, 1], turned[t, 2]
        k = stops[a]
        stops[a] += 1
        while k > starts[a] and triangles[k - 1, 1] > b:
            for corner in range(3):
                triangles[k, corner] = triangles[k - 1, corner]
            k -= 1
        triangles[k, 0], triangles[k, 1], triangles[k, 2] = a, b, c
    return count


def _spans_area(points: NDArray[np.float64]) -> bool:
    """Tell whether three of the points (N, 2) make a triangle; a few of them mostly do."""
    for some in (points[:100], points):
        offsets = some - points[:1]
        if len(some) > 2:
            far = offsets[np.abs(offsets).sum(axis=1).argmax()]
            if (offsets[:, 0] * far[1] != offsets[:, 1] * far[0]).any():
                return True
    return False
