"""Find the pixels near the sides of polygons: only there, neighbours can differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely

from geomesh.arrays.table import blocks

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.raster.aoi.placed import Placed

    Locate = Callable[[Points], Points]

# Sides are cut until the middle of each piece is at most this far from its chord, in pixels,
# and no piece is longer than the second number, unless it jumps.
_BEND = 0.25
LONGEST_PIECE = 64.0

# So often is a side cut in two. What is still long then is a jump, as at the antimeridian.
_LEVELS = 24

# Pieces without a place on the grid are cut further only while there are few of them.
_FEW = 10_000

# A cell of this many pixels around the grid is looked at too.
_MARGIN = 2.0


def near_cells(placed: Placed) -> NDArray[np.int64]:
    """Return the pixels that the sides of placed polygons touch, as numbers in order.

    The pixel in `row` and `col` has the number (row + 1) * (width + 2) + col + 1. There is one
    row and one column more on each side of the grid. A number stands for a pixel that is at
    most one pixel beside the side.
    """
    start, stop = _sides(placed)
    size = np.array([placed.grid.width, placed.grid.height], np.float64)
    found = []
    for turn in placed.turns():

        def locate(xy: Points, turn: float = turn) -> Points:
            return placed.to_pixel(xy, turn)

        straight = placed.transformer is None
        pieces = (locate(start), locate(stop))
        if not straight:
            pieces = follow(start, stop, locate, size)[:2]
        found.append(_cells(*_clip(*pieces, size), size))
    return np.unique(np.concatenate(found)) if found else np.empty(0, np.int64)


def _sides(placed: Placed) -> tuple[Points, Points]:
    """Return the ends (S, 2) and (S, 2) of all sides, in the CRS of the area."""
    rings = shapely.get_rings(shapely.get_parts(placed.area.shape))
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    same = np.diff(ring) == 0
    return xy[:-1][same], xy[1:][same]


def follow(
    start: Points, stop: Points, locate: Locate, size: Floats
) -> tuple[Points, Points, Floats]:
    """Return pieces of sides in pixels, which follow the curves that sides are on the grid.

    Parameters
    ----------
    start, stop : float64 (S, 2)
        The ends of the sides, in the CRS of the area.
    locate : callable
        Converts such coordinates to pixel-edge coordinates; inf if impossible.
    size : float64 (2,)
        Width and height of the grid. Pieces beside it are left out.

    Returns
    -------
    begins, ends : float64 (P, 2)
        In pixel-edge coordinates. A piece that is longer than `LONGESTLONGEST_PIECE` is a jump.
    places : float64 (P,)
        Where each piece begins: the number of its side, and as fraction the share of the side.
    """
    begins, ends, places = [], [], []
    a, b, pa, pb = start, stop, locate(start), locate(stop)
    place = np.arange(len(a), dtype=np.float64)
    for level in range(_LEVELS + 1):
        middle = (a + b) / 2
        pm = locate(middle)
        with np.errstate(invalid="ignore", over="ignore"):
            chord = np.hypot(*(pb - pa).T)
            bend = np.hypot(*(pm - (pa + pb) / 2).T)
            lost = sum((~np.isfinite(p).all(axis=1)).astype(int) for p in (pa, pm, pb))
            reach = _MARGIN + chord + bend
            low = np.minimum(np.minimum(pa, pb), pm) - reach[:, None]
            high = np.maximum(np.maximum(pa, pb), pm) + reach[:, None]
            near = ((high >= 0) & (low <= size)).all(axis=1)
            rough = (bend > _BEND) | (chord > LONGEST_PIECE)
        gone = lost == 3
        cut = (near & rough & (lost == 0)) | ((lost > 0) & ~gone)
        cut |= gone & (np.count_nonzero(gone) < _FEW)
        ready = near & (lost == 0) & ~(cut & (level < _LEVELS))
        begins.append(pa[ready])
        ends.append(pb[ready])
        places.append(place[ready])
        place = np.concatenate([place[cut], place[cut] + 0.5 ** (level + 1)])
        a, b = np.vstack([a[cut], middle[cut]]), np.vstack([middle[cut], b[cut]])
        pa, pb = np.vstack([pa[cut], pm[cut]]), np.vstack([pm[cut], pb[cut]])
        if not len(a):
            break
    return np.vstack(begins), np.vstack(ends), np.concatenate(places)


def _clip(start: Points, stop: Points, size: Floats) -> tuple[Points, Points]:
    """Return the parts of pieces that are on the grid or just outside (Liang and Barsky 1984)."""
    low, high = np.array([-_MARGIN, -_MARGIN]), size + _MARGIN
    beside = ((start < low) & (stop < low) | (start > high) & (stop > high)).any(axis=1)
    start, stop = start[~beside], stop[~beside]
    whole = ((start >= low) & (start <= high) & (stop >= low) & (stop <= high)).all(axis=1)
    a, step = start[~whole], (stop - start)[~whole]
    with np.errstate(divide="ignore", invalid="ignore"):
        # Where a piece runs along an axis, it is between the limits, and any part of it may be.
        level = step == 0
        at = np.where(level, -np.inf, (low - a) / step), np.where(level, np.inf, (high - a) / step)
    first = np.minimum(*at).max(axis=1).clip(0, 1)
    last = np.maximum(*at).min(axis=1).clip(0, 1)
    kept = first <= last
    return (
        np.vstack([start[whole], a[kept] + step[kept] * first[kept, None]]),
        np.vstack([stop[whole], a[kept] + step[kept] * last[kept, None]]),
    )


def _cells(start: Points, stop: Points, size: Floats) -> NDArray[np.int64]:
    """Return the numbers of the pixels under points on the pieces, half a pixel apart."""
    width, height = size.astype(np.int64)
    found = []
    for block in blocks(len(start)):
        a, step = start[block], stop[block] - start[block]
        counts = np.ceil(2 * np.hypot(*step.T)).astype(np.int64) + 1
        piece = np.repeat(np.arange(len(a)), counts)
        place = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
        points = a[piece] + step[piece] * (place / counts[piece])[:, None]
        col, row = np.floor(points).astype(np.int64).T
        inside = (col >= -1) & (col <= width) & (row >= -1) & (row <= height)
        found.append(np.unique((row[inside] + 1) * (width + 2) + col[inside] + 1))
    return np.unique(np.concatenate(found)) if found else np.empty(0, np.int64)
