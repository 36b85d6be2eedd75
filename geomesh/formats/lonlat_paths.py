"""Edges of a mesh in longitude and latitude, where a straight line of the map is a curve.

An edge gets points of its own where the straight line between its ends, in longitude and
latitude, would leave the true one by more than a sixteenth of a pixel. So both triangles beside
it keep the same border, wherever they lie, and each stays on the pixels that it was made from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Points

    ToLonLat = Callable[[Points], Points]

# In pixels.
_TOLERANCE = 1 / 16

# An edge of n pixels that leaves a great circle no faster than this many times what a
# parallel does is not looked at, while that must be within the tolerance.
_CURVATURE = 20.0

# Even a short edge may go around a pole if it seems to turn by more degrees than this.
_SUSPECT_TURN = 90.0

_STARTING_PIECES = 4
_MOST_HALVINGS = 20

# So many triangles tell the size of a pixel on the ground.
_SAMPLE = 1000


@dataclass(frozen=True)
class Paths:
    """What lies between the ends of edges.

    Parameters
    ----------
    turn : float64 (E,)
        Change of longitude from the first end to the second, in degrees, by the way that the
        edge takes.
    begin : float64 (E,)
        Longitude of the first end.
    offsets : int (E + 1,)
        Row of the first point of each edge in `inner`.
    inner : float64 (P, 2)
        Longitude and latitude of the points between the ends; longitudes go on from that of
        the first end instead of jumping at 180.
    """

    turn: NDArray[np.float64]
    begin: NDArray[np.float64]
    offsets: NDArray[np.int64]
    inner: Points

    def along(
        self,
        corners: Points,
        nodes: NDArray[np.integer],
        sides: NDArray[np.intp],
        decimals: int,
    ) -> Points:
        """Return a ring or line with the points between its corners.

        Parameters
        ----------
        corners : float64 (V, 2)
            Longitudes go on from corner to corner.
        nodes : int (V,)
        sides : int (V - 1,)
            The edges between them.
        decimals : int
            To which the points between the corners are rounded.
        """
        parts = []
        for k, side in enumerate(sides.tolist()):
            between = self.inner[self.offsets[side] : self.offsets[side + 1]]
            origin = self.begin[side]
            if nodes[k] > nodes[k + 1]:
                between = between[::-1]
                origin += self.turn[side]
            shift = whole_turns(corners[k, 0] - origin)
            parts += [corners[k : k + 1], (between + np.array([shift, 0.0])).round(decimals)]
        return np.vstack([*parts, corners[-1:]])


@dataclass(frozen=True, eq=False)
class Follower:
    """Follows the edges of a mesh.

    Parameters
    ----------
    nodes : float64 (N, 2)
        On the map.
    lonlat : float64 (N, 2)
        The same in degrees.
    pixels : float64 (N, 2)
        The same in pixels.
    to_lonlat : callable
        From map coordinates (P, 2) to degrees; not finite where there are none.
    pixel : float
        Size of a pixel on the ground, in radians.
    """

    nodes: Points
    lonlat: Points
    pixels: Points
    to_lonlat: ToLonLat
    pixel: float

    @classmethod
    def of(
        cls,
        nodes: Points,
        lonlat: Points,
        pixels: Points,
        triangles: NDArray[np.integer],
        to_lonlat: ToLonLat,
    ) -> Follower:
        """Return the follower for a mesh; some of its triangles tell the size of a pixel."""
        some = triangles[:: max(len(triangles) // _SAMPLE, 1)]
        start, stop = some.ravel(), np.roll(some, -1, axis=1).ravel()
        lengths = np.hypot(*(pixels[stop] - pixels[start]).T)
        # Not the middle: the ends of some edges are in one place, as all of a pole's row are.
        pixel = float(np.quantile(_arc(lonlat[start], lonlat[stop]) / lengths, 0.9))
        return cls(nodes, lonlat, pixels, to_lonlat, pixel)

    def follow(self, start: NDArray[np.integer], stop: NDArray[np.integer]) -> Paths:
        """Return the paths of edges between nodes (E,) and (E,).

        To be called with the smaller node first: so two triangles that share an edge get the
        same points.
        """
        turn = self.lonlat[stop, 0] - self.lonlat[start, 0]
        lengths = np.hypot(*(self.pixels[stop] - self.pixels[start]).T)
        steepest = np.maximum(np.abs(self.lonlat[start, 1]), np.abs(self.lonlat[stop, 1]))
        slope = 1 + np.tan(np.radians(np.minimum(steepest, 89.0)))
        curved = lengths**2 * self.pixel * slope * _CURVATURE > 8 * _TOLERANCE
        followed = np.flatnonzero(curved | (np.abs(turn) > _SUSPECT_TURN))
        edge, share, places = self._points(start[followed], stop[followed], lengths[followed])
        return self._unroll(start, stop, turn, followed, edge, share, places)

    def _points(
        self,
        start: NDArray[np.integer],
        stop: NDArray[np.integer],
        lengths: NDArray[np.float64],
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], Points]:
        """Return points between the ends of edges: the edge, the share of it, the place."""
        count = len(start)
        shares = np.arange(_STARTING_PIECES + 1) / _STARTING_PIECES
        edge = np.repeat(np.arange(count), len(shares) - 2)
        share = np.tile(shares[1:-1], count)
        place = self._at(start[edge], stop[edge], share)
        kept = [(edge, share, place)]
        grid = np.concatenate(
            [
                self.lonlat[start][:, None],
                place.reshape(count, len(shares) - 2, 2),
                self.lonlat[stop][:, None],
            ],
            axis=1,
        )
        edge = np.repeat(np.arange(count), _STARTING_PIECES)
        low, high = (np.tile(each, count) for each in (shares[:-1], shares[1:]))
        first, last = grid[:, :-1].reshape(-1, 2), grid[:, 1:].reshape(-1, 2)
        for _ in range(_MOST_HALVINGS):
            middle = (low + high) / 2
            place = self._at(start[edge], stop[edge], middle)
            pixels = lengths[edge] * (high - low)
            turn = _short_way(last[:, 0] - first[:, 0])
            ends = np.column_stack([first[:, 0] + turn, last[:, 1]])
            split = _leaves(first, place, ends, np.full(len(edge), 0.5), pixels)
            if not split.any():
                break
            edge, low, high, middle = edge[split], low[split], high[split], middle[split]
            first, last, place = first[split], last[split], place[split]
            kept.append((edge, middle, place))
            edge = np.concatenate([edge, edge])
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            first, last = np.concatenate([first, place]), np.concatenate([place, last])
        edge, share, place = (np.concatenate(each) for each in zip(*kept, strict=True))
        order = np.lexsort((share, edge))
        order = order[np.isfinite(place[order, 0])]
        return edge[order], share[order], place[order]

    def _unroll(
        self,
        start: NDArray[np.integer],
        stop: NDArray[np.integer],
        turn: NDArray[np.float64],
        followed: NDArray[np.intp],
        edge: NDArray[np.intp],
        share: NDArray[np.float64],
        places: Points,
    ) -> Paths:
        """Let longitudes go on along the followed edges, and drop the points of straight ones."""
        first, last = self.lonlat[start[followed]], self.lonlat[stop[followed]]
        counts = np.bincount(edge, minlength=len(followed))
        begins = np.concatenate([[0], np.cumsum(counts)])
        inside = np.arange(len(edge)) - begins[edge]
        previous = np.where((inside == 0)[:, None], first[edge], np.roll(places, 1, axis=0))
        steps = _short_way(places[:, 0] - previous[:, 0])
        total = np.concatenate([[0.0], np.cumsum(steps)])
        gone = total[1:] - total[begins[edge]]
        before_last = first[:, 0].copy()
        some = counts > 0
        before_last[some] = places[begins[1:][some] - 1, 0]
        whole = total[begins[1:]] - total[begins[:-1]] + _short_way(last[:, 0] - before_last)
        turn[followed] = whole
        inner = np.column_stack([first[edge, 0] + gone, places[:, 1]])
        lengths = np.hypot(*(self.pixels[stop[followed]] - self.pixels[start[followed]]).T)
        ends = np.column_stack([first[:, 0] + whole, last[:, 1]])
        leaves = _leaves(first[edge], inner, ends[edge], share, lengths[edge])
        bent = np.bincount(edge, leaves, minlength=len(followed)) > 0
        inner = inner[bent[edge]]
        sizes = np.zeros(len(start), np.int64)
        sizes[followed] = np.where(bent, counts, 0)
        return Paths(turn, self.lonlat[start, 0], np.concatenate([[0], np.cumsum(sizes)]), inner)

    def _at(
        self,
        start: NDArray[np.integer],
        stop: NDArray[np.integer],
        share: NDArray[np.float64],
    ) -> Points:
        part = share[:, None]
        return self.to_lonlat(self.nodes[start] * (1 - part) + self.nodes[stop] * part)


def whole_turns(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nearest multiple of 360; symmetric: that of -180 and of 180 is 0."""
    turns: NDArray[np.float64] = 360 * np.round(degrees / 360)
    return turns


def _short_way(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    return turn - whole_turns(turn)


def _leaves(
    first: Points,
    place: Points,
    last: Points,
    share: NDArray[np.float64],
    pixels: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return whether a place (n, 2) is off the straight line between two others.

    It should be at a share of the way. `pixels` is the length of the line. Longitudes go on
    from the first place to the last.
    """
    straight = first + share[:, None] * (last - first)
    length = _arc(first, place) + _arc(place, last)
    with np.errstate(invalid="ignore"):
        off: NDArray[np.bool_] = _arc(place, straight) * pixels > _TOLERANCE * length
    return off


def _arc(one: Points, other: Points) -> NDArray[np.float64]:
    """Great-circle distance in radians between places (n, 2) in degrees."""
    (lon, lat), (lon_too, lat_too) = np.radians(one).T, np.radians(other).T
    square = (
        np.sin((lat - lat_too) / 2) ** 2
        + np.cos(lat) * np.cos(lat_too) * np.sin((lon - lon_too) / 2) ** 2
    )
    distance: NDArray[np.float64] = 2 * np.arcsin(np.sqrt(np.clip(square, 0, 1)))
    return distance
