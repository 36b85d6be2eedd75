"""Exact Delaunay triangulation by tiles: the engine needs memory for one tile at a time.

The points are split into tiles of equal count, and each tile is triangulated by itself. A
triangle of a tile is settled if no other point can change it: its circumcircle lies inside
the tile's box, which contains no point of another tile, and no constraint touches the
triangle. The vertices of all other triangles, and of the tile's hull, form the residual
set: a few percent of the points. The residual set is triangulated once, with all
constraints. In that triangulation, the settled triangles replace the triangles that cover
the same area.

Why the result is the triangulation T of all points, including ties and constraints:

- Settled triangles belong to T. Their circles contain no point, so all cocircular points
  are in the tile, and ties give the same fan around the lowest of them. If a constraint
  cuts the circle, the triangles that it does not touch are on the side of that lowest
  point, and are still a fan around it.
- Around a point outside the residual set, all triangles are settled. So every triangle of
  T that is not settled has its vertices in the residual set. The residual triangulation R
  contains it: if a residual point is in its circle, the same constraints as in T hide the
  point, because all ends of constraints, and all points on constraints, are residual. Its
  fan in T is around the lowest point of its circle. That point is a vertex of it, so it is
  residual, and it is also the lowest of the residual points on the circle.
- R and T cover the same hull. Edges between settled and other triangles are edges of both.
  So the triangles of R on the settled side of these edges cover exactly the settled
  triangles. A flood that stops at these edges finds them.
- No constraint touches a settled triangle. So a connected group of settled triangles is
  inside the loops if the triangles of R in its place are, and R has no triangles outside.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, int32, int64, kernel, reads, void, writes
from geomesh.delaunay.cdt import Patch, spans_area, triangulate_points
from geomesh.delaunay.kd_split import split
from geomesh.delaunay.settle import gather_groups, mark_touched, settle, unsettled_points
from geomesh.errors import CertificateError
from geomesh.mesh.topology import FILL

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.arrays.types import Triangles


class _Settled(NamedTuple):
    """The settled triangles of one tile; indices refer to all points of the mesh.

    Attributes
    ----------
    triangles : int32 (C, 3)
        The settled triangles, connected group after connected group.
    starts : int32 (G + 1,)
        Where each group starts in `triangles`, and the end of the last group.
    border : int32 (B, 2)
        Half-edges of settled triangles without a settled triangle on the other side.
    groups : int32 (B,)
        The group of each half-edge.
    residual : int32 (R,)
        Points of the tile that must be triangulated again.
    """

    triangles: Triangles
    starts: NDArray[np.int32]
    border: NDArray[np.int32]
    groups: NDArray[np.int32]
    residual: NDArray[np.int32]


def triangulate_by_tiles(
    points: NDArray[np.float64],
    segments: NDArray[np.integer] | None,
    tile_points: int,
    executor: Executor | None = None,
    lines: NDArray[np.integer] | None = None,
) -> list[Triangles]:
    """Return the same triangles as `triangulate_points`, in parts, in no particular order.

    Parameters
    ----------
    points : float64 (N, 2)
        Distinct, not all on a line.
    segments : int (S, 2), optional
        Closed loops; triangles outside are left out.
    tile_points : int
        Maximum number of points in a tile.
    executor : concurrent.futures.Executor, optional
        Its threads process tiles in parallel. By default tiles are processed one after
        the other.
    lines : int (L, 2), optional
        Other segments that must be edges; with `segments` only.
    """
    order, stops, boxes = split(points, max(tile_points, 1))
    tiles = list(zip(np.split(order, stops[:-1]), boxes, strict=True))
    every = segments if segments is None or lines is None else np.concatenate([segments, lines])
    work = partial(_settle_tile, points, every)
    found = list(executor.map(work, tiles) if executor else map(work, tiles))
    del order, tiles
    return _join(points, segments, lines, found)


def _settle_tile(
    points: NDArray[np.float64],
    segments: NDArray[np.integer] | None,
    tile: tuple[NDArray[np.int32], NDArray[np.float64]],
) -> _Settled:
    ids = np.sort(tile[0])
    own = points[ids]
    nothing = np.empty((0, 3), np.int32)
    patch = triangulate_points(own) if spans_area(own) else Patch(nothing, nothing)
    settled = settle(own, patch.triangles, tile[1])
    if segments is not None:
        _exclude_touched(points, segments, ids, own, patch, settled)
    triangles, starts, border, groups = gather_groups(patch.triangles, patch.neighbours, settled)
    residual = unsettled_points(patch.triangles, patch.neighbours, settled, len(own))
    return _Settled(ids[triangles], starts, ids[border], groups, ids[residual])


def _exclude_touched(
    points: NDArray[np.float64],
    segments: NDArray[np.integer],
    ids: NDArray[np.int32],
    own: NDArray[np.float64],
    patch: Patch,
    settled: NDArray[np.bool_],
) -> None:
    """Clear `settled` where a segment touches a triangle of the tile."""
    low, high = own.min(axis=0), own.max(axis=0)
    one, other = points[segments[:, 0]], points[segments[:, 1]]
    beside = (np.minimum(one, other) > high) | (np.maximum(one, other) < low)
    near = ~beside.any(axis=1)
    ends = segments[near]
    place = np.minimum(np.searchsorted(ids, ends), len(ids) - 1)
    inside = np.where(ids[place] == ends, place, FILL).max(axis=1, initial=FILL)
    lines = np.hstack([one[near], other[near]])
    mark_touched(own, patch.triangles, patch.neighbours, lines, inside.astype(np.int32), settled)


def _join(
    points: NDArray[np.float64],
    segments: NDArray[np.integer] | None,
    lines: NDArray[np.integer] | None,
    found: list[_Settled],
) -> list[Triangles]:
    """Triangulate the residual points and insert the settled triangles."""
    residual = np.sort(np.concatenate([tile.residual for tile in found]))
    chosen, also = (
        None if pairs is None else np.searchsorted(residual, pairs) for pairs in (segments, lines)
    )
    patch = triangulate_points(points[residual], chosen, also)
    borders = [np.searchsorted(residual, tile.border).astype(np.int32) for tile in found]
    places = _find_half_edges(patch.triangles, np.concatenate(borders))
    covered = _flood(patch.neighbours, places)
    parts = [residual[patch.triangles[~covered]]]
    first = 0
    while found:
        tile, border = found.pop(0), borders.pop(0)
        inside = places[first : first + len(border)] != FILL
        first += len(border)
        count = len(tile.starts) - 1
        known = np.bincount(tile.groups[inside], minlength=count)
        total = np.bincount(tile.groups, minlength=count)
        # A whole group is inside the loops, or outside.
        if not ((known == total) | ((known == 0) & (segments is not None))).all():
            raise CertificateError(
                "the tiles of the triangulation do not fit together. This is a defect of "
                "geomesh: please report it with the source raster"
            )
        kept = np.repeat(known > 0, np.diff(tile.starts))
        parts.append(tile.triangles if kept.all() else tile.triangles[kept])
    return parts


def _find_half_edges(triangles: Triangles, pairs: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return 3 t + k for each half-edge (K, 2), or `FILL` if there is no such half-edge.

    The half-edge is opposite to corner k of triangle t.
    """
    starts = np.roll(triangles, -1, axis=1).astype(np.int64).ravel() << 32
    keys = starts | np.roll(triangles, -2, axis=1).ravel()
    wanted = (pairs[:, 0].astype(np.int64) << 32) | pairs[:, 1]
    order = np.argsort(keys)
    keys = keys[order]
    place = np.searchsorted(keys, wanted)
    hit = place < len(keys)
    hit[hit] = keys[place[hit]] == wanted[hit]
    found = np.full(len(pairs), FILL, np.int64)
    found[hit] = order[place[hit]]
    return found


def _flood(neighbours: Triangles, places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark the triangles of the half-edges `places`, and all triangles connected to them.

    The flood does not cross the half-edges `places`.
    """
    begun, closed = places[places != FILL] // 3, np.zeros(neighbours.size, np.bool_)
    closed[places[places != FILL]] = True
    reached = np.zeros(len(neighbours), np.bool_)
    reached[begun] = True
    first = np.flatnonzero(reached)
    stack = np.empty(len(neighbours), np.int32)
    stack[: len(first)] = first
    _spread(neighbours, closed, reached, stack, len(first))
    return reached


@kernel(void(reads(int32, 2), reads(boolean, 1), writes(boolean, 1), writes(int32, 1), int64))
def _spread(
    neighbours: Triangles,
    closed: NDArray[np.bool_],
    reached: NDArray[np.bool_],
    stack: NDArray[np.int32],
    depth: int,
) -> None:
    """Flood from the first `depth` triangles of the stack, across sides that are not closed."""
    while depth > 0:
        depth -= 1
        t = stack[depth]
        for k in range(3):
            other = neighbours[t, k]
            if other != FILL and not closed[3 * t + k] and not reached[other]:
                reached[other] = True
                stack[depth] = other
                depth += 1
