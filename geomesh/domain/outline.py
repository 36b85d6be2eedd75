"""Trace the outline of the valid data from the pixel corners where it turns.

The outline runs along pixel borders between valid and invalid pixels. Each tile finds its own
turns, so the mask of the whole scene is never in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, int64, kernel, reads, writes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.parallel.tiles import Tile
    from geomesh.raster.grid import Window

# The kind of a corner: which of its four pixels are valid, as a sum of these numbers.
_UPPER_LEFT, _UPPER_RIGHT, _LOWER_LEFT, _LOWER_RIGHT = 1, 2, 4, 8
# With one or three valid pixels the outline turns. With two diagonal ones two outlines turn.
_TURNS = np.isin(np.arange(16), [1, 2, 4, 8, 7, 11, 13, 14])
_SADDLES = {
    _UPPER_LEFT | _LOWER_RIGHT: (_UPPER_LEFT, _LOWER_RIGHT),
    _UPPER_RIGHT | _LOWER_LEFT: (_UPPER_RIGHT, _LOWER_LEFT),
}
# The directions of the two sides of a turn, and on which side of the horizontal one the data are.
_GOES_RIGHT = np.isin(np.arange(16), [2, 8, 7, 13])
_GOES_DOWN = np.isin(np.arange(16), [4, 8, 7, 11])
_DATA_BELOW = np.isin(np.arange(16), [4, 8, 13, 14])


@dataclass(frozen=True, eq=False)
class Turns:
    """Corners where the outline turns.

    Attributes
    ----------
    xy : int64 (n, 2)
        Column and row of the pixel corner.
    kind : uint8 (n,)
        Which of the four pixels around it are valid.
    """

    xy: NDArray[np.int64]
    kind: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of the data, on pixel corners.

    Attributes
    ----------
    xy : int64 (n, 2)
        The turns of all loops, one loop after the other. Where x increases along the loop,
        the data are on the side of larger y. So outer loops have positive shoelace areas.
    starts : int64 (m + 1,)
        Index in `xy` where each loop begins; the last entry is n.
    pinned : bool (n,)
        Corners where two outlines touch. They are kept when the outline is simplified.
    """

    xy: NDArray[np.int64]
    starts: NDArray[np.int64]
    pinned: NDArray[np.bool_]

    def areas(self) -> NDArray[np.int64]:
        """Return the signed area of each loop in pixels: positive around data, else negative."""
        following = np.arange(1, len(self.xy) + 1)
        following[self.starts[1:] - 1] = self.starts[:-1]
        x, y = self.xy.T
        cross = x * y[following] - x[following] * y
        return np.add.reduceat(cross, self.starts[:-1]) // 2 if len(cross) else cross


def find_turns(valid: NDArray[np.bool_], tile: Tile, extent: Window) -> Turns:
    """Return the turns of the outline that belong to a tile.

    Parameters
    ----------
    valid : bool (h, w)
        Validity of the pixels of `tile.read`.
    tile : Tile
        To it belong the upper left corners of the pixels of its core, and the corners on the
        right and lower border of the image if the core touches it.
    extent : Window
        The whole image. Outside of it all pixels are invalid.
    """
    core = tile.core
    ring = core.pad(1)
    if ring.clip(tile.read) == ring and valid[ring.slices(tile.read)].all():
        return Turns(np.empty((0, 2), np.int64), np.empty(0, np.uint8))
    padded = np.zeros(ring.shape, np.uint8)
    known = ring.clip(tile.read)
    padded[known.slices(ring)] = valid[known.slices(tile.read)]
    kind = padded[:-1, :-1] * np.uint8(_UPPER_LEFT) + padded[:-1, 1:] * np.uint8(_UPPER_RIGHT)
    kind += padded[1:, :-1] * np.uint8(_LOWER_LEFT) + padded[1:, 1:] * np.uint8(_LOWER_RIGHT)
    rows = core.height + (core.stop_row == extent.stop_row)
    cols = core.width + (core.stop_col == extent.stop_col)
    kind = kind[:rows, :cols]
    row, col = np.nonzero(_TURNS[kind])
    xy, kinds = [np.column_stack([col, row])], [kind[row, col]]
    for saddle, pair in _SADDLES.items():
        row, col = np.nonzero(kind == saddle)
        for single in pair:
            xy.append(np.column_stack([col, row]))
            kinds.append(np.full(len(row), single, np.uint8))
    corner = np.array([core.col, core.row])
    return Turns(np.concatenate(xy).astype(np.int64) + corner, np.concatenate(kinds))


class Dropped(NamedTuple):
    """What was dropped.

    Attributes
    ----------
    islands, holes : int
        Number of islands of data and of holes.
    pixels : int
        Pixels of the islands minus pixels of the holes.
    """

    islands: int
    holes: int
    pixels: int


def trace(parts: Sequence[Turns]) -> Outline:
    """Join turns into closed loops.

    Along each grid line, sides of the outline begin and end at alternate turns. So pairs of
    consecutive turns are joined, first along rows, then along columns. A loop follows these
    two kinds of joints alternately. Diagonal pixels are not joined (4-connected data).
    """
    xy = np.concatenate([part.xy for part in parts])
    kind = np.concatenate([part.kind for part in parts])
    order = np.lexsort((kind, xy[:, 0], xy[:, 1]))
    xy, kind = xy[order], kind[order]
    x, y = xy.T
    # If two turns share a corner, the turn where a side ends comes before the turn where the next
    # side begins.
    along_row = np.lexsort((_GOES_RIGHT[kind], x, y))
    along_column = np.lexsort((_GOES_DOWN[kind], y, x))
    count = len(kind)
    visits, starts = np.empty(count, np.int64), np.empty(count // 2 + 1, np.int64)
    partners = _partners(along_row), _partners(along_column)
    starts = starts[: _follow(*partners, np.zeros(count, np.bool_), visits, starts) + 1]
    loops = [visits[a:b] for a, b in pairwise(starts)]
    # Each loop begins along a row. Reverse it if the data are on the wrong side.
    loops = [
        loop if _GOES_RIGHT[kind[loop[0]]] == _DATA_BELOW[kind[loop[0]]] else loop[::-1]
        for loop in loops
    ]
    turns = np.concatenate(loops) if loops else np.empty(0, np.int64)
    same = np.zeros(len(xy), np.bool_)
    repeated = (np.diff(xy, axis=0) == 0).all(axis=1)
    same[1:] |= repeated
    same[:-1] |= repeated
    return Outline(xy[turns], starts, same[turns])


def _partners(order: NDArray[np.intp]) -> NDArray[np.int64]:
    partner = np.empty(len(order), np.int64)
    partner[order[0::2]] = order[1::2]
    partner[order[1::2]] = order[0::2]
    return partner


@kernel(
    int64(reads(int64, 1), reads(int64, 1), writes(boolean, 1), writes(int64, 1), writes(int64, 1))
)
def _follow(
    along_row: NDArray[np.int64],
    along_column: NDArray[np.int64],
    seen: NDArray[np.bool_],
    visits: NDArray[np.int64],
    starts: NDArray[np.int64],
) -> int:
    """Fill `visits`, the turns of loop after loop, and `starts`; return the number of loops."""
    filled, loops = 0, 0
    for first in range(len(along_row)):
        if seen[first]:
            continue
        starts[loops] = filled
        loops += 1
        here = first
        while not seen[here]:
            there = along_row[here]
            visits[filled], visits[filled + 1] = here, there
            seen[here] = seen[there] = True
            filled += 2
            here = along_column[there]
    starts[loops] = filled
    return loops


def drop_small_loops(outline: Outline, min_hole: int) -> tuple[Outline, Dropped]:
    """Return the outline without loops of fewer than `min_hole` pixels.

    A loop inside a dropped loop is even smaller, so it is dropped too. If all loops are
    smaller, the largest one is kept, because a mesh needs one.
    """
    areas = outline.areas()
    kept = np.abs(areas) >= min_hole
    if len(areas) and not kept.any():
        kept[areas.argmax()] = True
    sizes = np.diff(outline.starts)
    rows = np.repeat(kept, sizes)
    starts = np.concatenate([[0], np.cumsum(sizes[kept])])
    dropped = Dropped(
        islands=int(np.count_nonzero(~kept & (areas > 0))),
        holes=int(np.count_nonzero(~kept & (areas < 0))),
        pixels=int(areas[~kept].sum()),
    )
    return Outline(outline.xy[rows], starts, outline.pinned[rows]), dropped
