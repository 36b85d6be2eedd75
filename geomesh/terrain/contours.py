"""Contours of a linear surface: exact, joined into longest lines, which never cross.

A node on a level counts as above it. So in each triangle a level is a single segment between two
of its edges, or it is not there at all, and the segments of neighbours meet on their edge: a
contour can neither branch nor cross another. Higher ground is to its left.

What this rule makes of nodes on a level has no extent: contours around a single node, and two
that run along an edge, one on each side. These are taken away by the ids of nodes and edges. Then
lines can still touch in a node, where four of them would end if it were a little higher or lower.
A line that touches itself becomes two, so that each is simple.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.parallel.progress import silent
from geomesh.terrain.chains import join

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Ids, Mask, Points, Triangles
    from geomesh.mesh.topology import Edges
    from geomesh.parallel.progress import Progress

# Levels are traced together while they cross at most so many edges: they need about 250 bytes
# each. Of one level alone there may be more.
_AT_ONCE = 1_000_000

# A contour this near to a node, in units of the last place of the coordinates, is at the node.
_SLACK = 8


class Contours(NamedTuple):
    """Contours, by level, and those of a level in the order of their first triangles.

    Attributes
    ----------
    rank : int64 (K,)
        The level of each line, as its number.
    closed : bool (K,)
        Whether the line ends where it begins.
    offsets : int64 (K + 1,)
        Where the vertices of each line begin in `places`.
    places : float64 (P, 2)
        Vertices on the map.
    """

    rank: Counts
    closed: Mask
    offsets: Counts
    places: Points


class _Surface(NamedTuple):
    """A surface, and which levels cross its edges and triangles.

    `sides` (T, 3) are edges: column k is that from corner k to the next. Levels cross an edge
    from the rank `of_edges[0]` to before `of_edges[1]`.
    """

    points: Points
    heights: Floats
    triangles: Triangles
    edges: Ids
    sides: Ids
    of_edges: Counts
    of_triangles: Counts


def count_crossings(heights: Floats, edges: Edges, levels: Floats) -> int:
    """Return how many vertices contours have: where levels cross edges (see `trace_contours`)."""
    first, stop = _crossed(heights[edges.nodes], levels)
    return int((stop - first).sum())


def trace_contours(
    points: Points,
    heights: Floats,
    triangles: Triangles,
    edges: Edges,
    levels: Floats,
    progress: Progress = silent,
) -> Contours:
    """Return the contours of a surface that is linear in each triangle.

    Parameters
    ----------
    points : float64 (N, 2)
    heights : float64 (N,)
        Triangles with a corner whose height is not finite are voids: contours end there.
    triangles : int32 (T, 3)
        Counter-clockwise.
    edges : Edges
        Those of the triangles; none is in more than two.
    levels : float64 (L,)
        In rising order.
    progress : callable(fraction, message), optional
    """
    surface = _Surface(
        points,
        heights,
        triangles,
        edges.nodes,
        _sides(triangles, edges),
        np.stack(_crossed(heights[edges.nodes], levels)),
        np.stack(_crossed(heights[triangles], levels)),
    )
    parts = []
    for first, stop in _stretches(surface.of_edges, len(levels)):
        progress(first / len(levels), f"Tracing contours at {len(levels):,} levels")
        parts.append(_trace(surface, levels, first, stop))
    if not parts:
        none = np.empty(0, np.int64)
        return Contours(none, none.astype(np.bool_), _offsets(none), np.empty((0, 2)))
    sizes = np.concatenate([np.diff(part.offsets) for part in parts])
    return Contours(
        np.concatenate([part.rank for part in parts]),
        np.concatenate([part.closed for part in parts]),
        _offsets(sizes),
        np.concatenate([part.places for part in parts]),
    )


def _offsets(sizes: Counts) -> Counts:
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])


def _crossed(heights: Floats, levels: Floats) -> tuple[Counts, Counts]:
    """Return the ranks from which and before which levels cross edges or triangles (n, k)."""
    first = np.searchsorted(levels, heights.min(axis=1), side="right")
    stop = np.searchsorted(levels, heights.max(axis=1), side="right")
    stop[~np.isfinite(heights).all(axis=1)] = 0
    return np.minimum(first, stop), stop


def _sides(triangles: Triangles, edges: Edges) -> Ids:
    sides = np.full(triangles.shape, -1, np.int32)
    # In the triangle to the left an edge goes from its lower node, to the right from its higher.
    for beside, begin in ((edges.left, edges.nodes[:, 0]), (edges.right, edges.nodes[:, 1])):
        edge = np.flatnonzero(beside >= 0)
        triangle = beside[edge]
        corner = (triangles[triangle] == begin[edge, None]).argmax(axis=1)
        sides[triangle, corner] = edge
    return sides


def _stretches(of_edges: Counts, count: int) -> list[tuple[int, int]]:
    """Return ranges of levels that cross at most `_AT_ONCE` edges, or of a single level."""
    begun, ended = (np.bincount(ranks, minlength=count + 1) for ranks in of_edges)
    crossings = np.cumsum(begun - ended)[:count]
    total = _offsets(crossings)
    stretches, first = [], 0
    while first < count:
        within = int(np.searchsorted(total, total[first] + _AT_ONCE, side="right")) - 1
        stop = min(max(within, first + 1), count)
        stretches.append((first, stop))
        first = stop
    return stretches


def _expand(ranks: Counts, first: int, stop: int) -> tuple[Counts, Counts, Counts]:
    """Return which items levels from `first` to before `stop` cross, one row for each crossing.

    Returns
    -------
    item, rank : int64 (C,)
    before : int64 (n,)
        The row of an item and a rank is ``before[item] + rank``.
    """
    begin = np.maximum(ranks[0], first)
    sizes = np.maximum(np.minimum(ranks[1], stop) - begin, 0)
    before = np.cumsum(sizes) - sizes - begin
    item = np.repeat(np.arange(len(sizes)), sizes)
    return item, np.arange(len(item)) - before[item], before


def _trace(surface: _Surface, levels: Floats, first: int, stop: int) -> Contours:
    """Return the contours of the levels from `first` to before `stop`."""
    edge, rank, before = _expand(surface.of_edges, first, stop)
    places, node = _places(surface, edge, levels[rank])
    triangle, of_segment, _ = _expand(surface.of_triangles, first, stop)
    begin, end = (
        before[surface.sides[triangle, side]] + of_segment
        for side in _ways(surface, triangle, levels[of_segment])
    )
    # What crossings are as points: those at a node are the same.
    point = np.where(node >= 0, node, len(surface.points) + edge)
    lines = join(begin, end, point, node, of_segment, len(surface.points))
    order = np.argsort(rank[lines.visits[lines.offsets[:-1]]], kind="stable")
    sizes = np.diff(lines.offsets)[order]
    rows = np.repeat(lines.offsets[:-1][order] - _offsets(sizes)[:-1], sizes)
    visits = lines.visits[rows + np.arange(len(rows))]
    found = Contours(
        rank[lines.visits[lines.offsets[:-1]]][order],
        lines.closed[order],
        _offsets(sizes),
        places[visits],
    )
    return _without_repeated(found)


def _places(surface: _Surface, edge: Counts, level: Floats) -> tuple[Points, Counts]:
    """Return where levels cross edges, and at which nodes: -1 if at none."""
    start, stop = surface.edges[edge].T
    low, high = surface.heights[start], surface.heights[stop]
    share = ((level - low) / (high - low))[:, None]
    places = surface.points[start] + share * (surface.points[stop] - surface.points[start])
    slack = _SLACK * np.finfo(np.float64).eps * np.abs(surface.points).max(initial=0)
    node = np.full(len(edge), -1, np.int64)
    for end, height in ((start, low), (stop, high)):
        there = height == level
        there |= (np.abs(places - surface.points[end]) <= slack).all(axis=1)
        places[there], node[there] = surface.points[end[there]], end[there]
    return places, node


def _ways(surface: _Surface, triangle: Counts, level: Floats) -> tuple[Counts, Counts]:
    """Return the sides by which contours enter triangles and leave them, higher ground left."""
    below = surface.heights[surface.triangles[triangle]] < level[:, None]
    following = below[:, [1, 2, 0]]
    return (~below & following).argmax(axis=1), (below & ~following).argmax(axis=1)


def _without_repeated(lines: Contours) -> Contours:
    """Return lines without points repeated in a row, and without lines that are only a point."""
    if not len(lines.places):
        return lines
    line = np.repeat(np.arange(len(lines.rank)), np.diff(lines.offsets))
    kept = np.ones(len(lines.places), np.bool_)
    kept[1:] = (lines.places[1:] != lines.places[:-1]).any(axis=1) | (line[1:] != line[:-1])
    sizes = np.bincount(line[kept], minlength=len(lines.rank))
    # A ring of two sides covers nothing.
    sound = sizes >= np.where(lines.closed, 4, 2)
    kept &= sound[line]
    return Contours(
        lines.rank[sound], lines.closed[sound], _offsets(sizes[sound]), lines.places[kept]
    )
