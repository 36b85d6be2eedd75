"""Burn polygons into the pixels of a raster: a pixel is inside if its centre is.

A side of a polygon is straight in its own CRS, and curved in another one. So the polygons are
not transformed. The centres of pixels are: into the CRS of the polygons. This is right at the
poles and at the antimeridian too, where a transformed polygon would be torn. Only centres near
a side need it one by one. All others have the same answer as their neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import shapely

from geomesh.raster.aoi.placed import Placed
from geomesh.raster.aoi.trace import near_cells
from geomesh.raster.grid import Grid, Window
from geomesh.raster.pixel_mask import PixelMask

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Mask, Points
    from geomesh.raster.aoi.polygons import Polygons

# Side of the blocks that are burnt one after the other, in pixels: a multiple of 8. Squares of
# 4, 16, ... blocks are passed over at once, if they are outside.
_BLOCK = 1024
_LEVELS = 4

# Rows and columns of pixels near a side, as `near_cells` numbers them.
Cells = tuple["NDArray[np.int64]", "NDArray[np.int64]"]

# In a block, a centre in each square of this many pixels is looked up too, in case that the
# answer changes where there is no side.
_CHECK = 64


@dataclass(frozen=True, eq=False)
class Burnt:
    """The pixels whose centres lie in an area.

    Parameters
    ----------
    window : Window
        The smallest window with all of them; of no pixels if there are none.
    mask : PixelMask or None
        None if all pixels of `window` are in the area.
    touched : bool
        Whether a side of a polygon touches the grid.
    """

    window: Window
    mask: PixelMask | None
    touched: bool


def burn(areas: Sequence[Polygons], grid: Grid, name: str) -> Burnt:
    """Return the pixels of a grid whose centres lie in all areas, or on their borders.

    Parameters
    ----------
    areas : sequence of Polygons
    grid : Grid
    name : str
        Name of the raster in messages.

    Raises
    ------
    GeoreferenceError
        If there is no transformation between the CRSs.
    """
    all_placed = [Placed.of(area, grid, name) for area in areas]
    near = np.unique(np.concatenate([near_cells(placed) for placed in all_placed]))
    cells = np.divmod(near, grid.width + 2)
    packed: dict[Window, NDArray[np.uint8]] = {}
    count = 0
    part = grid.extent
    for placed in all_placed:
        part = part.clip(_reach(placed))
    for block in _blocks(part, grid, cells, all_placed):
        found = _burn_block(block, _cells_in(block, cells), all_placed)
        if found.any():
            packed[block] = np.packbits(found, axis=1)
            count += int(np.count_nonzero(found))
    if not packed:
        return Burnt(Window(0, 0, 0, 0), None, touched=len(near) > 0)
    window, mask = _join(packed)
    is_full = count == window.width * window.height
    return Burnt(window, None if is_full else mask, touched=len(near) > 0)


def _blocks(
    part: Window, grid: Grid, cells: Cells, areas: Sequence[Placed], level: int = _LEVELS
) -> Iterator[Window]:
    """Yield the blocks of a part of a grid, without large squares that lie outside the areas."""
    size = _BLOCK * 4**level
    for row in range(part.row // size * size, part.stop_row, size):
        for col in range(part.col // size * size, part.stop_col, size):
            square = Window(col, row, size, size).clip(grid.extent)
            if level == 0:
                yield square
            elif len(_cells_in(square, cells)[0]) or not _is_outside(square, areas):
                yield from _blocks(square.clip(part), grid, cells, areas, level - 1)


def _is_outside(square: Window, areas: Sequence[Placed]) -> bool:
    """Return whether a square that no side touches lies outside the areas."""
    rows, cols = (np.unique(np.linspace(0, n - 1, _CHECK).astype(int)) for n in square.shape)
    row, col = (each.ravel() for each in np.meshgrid(rows, cols, indexing="ij"))
    pixels = row * square.width + col
    centres = _centres(square, pixels)
    # A square where only some pixels have a place in the CRS of an area is looked at closely.
    is_clear = all(area.is_defined(centres) for area in areas)
    return is_clear and not _in_all(centres, areas).any()


def _cells_in(window: Window, cells: Cells) -> Cells:
    """Return the rows and columns of the cells in a window; 1, 1 is its first pixel."""
    rows, cols = cells
    # The first row and the first column of all cells are just outside the grid.
    first, stop = np.searchsorted(rows, [window.row, window.stop_row + 2])
    here = (cols[first:stop] >= window.col) & (cols[first:stop] < window.stop_col + 2)
    return rows[first:stop][here] - window.row, cols[first:stop][here] - window.col


def _reach(placed: Placed) -> Window:
    """Return a window of the grid with all pixels of an area: all, if sides may be curved."""
    if placed.transformer is not None:
        return placed.grid.extent
    corners = shapely.get_coordinates(shapely.box(*placed.area.shape.bounds))
    spots = [placed.to_pixel(corners, turn) for turn in placed.turns()]
    limit = [placed.grid.width, placed.grid.height]
    if not spots or not np.isfinite(spots).all():
        return placed.grid.extent
    around = np.concatenate(spots)
    (left, top), (right, bottom) = (
        np.clip(edge, -1, np.add(limit, 1)).astype(int).tolist()
        for edge in (around.min(axis=0) - 1, around.max(axis=0) + 2)
    )
    return Window(left, top, right - left, bottom - top)


def _burn_block(window: Window, cells: Cells, areas: Sequence[Placed]) -> Mask:
    """Return which pixels of a block are in all areas; `cells` are those of `_cells_in`."""
    height, width = window.shape

    def inside(pixels: NDArray[np.intp]) -> Mask:
        return _in_all(_centres(window, pixels), areas)

    # Where the sides of areas are straight on the grid, there is nothing to check.
    is_straight = all(area.transformer is None for area in areas)
    checked = np.empty(0, np.intp) if is_straight else _sample(window)
    # Where pixels without a place in the CRS of an area begin, there is no side.
    if not all(area.is_defined(_centres(window, checked)) for area in areas):
        return inside(np.arange(height * width)).reshape(height, width)
    if not len(cells[0]):
        found = np.full(height * width, inside(np.zeros(1, np.intp))[0])
    else:
        touched = np.zeros((height + 2, width + 2), np.uint8)
        touched[cells] = 1
        near = cv2.dilate(touched, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
        # Other pixels that share a border, not only a corner, have the same answer.
        far = np.logical_not(near).astype(np.uint8)
        count, regions = cv2.connectedComponents(far, connectivity=4)
        first = np.zeros(count, np.intp)
        first[regions.ravel()[::-1]] = np.arange(height * width)[::-1]
        found = inside(first)[regions.ravel()]
        found[near.ravel()] = inside(np.flatnonzero(near))
    if (inside(checked) != found[checked]).any():
        found = inside(np.arange(height * width))
    return found.reshape(height, width)


def _in_all(points: Points, areas: Sequence[Placed]) -> Mask:
    found: Mask = np.logical_and.reduce([area.contains(points) for area in areas])
    return found


def _centres(window: Window, pixels: NDArray[np.intp]) -> Points:
    """Return the centres of pixels, which are numbered row by row in a window."""
    row, col = np.divmod(pixels, window.width)
    return np.column_stack([window.col + col + 0.5, window.row + row + 0.5])


def _sample(window: Window) -> NDArray[np.intp]:
    """Return the pixels of a window at which it is checked: a lattice, and the outermost."""
    chosen = np.zeros(window.shape, np.bool_)
    chosen[_CHECK // 2 :: _CHECK, _CHECK // 2 :: _CHECK] = True
    chosen[[0, -1]] = True
    chosen[:, [0, -1]] = True
    return np.flatnonzero(chosen)


def _join(packed: Mapping[Window, NDArray[np.uint8]]) -> tuple[Window, PixelMask]:
    """Return the smallest window with the pixels of all blocks, and these as one mask."""
    left, top = min(w.col for w in packed), min(w.row for w in packed)
    width, height = max(w.stop_col for w in packed) - left, max(w.stop_row for w in packed) - top
    bits = np.zeros((height, -(-width // 8)), np.uint8)
    for window, pixels in packed.items():
        row, byte = window.row - top, (window.col - left) // 8
        bits[row : row + window.height, byte : byte + pixels.shape[1]] = pixels
    rows = np.flatnonzero(bits.any(axis=1))
    cols = np.flatnonzero(np.unpackbits(np.bitwise_or.reduce(bits, axis=0)))
    (first_row, last_row), (first_col, last_col) = rows[[0, -1]].tolist(), cols[[0, -1]].tolist()
    inner = Window(
        left + first_col, top + first_row, last_col - first_col + 1, last_row - first_row + 1
    )
    return inner, PixelMask(Window(left, top, width, height), bits).cut(inner)
