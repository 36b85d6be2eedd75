"""Stage 4: Delaunay and constrained Delaunay triangulation, whole or by tiles."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Triangles
from geomesh.delaunay import cdt, tiled

# Above so many points the engine gets them tile by tile, and its memory stays that of
# a tile. The result is the same.
TILED_ABOVE = 20_000_000
TILE_POINTS = 1_000_000

# Rows beyond which a sort is worth its preparation.
_LONG = 32


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


def delaunay(points: NDArray[np.float64], *, executor: Executor | None = None) -> Triangulation:
    """Return the Delaunay triangulation of the points' convex hull.

    Points on a common empty circle are joined to the lowest of them, by y, then x:
    there is one triangulation.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.
    executor : concurrent.futures.Executor, optional
        Of threads, for the tiles of large sets; one after the other by default.

    Returns
    -------
    Triangulation
        Without triangles if there are fewer than three points or all lie on a line.
    """
    if not cdt.spans_area(points):
        return Triangulation(np.empty((0, 3), np.int32), np.empty(0, np.intp))
    return _triangulate(points, None, executor)


def constrained_delaunay(
    points: NDArray[np.float64],
    segments: NDArray[np.integer],
    *,
    executor: Executor | None = None,
) -> Triangulation:
    """Return the constrained Delaunay triangulation of the area inside closed loops.

    What lies outside, or in a hole, is removed by the number of segments between
    it and infinity, so loops may nest. Ties are broken as by `delaunay`.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct.
    segments : int (S, 2)
        Pairs of points; together closed loops that do not cross.
    executor : concurrent.futures.Executor, optional
        Of threads, for the tiles of large sets; one after the other by default.

    Raises
    ------
    CertificateError
        If segments cross.
    """
    return _triangulate(points, segments, executor)


def _triangulate(
    points: NDArray[np.float64],
    segments: NDArray[np.integer] | None,
    executor: Executor | None,
) -> Triangulation:
    if len(points) > TILED_ABOVE:
        parts = tiled.triangulate(points, segments, TILE_POINTS, executor)
    else:
        parts = [cdt.triangulate(points, segments).triangles]
    return _finish(parts, len(points))


def _finish(parts: list[Triangles], count: int) -> Triangulation:
    """Join triangles over `count` points in canonical form; `parts` is emptied on the way.

    A counting sort by the lowest index; of the few triangles that share it, no two
    have the same second one.
    """
    starts = np.zeros(count + 1, np.int32)
    used = np.zeros(count, np.bool_)
    for part in parts:
        _turn(part, starts, used)
    np.cumsum(starts, out=starts)
    triangles = np.empty((starts[-1], 3), np.int32)
    while parts:
        _deal(parts.pop(), starts, triangles)
    del starts
    _sort_runs(triangles)
    return Triangulation(triangles, np.flatnonzero(used))


@kernel
def _turn(triangles: Triangles, starts: NDArray[np.int32], used: NDArray[np.bool_]) -> None:
    """Turn triangles to their lowest index; count it one place on; mark what is used."""
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        used[a] = used[b] = used[c] = True
        if b < a and b < c:
            a, b, c = b, c, a
        elif c < a and c < b:
            a, b, c = c, a, b
        triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, b, c
        starts[a + 1] += 1


@kernel
def _deal(part: Triangles, starts: NDArray[np.int32], triangles: Triangles) -> None:
    """Put each triangle at the next free place of its lowest index."""
    for t in range(len(part)):
        place = starts[part[t, 0]]
        starts[part[t, 0]] += 1
        for k in range(3):
            triangles[place, k] = part[t, k]


@kernel
def _sort_runs(triangles: Triangles) -> None:
    """Sort the rows of each lowest index by the second."""
    first = 0
    while first < len(triangles):
        end = first + 1
        while end < len(triangles) and triangles[end, 0] == triangles[first, 0]:
            end += 1
        if end - first > _LONG:
            run = triangles[first:end].copy()
            for i, place in enumerate(np.argsort(run[:, 1])):
                for k in range(3):
                    triangles[first + i, k] = run[place, k]
        else:
            for i in range(first + 1, end):
                a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
                j = i
                while j > first and triangles[j - 1, 1] > b:
                    for k in range(3):
                        triangles[j, k] = triangles[j - 1, k]
                    j -= 1
                triangles[j, 0], triangles[j, 1], triangles[j, 2] = a, b, c
        first = end
