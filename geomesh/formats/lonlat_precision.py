"""Number of decimals of longitudes and latitudes with which no triangle collapses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geomesh.formats.lonlat_paths import whole_turns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points, Triangles
    from geomesh.formats.lonlat_paths import Follower

# RFC 7946 (section 11.2) recommends 7 decimals, about a centimetre. A longitude in float64
# has 13 decimals.
DECIMALS = (7, 9, 11, 13)

# A side is a curve if it leaves the straight line by a sixteenth of a pixel. It stays one if
# rounding moves its points by at most this part of a pixel.
_FINE = 1 / 128


class Decimals(NamedTuple):
    """To how many decimals places are rounded.

    Attributes
    ----------
    nodes : int64 (N,)
        Of each node. A node is in the same place in all of its triangles, so these have
        neither gaps nor overlaps, whatever the decimals of its neighbours.
    inner : int
        Of points inside sides that are curves.
    """

    nodes: NDArray[np.int64]
    inner: int

    @property
    def most(self) -> int:
        """The largest number of decimals."""
        return max(int(self.nodes.max(initial=0)), self.inner)


def choose_decimals(
    lonlat: Points,
    triangles: Triangles,
    edges: NDArray[np.int32],
    follower: Follower | None,
    precision: int | None,
) -> Decimals:
    """Return decimals with which no triangle collapses.

    Without `precision`, all nodes have the same: the fewest of 7, 9, 11 and 13 with which rounding
    neither flips a triangle nor makes it flat. With it, nodes have so many, and more only if
    otherwise one of their triangles would be flat or turned over, or a side lose its curve.

    Parameters
    ----------
    lonlat : float64 (N, 2)
    triangles : int32 (T, 3)
    edges : int32 (E, 2)
        With the lower node first.
    follower : Follower, optional
        None if all sides are straight.
    precision : int, optional
    """
    # Without a follower, longitudes go on beyond 180 degrees, and triangles may be as wide.
    is_short = follower is not None

    def turns(places: Points) -> NDArray[np.float64]:
        corners = places[triangles]
        return orientation(short_way(corners) if is_short else corners)

    before = turns(lonlat)
    fitting = (some for some in DECIMALS if (turns(lonlat.round(some)) == before).all())
    most = next(fitting, DECIMALS[-1])
    if precision is None:
        return Decimals(np.full(len(lonlat), most), most)
    chosen, inner = np.full(len(lonlat), precision), precision
    if follower is not None:
        curved = edges[np.diff(follower.follow(*edges.T).offsets) > 0]
        if len(curved):
            fine = int(np.ceil(-np.log10(2 * _FINE * np.degrees(follower.pixel))))
            inner = max(precision, min(fine, most))
            chosen[curved] = inner
    while True:
        lost = turns(round_each(lonlat, chosen)) != before
        corners = np.unique(triangles[lost])
        corners = corners[chosen[corners] < most]
        if not len(corners):
            return Decimals(chosen, inner)
        chosen[corners] += 1


def round_each(places: NDArray[np.float64], decimals: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return places (..., 2), each rounded to its own number of decimals (...)."""
    scale = 10.0 ** decimals[..., None]
    rounded: NDArray[np.float64] = np.rint(places * scale) / scale
    return rounded


def orientation(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 if the first three corners are counter-clockwise, -1 if clockwise, else 0."""
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, k] - corners[:, 0], 1, 0) for k in (1, 2))
    turn: NDArray[np.float64] = np.sign(ax * by - ay * bx)
    return turn


def short_way(corners: NDArray[Any]) -> NDArray[Any]:
    """Move the longitudes of (T, 3, 2) to within 180 degrees of the first corner, in place."""
    lon = corners[..., 0]
    lon -= whole_turns(lon - lon[:, :1])
    return corners
