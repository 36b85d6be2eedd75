"""Break cocircular ties in one defined way, so that points have only one triangulation.

Points on a common empty circle have many Delaunay triangulations. Which of them an engine
returns depends on the order of the points and on the tiles. This module merges triangles
into polygons, across every edge whose in-circle determinant is exactly zero, but never
across a constraint. Then it cuts each polygon into a fan around its lowest vertex (lowest
y, then lowest x). The polygons depend only on points and constraints. They are inscribed
in circles and so strictly convex: any fan is valid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import float64, int32, int64, kernel, reads, uint8, writes
from geomesh.delaunay.predicates import IN_CIRCLE_ERROR, are_cocircular, in_circle
from geomesh.mesh.topology import FILL, edge_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids, Mask, Points, Triangles


class _Sides(NamedTuple):
    """Sides of triangles: the side of triangle `t` opposite to its corner `k`."""

    t: NDArray[np.intp]
    k: NDArray[np.intp]


def break_ties(
    points: Points, triangles: Triangles, neighbours: Triangles, fixed: NDArray[np.int64]
) -> int:
    """Replace groups of cocircular triangles by fans, in place; return the number of ties.

    A tie is an edge whose two triangles have the same circumcircle.

    Parameters
    ----------
    points : float64 (N, 2)
    triangles : int32 (T, 3)
        Counter-clockwise, (constrained) Delaunay. Changed in place.
    neighbours : int32 (T, 3)
        The triangle across the side opposite to corner k, or `FILL`. Changed in place.
    fixed : int64 (F,)
        Sorted keys (`topology.edge_keys`) of the constraint edges, which must not change.
    """
    near = np.zeros(len(triangles), np.uint8)
    if _mark_near_ties(points, triangles, neighbours, near) == 0:
        return 0
    sides = _ties(points, triangles, neighbours, fixed, near)
    if len(sides.t):
        _cut_fans(points, triangles, neighbours, sides)
    return len(sides.t)


@kernel(int64(reads(float64, 2), reads(int32, 2), reads(int32, 2), writes(uint8, 1)))
def _mark_near_ties(
    points: Points, triangles: Triangles, neighbours: Triangles, near: NDArray[np.uint8]
) -> int:
    """Set bit k of `near` if the side opposite to corner k may be a tie; return their number.

    Of the two triangles of an edge, the triangle with the lower number is marked.
    """
    found = 0
    for t in range(len(triangles)):
        for k in range(3):
            other = neighbours[t, k]
            if other <= t:
                continue
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            d = triangles[other, 0] + triangles[other, 1] + triangles[other, 2]
            d -= a + b + c - triangles[t, k]
            value, size = in_circle(
                points[a, 0],
                points[a, 1],
                points[b, 0],
                points[b, 1],
                points[c, 0],
                points[c, 1],
                points[d, 0],
                points[d, 1],
            )
            if abs(value) <= IN_CIRCLE_ERROR * size:
                near[t] |= 1 << k
                found += 1
    return found


def _ties(
    points: Points,
    triangles: Triangles,
    neighbours: Triangles,
    fixed: NDArray[np.int64],
    near: NDArray[np.uint8],
) -> _Sides:
    """Return the sides that are certainly ties and not fixed, each edge once."""
    t, k = np.nonzero(near[:, None] >> np.arange(3, dtype=np.uint8) & 1)
    apex, start, end = triangles[t, k], triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
    far = triangles[neighbours[t, k]].sum(axis=1) - start - end
    tie = are_cocircular(points[apex], points[start], points[end], points[far])
    if len(fixed):
        keys = edge_keys(np.column_stack([start, end]))
        place = np.minimum(np.searchsorted(fixed, keys), len(fixed) - 1)
        tie &= fixed[place] != keys
    return _Sides(t[tie], k[tie])


def _cut_fans(points: Points, triangles: Triangles, neighbours: Triangles, sides: _Sides) -> None:
    """Replace each group of triangles that share the given sides by a fan.

    A group of n triangles is a polygon of n + 2 sides. Each side, except the two at the
    lowest vertex, forms a triangle with that vertex. The n new triangles replace the group.
    """
    other = neighbours[sides.t, sides.k]
    ends = _ends(triangles, sides.t, sides.k)
    gone = np.zeros(triangles.shape, np.bool_)
    gone[sides.t, sides.k] = True
    gone[other, _facing(triangles, other, ends)] = True
    members = np.flatnonzero(gone.any(axis=1))
    place = np.empty(len(triangles), np.int32)
    place[members] = np.arange(len(members))
    group = _groups(place[sides.t], place[other], len(members))
    member, corner = np.nonzero(~gone[members])
    t, of = members[member], group[member]
    u, v = triangles[t, (corner + 1) % 3], triangles[t, (corner + 2) % 3]
    outer = neighbours[t, corner]
    lowest = np.lexsort((points[u, 0], points[u, 1], of))
    low = u[lowest[np.flatnonzero(np.diff(of[lowest], prepend=-1))]][of]
    fan = np.flatnonzero((u != low) & (v != low))
    fan = fan[np.argsort(of[fan], kind="stable")]
    places = members[np.argsort(group, kind="stable")]
    made = np.column_stack([low[fan], u[fan], v[fan]])
    # Each triangle starts with its lowest node number.
    turn = (np.arange(3) + made.argmin(axis=1)[:, None]) % 3
    triangles[places] = np.take_along_axis(made, turn, axis=1)
    _join(triangles, neighbours, places, np.column_stack([u, v]), outer)


def _groups(one: Ids, other: Ids, count: int) -> NDArray[np.int32]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(count, count))
    labels: NDArray[np.int32] = connected_components(links, directed=False)[1]
    return labels


def _ends(triangles: Triangles, t: NDArray[np.integer], k: NDArray[np.integer]) -> Ids:
    return np.column_stack([triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]])


def _facing(triangles: Triangles, t: NDArray[np.integer], ends: Ids) -> NDArray[np.intp]:
    """Return the corner of each triangle `t` that is opposite to its side `ends` (K, 2)."""
    corners = triangles[t]
    facing: NDArray[np.intp] = ((corners != ends[:, :1]) & (corners != ends[:, 1:])).argmax(axis=1)
    return facing


def _join(
    triangles: Triangles,
    neighbours: Triangles,
    places: NDArray[np.intp],
    border: Ids,
    outer: Ids,
) -> None:
    """Set the neighbours of the new triangles at `places`, and of the triangles around them.

    Parameters
    ----------
    border : int32 (B, 2)
        Sides of the polygons, from node to node.
    outer : int32 (B,)
        The triangle on the outer side of each polygon side, or `FILL`.
    """
    t, k = np.repeat(places, 3), np.tile(np.arange(3), len(places))
    ends = _ends(triangles, t, k)
    keys = _directed(ends)
    order = np.argsort(keys)
    found, place = _search(keys[order], _directed(ends[:, ::-1]))
    neighbours[t, k] = np.where(found, t[order[place]], FILL)
    # A side without a new triangle on the other side is a polygon side: its outer
    # neighbour stays the same.
    sides = np.flatnonzero(~found)
    order = np.argsort(_directed(border))
    _, place = _search(_directed(border)[order], keys[sides])
    beyond = outer[order[place]]
    neighbours[t[sides], k[sides]] = beyond
    there = beyond != FILL
    sides, beyond = sides[there], beyond[there]
    neighbours[beyond, _facing(triangles, beyond, ends[sides])] = t[sides]


def _directed(ends: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return one int64 key for each directed side (K, 2)."""
    keys: NDArray[np.int64] = (ends[:, 0].astype(np.int64) << 32) | ends[:, 1]
    return keys


def _search(ordered: NDArray[np.int64], keys: NDArray[np.int64]) -> tuple[Mask, NDArray[np.intp]]:
    """Return which keys are in the sorted array `ordered`, and where."""
    place = np.minimum(np.searchsorted(ordered, keys), len(ordered) - 1)
    return ordered[place] == keys, place
