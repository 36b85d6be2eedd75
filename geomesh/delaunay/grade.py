"""Add nodes to a constrained triangulation until its triangles have no small angles.

This is Delaunay refinement (Ruppert 1995) with off-centres (Üngör 2004), a batch at a time: the
triangulation is made anew after each batch. It is used for the few nodes with which adaptive
refinement starts, so its speed does not matter.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from geomesh.delaunay.triangulate import constrained_delaunay
from geomesh.mesh.topology import edge_keys
from geomesh.raster.grid import LATTICE, snap

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Ids, Mask, Points, Triangles

_MOST_ROUNDS = 30

# Shortest side in pixels at which a node is still added.
_SHORTEST = 0.25


class Graded(NamedTuple):
    """Nodes and segments without small angles between them.

    Attributes
    ----------
    points : float64 (N, 2)
        The given points come first.
    segments : int32 (S, 2)
        Pairs of points; a given segment may be in several pieces.
    is_line : bool (S,)
        Which of the segments are lines inside the domain.
    """

    points: Points
    segments: Ids
    is_line: Mask


def grade(
    points: Points,
    segments: Ids,
    is_line: Mask,
    min_angle: float,
    threads: Executor | None = None,
) -> Graded:
    """Add nodes, and split segments, until no angle is below `min_angle` where that is possible.

    Small angles between two segments stay. So do those at segments that cannot be split on the
    lattice of 1/256 pixel.

    Parameters
    ----------
    points : float64 (N, 2)
        On the lattice.
    segments : int32 (S, 2)
        The outline, and lines inside it.
    is_line : bool (S,)
        Which of the segments are lines.
    min_angle : float
        In degrees, up to about 25.
    threads : Executor, optional
    """
    limit = math.sin(math.radians(min_angle))
    for _ in range(_MOST_ROUNDS):
        triangles, _ = constrained_delaunay(
            points, segments[~is_line], lines=segments[is_line], executor=threads
        )
        corner, shortest = _sharpest(points, triangles, segments, limit)
        if not len(corner):
            break
        wanted = _off_centres(points, triangles[corner], min_angle)
        apart = _apart(wanted, 0.7 * shortest)
        wanted, near = wanted[apart], points[triangles[corner[apart]]].mean(axis=1)
        crossed = _crossed(points, segments, near, wanted)
        split, middles = _halves(points, segments, np.unique(crossed[crossed >= 0]))
        inner = snap(wanted[crossed < 0])
        if not len(split) and not len(inner):
            break
        count = len(points)
        places = count + np.arange(len(split), dtype=np.int32)
        points = np.concatenate([points, middles, inner])
        one, other = segments[split].T
        segments = np.concatenate(
            [
                np.delete(segments, split, axis=0),
                np.column_stack([one, places]),
                np.column_stack([places, other]),
            ]
        ).astype(np.int32)
        is_line = np.concatenate([np.delete(is_line, split), is_line[split], is_line[split]])
        points, segments = _distinct(points, segments)
    return Graded(points, segments, is_line)


def _sharpest(
    points: Points, triangles: Triangles, segments: Ids, limit: float
) -> tuple[NDArray[np.intp], Floats]:
    """Return the triangles with too small an angle that can be improved, the shortest first.

    Returns
    -------
    rows : int (k,)
    shortest : float64 (k,)
        Their shortest sides.
    """
    corners = points[triangles]
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]  # side k is opposite to corner k
    squared = (sides**2).sum(axis=2)
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    ordered = np.sort(squared, axis=1)
    sine = area / np.sqrt(ordered[:, 1] * ordered[:, 2])
    rows = np.flatnonzero((sine < limit) & (ordered[:, 0] > _SHORTEST**2))
    # The smallest angle is opposite to the shortest side, between the two others.
    k = squared[rows].argmin(axis=1)
    keys = np.unique(edge_keys(segments))
    fixed = np.ones(len(rows), np.bool_)
    for turn in (1, 2):
        ends = triangles[rows, k], triangles[rows, (k + turn) % 3]
        side = edge_keys(np.column_stack(ends))
        place = np.minimum(np.searchsorted(keys, side), len(keys) - 1)
        fixed &= keys[place] == side
    rows = rows[~fixed]
    shortest = np.sqrt(ordered[rows, 0])
    order = np.lexsort((rows, shortest))
    return rows[order], shortest[order]


def _off_centres(points: Points, triangles: Triangles, min_angle: float) -> Points:
    """Return a place for a node that improves each triangle.

    It is the circumcentre, or a place on the way there from the shortest side at which that
    side is seen at a little more than `min_angle`.
    """
    corners = points[triangles]
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    k = (sides**2).sum(axis=2).argmin(axis=1)
    row = np.arange(len(triangles))
    a, b, c = (corners[row, (k + turn) % 3] for turn in (1, 2, 0))  # a, b: the shortest side
    u, v = b - a, c - a
    cross = 2 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    uu, vv = (u**2).sum(axis=1), (v**2).sum(axis=1)
    centre = a + np.column_stack(
        [(v[:, 1] * uu - u[:, 1] * vv) / cross, (u[:, 0] * vv - v[:, 0] * uu) / cross]
    )
    middle = (a + b) / 2
    way = centre - middle
    length = np.maximum(np.hypot(*way.T), 1e-12)
    farthest = np.sqrt(uu) / 2 / math.tan(math.radians(min_angle + 3) / 2)
    places: Points = middle + way * np.minimum(1, farthest / length)[:, None]
    return places


def _apart(points: Points, distance: Floats) -> Mask:
    """Return which points to take so that none is nearer to an earlier one than its distance."""
    from scipy.spatial import cKDTree  # takes a while to import

    chosen = np.ones(len(points), np.bool_)
    tree = cKDTree(points)
    for i, neighbours in enumerate(tree.query_ball_point(points, distance)):
        if chosen[i]:
            for other in neighbours:
                if other > i:
                    chosen[other] = False
    return chosen


def _crossed(points: Points, segments: Ids, near: Points, wanted: Points) -> NDArray[np.intp]:
    """Return for each wanted node the segment that it is too near to or behind, or -1.

    It is behind a segment if the line to it, from `near` inside the triangle, crosses the
    segment; it is too near if the segment's ends see it under a right angle or more.
    """
    one, other = points[segments[:, 0]], points[segments[:, 1]]
    result = np.full(len(wanted), -1, np.intp)
    centre, radius = (one + other) / 2, np.hypot(*(other - one).T) / 2
    boxes = shapely.STRtree(
        shapely.box(*(centre - radius[:, None]).T, *(centre + radius[:, None]).T)
    )
    node, segment = boxes.query(shapely.points(wanted))
    inside = np.hypot(*(wanted[node] - centre[segment]).T) < radius[segment]
    result[node[inside]] = segment[inside]
    lines = shapely.STRtree(shapely.linestrings(np.stack([one, other], axis=1)))
    ways = shapely.linestrings(np.stack([near, wanted], axis=1))
    node, segment = lines.query(ways, predicate="intersects")
    # The first segment on the way.
    distance = shapely.distance(
        shapely.points(near[node]),
        shapely.linestrings(np.stack([one[segment], other[segment]], axis=1)),
    )
    order = np.lexsort((segment, -distance))
    result[node[order]] = segment[order]
    return result


def _halves(
    points: Points, segments: Ids, chosen: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Points]:
    """Return those of the chosen segments that can be halved, and their middles on the lattice.

    A middle lies exactly on its segment, so the pixels on either side stay there.
    """
    one, other = (np.rint(points[segments[chosen, k]] * LATTICE).astype(np.int64) for k in (0, 1))
    side = other - one
    steps = np.gcd(np.abs(side[:, 0]), np.abs(side[:, 1]))
    fits = (steps >= 2) & (np.hypot(*side.T) >= 2 * _SHORTEST * LATTICE)
    half = steps[fits] // 2
    middles = one[fits] + side[fits] // steps[fits, None] * half[:, None]
    return chosen[fits], middles / LATTICE


def _distinct(points: Points, segments: Ids) -> tuple[Points, Ids]:
    """Return the points without repetitions, in the order in which they first occur."""
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    return points[np.sort(first)], number[place.ravel()][segments]
