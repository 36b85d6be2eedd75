"""Cocircular ties, broken in one way, so that a set of points has one triangulation.

Points on a common empty circle have many Delaunay triangulations; which of them
an engine returns depends on the order of the points and on how they are split
into tiles. Here triangles are merged across every edge whose in-circle
determinant is exactly zero, never across a constraint, and each polygon is cut
anew into a fan around its lowest vertex (by y, then x). The polygons follow from
points and constraints alone, and being inscribed in circles they are strictly
convex: any fan is valid.

"Exactly" holds for all coordinates whose products up to the fourth degree neither
overflow nor underflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Triangles
from geomesh.delaunay.predicates import TERMS, cocircular
from geomesh.mesh.topology import FILL

# Above the three bits of `merged` that stand for a triangle's edges.
_LISTED = 8


@kernel
def break_ties(
    points: NDArray[np.float64],
    triangles: Triangles,
    across: Triangles,
    fixed: NDArray[np.int64],
) -> int:
    """Cut the polygons of cocircular triangles anew, in place; return how many edges were ties.

    Parameters
    ----------
    points : float64 (N, 2)
    triangles : int32 (T, 3)
        Counter-clockwise, Delaunay; constrained where `fixed` is.
    across : int32 (T, 3)
        The triangle over the edge from corner k to corner k + 1, or `FILL`.
    fixed : int64 (F,)
        Sorted keys (`topology.edge_keys`) of the edges that must stay.
    """
    merged = np.zeros(len(triangles), np.uint8)
    ties = _mark_ties(points, triangles, across, fixed, merged)
    if ties > 0:
        _fan(points, triangles, across, merged)
    return ties


@kernel
def _mark_ties(
    points: NDArray[np.float64],
    triangles: Triangles,
    across: Triangles,
    fixed: NDArray[np.int64],
    merged: NDArray[np.uint8],
) -> int:
    """Set bit k of `merged` where the edge from corner k to k + 1 is a tie; return their number."""
    terms = np.empty(TERMS)
    ties = 0
    for t in range(len(triangles)):
        for k in range(3):
            other = across[t, k]
            if other > t:
                start, end = triangles[t, k], triangles[t, (k + 1) % 3]
                j = _ending_at(triangles, other, start)
                apex, far = triangles[t, (k + 2) % 3], triangles[other, (j + 2) % 3]
                if cocircular(points, apex, start, end, far, terms):
                    key = (np.int64(min(start, end)) << 32) | np.int64(max(start, end))
                    place = np.searchsorted(fixed, key)
                    if place == len(fixed) or fixed[place] != key:
                        merged[t] |= 1 << k
                        merged[other] |= 1 << j
                        ties += 1
    return ties


@kernel
def _ending_at(triangles: Triangles, t: int, vertex: int) -> int:
    """Return the corner of triangle t from which its edge to `vertex` starts."""
    if triangles[t, 1] == vertex:
        return 0
    return 1 if triangles[t, 2] == vertex else 2


@kernel
def _fan(
    points: NDArray[np.float64],
    triangles: Triangles,
    across: Triangles,
    merged: NDArray[np.uint8],
) -> None:
    """Replace each group of merged triangles by a fan around its lowest vertex."""
    ring, beyond, slots = np.empty(64, np.int32), np.empty(64, np.int32), np.empty(64, np.int32)
    for first in range(len(triangles)):
        if merged[first] == 0:
            continue
        # Once around the polygon: at each vertex, turn over the merged edges to the next border.
        t, k = first, 0
        while (merged[t] >> k) & 1:
            t, k = _turn(triangles, across, t, k)
        start_t, start_k = t, k
        count = taken = 0
        while True:
            if count + 1 >= len(ring):
                ring = np.concatenate((ring, np.empty_like(ring)))
                beyond = np.concatenate((beyond, np.empty_like(beyond)))
                slots = np.concatenate((slots, np.empty_like(slots)))
            ring[count], beyond[count] = triangles[t, k], across[t, k]
            count += 1
            if merged[t] < _LISTED:
                merged[t] |= _LISTED
                slots[taken] = t
                taken += 1
            k = (k + 1) % 3
            while (merged[t] >> k) & 1:
                t, k = _turn(triangles, across, t, k)
                if merged[t] < _LISTED:
                    merged[t] |= _LISTED
                    slots[taken] = t
                    taken += 1
            if t == start_t and k == start_k:
                break
        low = 0
        for i in range(1, count):
            y, least = points[ring[i], 1], points[ring[low], 1]
            if y < least or (y == least and points[ring[i], 0] < points[ring[low], 0]):
                low = i
        for i in range(taken):
            t, one, two = slots[i], (low + 1 + i) % count, (low + 2 + i) % count
            triangles[t, 0], triangles[t, 1], triangles[t, 2] = ring[low], ring[one], ring[two]
            across[t, 0] = beyond[low] if i == 0 else slots[i - 1]
            across[t, 1] = beyond[one]
            across[t, 2] = beyond[two] if i == taken - 1 else slots[i + 1]
            merged[t] = 0
        for i in range(count):
            if beyond[i] != FILL:
                place = min(max((i - low) % count - 1, 0), taken - 1)
                across[beyond[i], _ending_at(triangles, beyond[i], ring[i])] = slots[place]


@kernel
def _turn(triangles: Triangles, across: Triangles, t: int, k: int) -> tuple[int, int]:
    """Return the edge that starts at the same vertex as edge k of t, in the triangle across it."""
    other = across[t, k]
    return other, (_ending_at(triangles, other, triangles[t, k]) + 1) % 3
