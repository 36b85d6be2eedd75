"""Breaklines: lines that become edges, simplified, noded, and cut to the domain.

Nodes of breaklines lie on a grid of half a pixel, as the corners of the outline do. So they are
not closer to each other than that, and triangles between them are not thinner than need be. A
line that passes another one, or a node, at a smaller distance goes through it.

The outline is not moved. It has stations, at least half a pixel apart. A breakline that
crosses the outline, or comes closer to it than half a pixel, goes to the nearest station, and
the station becomes a node of the outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from geomesh.domain.loops import loop_area
from geomesh.raster.grid import LATTICE, snap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask, Points

# Smallest distance between nodes of breaklines, and to the outline, in pixels.
GAP = 0.5

# A piece is dropped if one of its ends is free and it is shorter than this, in pixels.
_SHORTEST = 2.0

# A piece whose middle is closer to the outline than this, in pixels, runs along it.
_ALONG = 0.2

# Lines are cut this far outside of the domain first, in pixels.
_MARGIN = 2.0


@dataclass(frozen=True)
class Laid:
    """An outline and breaklines that fit together.

    Attributes
    ----------
    loops : list of float64 (k, 2)
        The loops of the outline, with the nodes where breaklines meet it.
    chains : list of float64 (k, 2)
        The breaklines. They meet only at their ends, and none crosses the outline. The first
        point of a closed chain is also its last.
    """

    loops: list[Points]
    chains: list[Points]


class _Outline(NamedTuple):
    """The segments of the outline.

    Attributes
    ----------
    start, side : float64 (M, 2)
    stations : int64 (M,)
        Number of parts into which the stations divide each segment.
    tree : shapely.STRtree
        Of the segments.
    """

    start: Points
    side: Points
    stations: NDArray[np.int64]
    tree: shapely.STRtree

    @classmethod
    def of(cls, loops: Sequence[Points]) -> _Outline:
        start = np.concatenate(loops)
        stop = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
        length = np.hypot(*(stop - start).T)
        stations = np.maximum(np.floor(length / GAP), 1).astype(np.int64)
        return cls(start, stop - start, stations, shapely.STRtree(_lines(start, stop)))

    def nearest_station(self, points: Points, segment: NDArray[np.intp]) -> Points:
        """Return the station of a segment (N,) that is nearest to a point (N, 2)."""
        side = self.side[segment]
        share = ((points - self.start[segment]) * side).sum(axis=1) / (side**2).sum(axis=1)
        count = self.stations[segment]
        return self.station(segment, np.clip(np.rint(share * count), 0, count))

    def station(self, segment: NDArray[np.intp], number: Floats) -> Points:
        """Return stations (N, 2) of segments by their numbers."""
        share = number / self.stations[segment]
        return snap(self.start[segment] + share[:, None] * self.side[segment])

    def is_near(self, points: Points, distance: float) -> Mask:
        """Return which points (N, 2) are closer to the outline than `distance`."""
        found = np.zeros(len(points), np.bool_)
        pairs = self.tree.query(shapely.points(points), predicate="dwithin", distance=distance)
        found[pairs[0]] = True
        return found


def lay_breaklines(lines: NDArray[Any], loops: Sequence[Points], tolerance: float) -> Laid:
    """Simplify lines, node them, cut them to the area inside loops, and join them to the outline.

    Parameters
    ----------
    lines : array of shapely LineString
        In pixel-edge coordinates.
    loops : sequence of float64 (k, 2)
        Loops of the outline: nodes on the lattice, positive area around data.
    tolerance : float
        Largest distance of a simplified line to the given one, in pixels. Noding moves it by up to
        half a pixel more.
    """
    low, high = np.concatenate(loops).min(axis=0), np.concatenate(loops).max(axis=0)
    lines = shapely.clip_by_rect(lines, *(low - _MARGIN), *(high + _MARGIN))
    lines = shapely.simplify(shapely.get_parts(lines), tolerance, preserve_topology=False)
    segments = _noded(lines[shapely.length(lines) > 0], GAP)
    outline = _Outline.of(loops)
    segments = _cut(segments, outline)
    segments = segments[_is_inside(segments.mean(axis=1), loops, outline)]
    # Where segments were moved to the outline, they may cross once more.
    segments = _noded(shapely.linestrings(segments), 1 / LATTICE)
    chains = _long_chains(segments, outline)
    return Laid(_with_stations(loops, outline, chains), chains)


def _lines(start: Points, stop: Points) -> NDArray[Any]:
    return np.asarray(shapely.linestrings(np.stack([start, stop], axis=1)))


def _noded(lines: NDArray[Any], grid_size: float) -> Points:
    """Return segments (S, 2, 2) that meet at their ends only, with ends on a grid."""
    union = shapely.union_all(lines, grid_size=grid_size)
    parts = shapely.get_parts(union)
    points, line = shapely.get_coordinates(
        parts[shapely.get_dimensions(parts) == 1], return_index=True
    )
    same = np.diff(line) == 0
    return np.stack([points[:-1][same], points[1:][same]], axis=1)


def _cut(segments: Points, outline: _Outline) -> Points:
    """Split segments (S, 2, 2) at the outline, and move their ends near it onto stations."""
    count = len(segments)
    start, side = segments[:, 0], segments[:, 1] - segments[:, 0]
    ends, position = np.unique(segments.reshape(-1, 2), axis=0, return_inverse=True)
    point, segment = outline.tree.query_nearest(
        shapely.points(ends), max_distance=GAP, all_matches=False
    )
    near = shapely.distance(shapely.points(ends[point]), outline.tree.geometries[segment]) < GAP
    point, segment = point[near], segment[near]
    ends[point] = outline.nearest_station(ends[point], segment)
    ends = ends[position.ravel()].reshape(-1, 2, 2)
    # At crossings, go through a station.
    of, across = outline.tree.query(shapely.linestrings(segments), predicate="intersects")
    offset = outline.start[across] - start[of]
    other = outline.side[across]
    cross = side[of, 0] * other[:, 1] - side[of, 1] * other[:, 0]
    cuts = cross != 0
    of, across, offset, other, cross = (a[cuts] for a in (of, across, offset, other, cross))
    share = (offset[:, 0] * other[:, 1] - offset[:, 1] * other[:, 0]) / cross
    stations = outline.nearest_station(start[of] + share[:, None] * side[of], across)
    # Near a corner of the outline, go through the corner.
    corners, passing = shapely.STRtree(shapely.linestrings(segments)).query(
        shapely.points(outline.start), predicate="dwithin", distance=GAP
    )
    corner = outline.start[corners]
    along = ((corner - start[passing]) * side[passing]).sum(axis=1) / np.maximum(
        (side[passing] ** 2).sum(axis=1), np.finfo(float).tiny
    )
    between = (along > 0) & (along < 1)
    numbers = np.arange(count)
    owner = np.concatenate([numbers, of, passing[between], numbers])
    shares = [np.full(count, -1.0), share.clip(0, 1), along[between], np.full(count, 2.0)]
    points = np.concatenate([ends[:, 0], stations, corner[between], ends[:, 1]])
    order = np.lexsort((*points.T, np.concatenate(shares), owner))
    owner, points = owner[order], points[order]
    kept = (np.diff(owner) == 0) & (points[1:] != points[:-1]).any(axis=1)
    pieces: Points = np.stack([points[:-1][kept], points[1:][kept]], axis=1)
    return pieces


def _is_inside(points: Points, loops: Sequence[Points], outline: _Outline) -> Mask:
    """Return which points (N, 2) are inside the loops and not on the outline."""
    if not len(points):
        return np.zeros(0, np.bool_)
    depth = np.zeros(len(points), np.int64)
    loop, point = shapely.STRtree(shapely.points(points)).query(
        np.array([shapely.Polygon(loop) for loop in loops]), predicate="contains"
    )
    signs = np.array([1 if loop_area(each) > 0 else -1 for each in loops])
    np.add.at(depth, point, signs[loop])
    return (depth > 0) & ~outline.is_near(points, _ALONG)


def _long_chains(segments: Points, outline: _Outline) -> list[Points]:
    """Join segments (S, 2, 2) to chains between free ends, branches and the outline.

    Short chains with a free end are left out.
    """
    if not len(segments):
        return []
    merged = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(segments)))
    chains = [shapely.get_coordinates(part) for part in shapely.get_parts(merged)]
    chains = [piece for chain in chains for piece in _split(chain, outline)]
    ends = np.concatenate([chain[[0, -1]] for chain in chains])
    _, place, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    free = (uses[place.ravel()] == 1) & ~outline.is_near(ends, 1 / LATTICE)
    has_free = free.reshape(-1, 2).any(axis=1)
    chains = [
        chain
        for chain, is_free in zip(chains, has_free, strict=True)
        if not is_free or np.hypot(*np.diff(chain, axis=0).T).sum() >= _SHORTEST
    ]
    # In an order, and a direction, that do not depend on how they were joined.
    chains = [chain if tuple(chain[0]) <= tuple(chain[-1]) else chain[::-1] for chain in chains]
    return sorted(chains, key=lambda chain: chain[:2, ::-1].ravel().tolist())


def _split(chain: Points, outline: _Outline) -> list[Points]:
    """Split a chain where a point between its ends is on the outline."""
    touches = 1 + np.flatnonzero(outline.is_near(chain[1:-1], 1 / LATTICE))
    bounds = [0, *touches.tolist(), len(chain) - 1]
    return [chain[a : b + 1] for a, b in pairwise(bounds)]


def _with_stations(
    loops: Sequence[Points], outline: _Outline, chains: Sequence[Points]
) -> list[Points]:
    """Return the loops with the stations that are ends of chains."""
    if not chains:
        return list(loops)
    ends = np.unique(np.concatenate([chain[[0, -1]] for chain in chains]), axis=0)
    point, segment = outline.tree.query(
        shapely.points(ends), predicate="dwithin", distance=1 / LATTICE
    )
    side = outline.side[segment]
    offset = ends[point] - outline.start[segment]
    share = (offset * side).sum(axis=1) / (side**2).sum(axis=1)
    between = (share > 0) & (share < 1)
    # Not where the point is a corner, or the station of another segment.
    count = outline.stations[segment]
    exact = (outline.station(segment, np.rint(share * count)) == ends[point]).all(axis=1)
    between &= exact & ~np.isin(_keys(ends[point]), _keys(outline.start))
    place = segment[between] + share[between]
    order = np.argsort(place)
    place, stations = place[order], ends[point[between]][order]
    first = np.cumsum([0] + [len(loop) for loop in loops])
    found = []
    for loop, begin, stop in zip(loops, first[:-1], first[1:], strict=True):
        own = (place >= begin) & (place < stop)
        at = place[own].astype(np.intp) + 1 - begin
        found.append(np.insert(loop, at, stations[own], axis=0))
    return found


def _keys(points: Points) -> NDArray[np.complex128]:
    return np.ascontiguousarray(points).view(np.complex128)[:, 0]


def without_crossings(outline: Points, pieces: Points) -> Mask:
    """Return which pieces (S, 2, 2) touch no other piece and no outline except at common ends.

    Of two pieces that cross, the later one is in the way. Noding leaves almost none: they come
    from rounding to the lattice.

    Parameters
    ----------
    outline : float64 (M, 2, 2)
        Segments of the outline.
    pieces : float64 (S, 2, 2)
    """
    every = np.concatenate([outline, pieces])
    shapes = shapely.linestrings(every)
    one, other = shapely.STRtree(shapes).query(shapes[len(outline) :], predicate="intersects")
    one += len(outline)
    earlier = other < one
    one, other = one[earlier], other[earlier]
    keys = _keys(every.reshape(-1, 2)).reshape(-1, 2)
    common = keys[one][:, :, None] == keys[other][:, None, :]
    shared = common.any(axis=(1, 2))
    bad = ~shared
    # With a common end, they must not have the same direction.
    index = np.flatnonzero(shared)
    first = common[index].any(axis=2).argmax(axis=1)
    second = common[index, first].argmax(axis=1)
    u = every[one[index], 1 - first] - every[one[index], first]
    v = every[other[index], 1 - second] - every[other[index], second]
    bad[index] = (u[:, 0] * v[:, 1] == u[:, 1] * v[:, 0]) & ((u * v).sum(axis=1) > 0)
    kept = np.ones(len(every), np.bool_)
    for k in np.flatnonzero(bad)[np.argsort(one[bad], kind="stable")]:  # few, or none
        kept[one[k]] &= not kept[other[k]]
    return kept[len(outline) :]
