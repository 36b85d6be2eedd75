"""Stage 4: Delaunay and constrained Delaunay triangulation, by CDT."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pythoncdt
from numpy.typing import NDArray

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
        return _finish(np.empty((0, 3), np.int32))
    engine = _engine(points)
    engine.erase_super_triangle()
    return _finish(_triangles(engine))


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
    engine = _engine(points)
    engine.insert_edges(np.ascontiguousarray(segments, dtype=np.uintc))
    engine.erase_outer_triangles_and_holes()
    return _finish(_triangles(engine))


# The engine takes arrays as buffers, which the type of an array admits to only from Python 3.12 on.
def _engine(points: NDArray[np.float64]) -> Any:
    engine: Any = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    # Small numbers keep the most precision for the predicates.
    small = points - np.floor(points.min(axis=0))
    engine.insert_vertices(np.ascontiguousarray(small))
    return engine


def _triangles(engine: Any) -> Triangles:
    corners: Triangles = engine.triangles_array()["vertices"].astype(np.int32)
    return corners


def _finish(triangles: Triangles) -> Triangulation:
    first = triangles.argmin(axis=1)[:, None] if len(triangles) else np.zeros((0, 1), np.intp)
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    order = np.lexsort((turned[:, 2], turned[:, 1], turned[:, 0]))
    return Triangulation(np.ascontiguousarray(turned[order]), np.unique(turned))


def _spans_area(points: NDArray[np.float64]) -> bool:
    if len(points) < 3:
        return False
    offsets = points - points[0]
    far = offsets[np.abs(offsets).sum(axis=1).argmax()]
    return bool((offsets[:, 0] * far[1] != offsets[:, 1] * far[0]).any())
