"""The domain of a mesh as loops: simplify the outline, and add nodes along it."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, float64, int64, kernel, reads, void, writes
from geomesh.mesh.certificate import DomainFacts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from scipy.spatial import cKDTree

    from geomesh.domain.outline import Outline
    from geomesh.raster.grid import Window

# Smallest distance of a segment of the simplified outline to a pixel centre, in pixels.
# Rounding the nodes to the lattice moves a segment by less than this.
_CLEARANCE = 1 / 128

# Largest number of stations that one line passes. Along an exactly diagonal border a line could
# pass them all. The limit keeps the time proportional to the length of the outline.
_FARTHEST_VIEW = 2000


def simplify(outline: Outline, extent: Window) -> list[NDArray[np.float64]]:
    """Return the loops with the fewest corners that keep every pixel centre on its side.

    At every pixel border that it follows, the outline passes a gate: the gap between the
    centres of the two pixels on either side. A simplified loop passes the same gates in
    straight lines. So it moves by less than a pixel, no pixel changes sides, and loops
    cannot cross. Corners of the loop are corners of the outline, or midpoints of its unit
    steps, because a slanted border runs through these. Corners on the frame of the image
    and corners where outlines touch are kept.

    Parameters
    ----------
    outline : Outline
    extent : Window
        The whole image.

    Returns
    -------
    list of float64 (k, 2)
        Distinct corners of each loop, in pixel-edge coordinates.
    """
    x, y = outline.xy.T
    fixed = np.isin(x, (extent.col, extent.stop_col)) | np.isin(y, (extent.row, extent.stop_row))
    fixed |= outline.pinned
    loops = []
    for start, stop in pairwise(outline.starts):
        loop, stays = outline.xy[start:stop].astype(np.float64), fixed[start:stop]
        # Begin at a corner that is kept; else at the topmost corner, and there the leftmost.
        first = np.flatnonzero(stays)[0] if stays.any() else np.lexsort(loop.T)[0]
        stations = _stations(np.roll(loop, -first, axis=0), np.roll(stays, -first))
        loops.append(stations.xy[_fewest_lines(stations, 0.5 - _CLEARANCE)])
    return loops


class _Stations(NamedTuple):
    """The stations along a loop, in order.

    Attributes
    ----------
    xy : float64 (n, 2)
        A corner of the outline, or the middle of a gate.
    step : float64 (n, 2)
        Unit vector of the direction along the outline.
    may_turn, is_gate, stays : bool (n,)
        Whether the simplified loop may have a corner here, passes a gate here, or
        must have a corner here.
    """

    xy: NDArray[np.float64]
    step: NDArray[np.float64]
    may_turn: NDArray[np.bool_]
    is_gate: NDArray[np.bool_]
    stays: NDArray[np.bool_]


def _stations(loop: NDArray[np.float64], stays: NDArray[np.bool_]) -> _Stations:
    """Return the stations of a loop (k, 2).

    Of the gates of a side, the first and the last are enough: a line through both passes all.
    """
    side = np.roll(loop, -1, axis=0) - loop
    length = np.abs(side).sum(axis=1)
    step = side / length[:, None]
    xy = np.stack([loop, loop + step / 2, loop + side - step / 2], axis=1)
    unit, always = length == 1, np.ones(len(loop), np.bool_)
    used = np.column_stack([always, always, ~unit]).ravel()
    may_turn = np.column_stack([always, unit, ~always]).ravel()
    is_gate = np.column_stack([~always, always, always]).ravel()
    fixed = np.column_stack([stays, ~always, ~always]).ravel()
    along = np.repeat(step, 3, axis=0)
    return _Stations(
        xy.reshape(-1, 2)[used], along[used], may_turn[used], is_gate[used], fixed[used]
    )


def _fewest_lines(stations: _Stations, reach: float) -> NDArray[np.int64]:
    """Return the stations that are corners of the loop with the fewest lines.

    It begins and ends at station 0. `reach` is the half width of a gate.
    """
    count = len(stations.xy)
    lines = np.full(count + 1, count + 1, np.int64)
    lines[0] = 0
    came_from = np.zeros(count + 1, np.int64)
    _find_lines(*stations, reach, lines, came_from)
    turns = [int(came_from[count])]
    while turns[-1] != 0:
        turns.append(int(came_from[turns[-1]]))
    return np.array(turns[::-1], np.int64)


@kernel(
    void(
        reads(float64, 2),
        reads(float64, 2),
        reads(boolean, 1),
        reads(boolean, 1),
        reads(boolean, 1),
        float64,
        writes(int64, 1),
        writes(int64, 1),
    )
)
def _find_lines(
    xy: NDArray[np.float64],
    step: NDArray[np.float64],
    may_turn: NDArray[np.bool_],
    is_gate: NDArray[np.bool_],
    stays: NDArray[np.bool_],
    reach: float,
    lines: NDArray[np.int64],
    came_from: NDArray[np.int64],
) -> None:
    """Fill `lines`, the fewest lines to each station, and `came_from`, the previous corner.

    The directions that pass all gates so far form a cone from `low` (at the invalid side) to
    `high` (at the valid side).
    """
    count = len(xy)
    for here in range(count):
        if not may_turn[here]:
            continue
        bounded = False
        low_x, low_y, high_x, high_y = 0.0, 0.0, 0.0, 0.0
        for k in range(here + 1, min(here + _FARTHEST_VIEW, count) + 1):
            i = k % count
            x, y = xy[i, 0] - xy[here, 0], xy[i, 1] - xy[here, 1]
            seen = x * high_y - y * high_x > 0 and x * low_y - y * low_x < 0
            if may_turn[i] and (seen or not bounded) and lines[here] + 1 < lines[k]:
                lines[k] = lines[here] + 1
                came_from[k] = here
            if stays[i]:
                break
            if is_gate[i]:
                # The data are in direction (-step y, step x): along +x they are at +y.
                vx, vy = x - step[i, 1] * reach, y + step[i, 0] * reach
                wx, wy = x + step[i, 1] * reach, y - step[i, 0] * reach
                if not bounded or high_x * vy - high_y * vx < 0:
                    high_x, high_y = vx, vy
                if not bounded or low_x * wy - low_y * wx > 0:
                    low_x, low_y = wx, wy
                bounded = True
                if low_x * high_y - low_y * high_x <= 0:
                    break


def frame(width: int, height: int) -> list[NDArray[np.float64]]:
    """Return the frame of the image as a list of one loop."""
    return [np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float64)]


def describe_domain(kind: str, loops: Sequence[NDArray[np.float64]], **counts: int) -> DomainFacts:
    """Return the facts about the area inside `loops`, before it is triangulated.

    `counts` are other fields of DomainFacts.
    """
    areas = np.array([loop_area(loop) for loop in loops])
    return DomainFacts(
        kind=kind,
        area=float(areas.sum()),
        components=int(np.count_nonzero(areas > 0)),
        holes=int(np.count_nonzero(areas < 0)),
        **counts,
    )


def loop_area(loop: NDArray[np.float64]) -> float:
    """Return the signed area of a loop (k, 2), by the shoelace formula; positive around data."""
    x, y = (loop - loop[0]).T
    return float(x @ np.roll(y, -1) - np.roll(x, -1) @ y) / 2


def subdivide(
    line: NDArray[np.float64], spacing: float, inside: cKDTree, *, closed: bool = True
) -> NDArray[np.float64]:
    """Return a line with added nodes, whose density depends on the other nodes.

    A segment is halved while it is longer than `spacing` and longer than the distance from
    its midpoint to the nearest other node. So neighbouring nodes of the line are about as
    far from each other as from the other nodes, and triangles beside it are well shaped.

    Parameters
    ----------
    line : float64 (k, 2)
    spacing : float
        Segments up to this length are not divided, in pixels.
    inside : cKDTree
        The other nodes of the mesh. If there are none, the line is returned unchanged.
    closed : bool
        Whether a segment joins the last point to the first.
    """
    if inside.n == 0:
        return line
    # The start of each segment as a position along the line: number of the corner + fraction.
    start, length = np.arange(len(line), dtype=np.float64), 1.0
    following = np.roll(line, -1, axis=0)
    places = [start]
    if not closed:
        start = start[:-1]
    while len(start):
        corner = start.astype(np.intp)
        side = following[corner] - line[corner]
        middle = line[corner] + side * (start - corner + length / 2)[:, None]
        size = np.hypot(*side.T) * length
        near, _ = inside.query(middle)
        split = start[size > np.maximum(spacing, near)]
        length /= 2
        places.append(split + length)
        start = np.concatenate([split, split + length])
    place = np.sort(np.concatenate(places))
    corner = place.astype(np.intp)
    share = (place - corner)[:, None]
    points: NDArray[np.float64] = line[corner] + share * (following[corner] - line[corner])
    return points
