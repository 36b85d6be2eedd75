"""Stage 4: Delaunay and constrained Delaunay triangulation, at once or by tiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.order import stable_order
from geomesh.delaunay.cdt import spans_area, triangulate_points

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.arrays.types import Triangles

# Larger sets of points are triangulated tile by tile, so that the engine needs memory for
# one tile only. The result is the same.
TILED_ABOVE = 20_000_000
TILE_POINTS = 1_000_000


class Triangulation(NamedTuple):
    """Triangles over a set of points.

    Attributes
    ----------
    triangles : int32 (T, 3)
        Indices into the points, counter-clockwise in (x, y). Each triangle starts with
        its lowest index, and rows are in lexicographic order.
    used : intp (M,)
        Indices of the points that are in a triangle.
    """

    triangles: Triangles
    used: NDArray[np.intp]


def delaunay(points: NDArray[np.float64], *, executor: Executor | None = None) -> Triangulation:
    """Return the Delaunay triangulation of the convex hull of the points.

    The result is unique: points on a common empty circle are joined to the lowest of them
    (lowest y, then lowest x).

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.
    executor : concurrent.futures.Executor, optional
        Its threads process the tiles of large sets in parallel. By default tiles are
        processed one after the other.

    Returns
    -------
    Triangulation
        Without triangles if there are fewer than three points or all are on a line.
    """
    if not spans_area(points):
        return Triangulation(np.empty((0, 3), np.int32), np.empty(0, np.intp))
    return _triangulate(points, None, None, executor)


def constrained_delaunay(
    points: NDArray[np.float64],
    segments: NDArray[np.integer],
    *,
    lines: NDArray[np.integer] | None = None,
    executor: Executor | None = None,
) -> Triangulation:
    """Return the constrained Delaunay triangulation of the area inside closed loops.

    Triangles outside the loops, or in a hole, are removed. A triangle is inside if the
    number of segments between it and infinity is odd, so loops can be nested. Ties are
    broken as in `delaunay`.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.
    segments : int (S, 2)
        Pairs of points that together form closed loops; they must not cross.
    lines : int (L, 2), optional
        Pairs of points that must be edges too, but bound nothing. They must not cross each
        other or the segments.
    executor : concurrent.futures.Executor, optional
        Its threads process the tiles of large sets in parallel. By default tiles are
        processed one after the other.

    Raises
    ------
    CertificateError
        If segments cross.
    """
    return _triangulate(points, segments, lines, executor)


def _triangulate(
    points: NDArray[np.float64],
    segments: NDArray[np.integer] | None,
    lines: NDArray[np.integer] | None,
    executor: Executor | None,
) -> Triangulation:
    if len(points) > TILED_ABOVE:
        from geomesh.delaunay.tiled import triangulate_by_tiles

        parts = triangulate_by_tiles(points, segments, TILE_POINTS, executor, lines)
    else:
        parts = [triangulate_points(points, segments, lines).triangles]
    return _in_order(parts, len(points))


def _in_order(parts: list[Triangles], count: int) -> Triangulation:
    """Join the parts and sort the triangles, which start with their lowest index, by rows.

    The first two indices define the order: no two triangles share both. `parts` is emptied
    to save memory, which matters for tens of millions of points.
    """
    triangles = np.concatenate(parts)
    parts.clear()
    used = np.zeros(count, np.bool_)
    used[triangles] = True
    by_second = stable_order(triangles[:, 1], count)
    order = by_second[stable_order(triangles[by_second, 0], count)]
    return Triangulation(triangles[order], np.flatnonzero(used))
