"""Read the tiles of a map again: every triangle must be there, and no gap between them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.formats.mercator import EXTENT, TILE_PIXELS, metres_to_world, tile_ids, to_world
from geomesh.formats.tile_layer import Rings
from geomesh.raster.grid import Window
from geomesh.zonal.rings import fill_rings

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Points
    from geomesh.formats.pmtiles import Archive
    from geomesh.formats.tile_layer import TileLayer

# Tiles along a side of a block, whose pixels are in memory at the same time.
_BLOCK = 8

# The outline itself is rounded to steps: pixels whose centre is nearer to it are not gaps.
_STEP = TILE_PIXELS / EXTENT
_SHIFTS = ((-_STEP, -_STEP), (-_STEP, _STEP), (_STEP, -_STEP), (_STEP, _STEP))

# More uncovered pixels than this in a block are no matter of the outline.
_MOST_LOOKED_AT = 1000


@dataclass(frozen=True)
class LevelCheck:
    """What the tiles of a zoom show.

    Attributes
    ----------
    tiles : int
        Number of tiles.
    largest : int
        Bytes of the largest tile, compressed.
    pieces : int
        Number of features: a triangle in several tiles has a piece in each.
    shown : int
        Number of triangles that are in a tile.
    missing : int
        Number of triangles that are in no tile, though they have an area there.
    pixels, gap_pixels : int
        Pixels of the map inside the mesh, and those of them that no triangle covers.
    """

    tiles: int
    largest: int
    pieces: int
    shown: int
    missing: int
    pixels: int
    gap_pixels: int


def check_level(
    archive: Archive, zoom: int, layer: TileLayer, outline: Sequence[Rings]
) -> LevelCheck:
    """Compare the tiles of a zoom with the triangles that were written, and with the mesh.

    Parameters
    ----------
    archive : Archive
    zoom : int
    layer : TileLayer
        The triangles of this zoom.
    outline : sequence of Rings
        The triangles of the mesh itself, in the unit square: what a map should cover.
    """
    side = TILE_PIXELS << zoom
    reader = _Tiles(archive, zoom, len(layer))
    pixels = gaps = 0
    for block, inside in _blocks(outline, zoom):
        covered = np.zeros(block.shape, np.uint8)
        for x, y in reader.within(block):
            window = Window(x * TILE_PIXELS, y * TILE_PIXELS, TILE_PIXELS, TILE_PIXELS)
            rings = reader.rings(x, y)
            # A tile shows only what lies within it, not its margin.
            shown = np.zeros(window.shape, np.uint8)
            fill_rings(rings.points * side, rings.starts, window, shown)
            covered[window.slices(block)] = shown
        seen = np.zeros(block.shape, np.uint8)
        _fill(inside, side, block, seen)
        pixels += int(np.count_nonzero(seen))
        gaps += _gaps(inside, side, block, (seen == 1) & (covered == 0))
    missing = _missing(layer, np.flatnonzero(~reader.seen), EXTENT << zoom)
    return LevelCheck(
        tiles=len(reader.places),
        largest=reader.largest,
        pieces=reader.pieces,
        shown=int(np.count_nonzero(reader.seen)),
        missing=missing,
        pixels=pixels,
        gap_pixels=gaps,
    )


class _Tiles:
    """The tiles of one zoom, read by GDAL, and what they hold in all."""

    def __init__(self, archive: Archive, zoom: int, triangles: int) -> None:
        self._archive = archive
        self._zoom = zoom
        self.seen = np.zeros(triangles, bool)
        self.pieces = self.largest = 0
        start, stop = (4**zoom - 1) // 3, (4 ** (zoom + 1) - 1) // 3
        ids = archive.directory.ids
        here = np.flatnonzero((ids >= start) & (ids < stop))
        self.places = {int(ids[k]): int(k) for k in here}

    def within(self, block: Window) -> list[tuple[int, int]]:
        """Return column and row of the tiles in a block of pixels."""
        col, row = block.col // TILE_PIXELS, block.row // TILE_PIXELS
        y, x = np.mgrid[
            row : row + block.height // TILE_PIXELS, col : col + block.width // TILE_PIXELS
        ]
        x, y = x.ravel(), y.ravel()
        ids = tile_ids(self._zoom, x, y).tolist()
        here = [number in self.places for number in ids]
        return list(zip(x[here].tolist(), y[here].tolist(), strict=True))

    def rings(self, x: int, y: int) -> Rings:
        """Return the outlines of all features of a tile, in the unit square."""
        import pyogrio

        number = int(tile_ids(self._zoom, np.array([x]), np.array([y]))[0])
        data = self._archive.tile(self.places[number])
        _, table = pyogrio.read_arrow(data, X=x, Y=y, Z=self._zoom, CLIP="NO", columns=["id"])
        self.largest = max(self.largest, len(data))
        self.pieces += table.num_rows
        self.seen[table["id"].to_numpy()] = True
        return Rings.of(shapely.from_wkb(table.column(-1).to_numpy()), metres_to_world)


def _blocks(outline: Sequence[Rings], zoom: int) -> Iterator[tuple[Window, list[Rings]]]:
    """Yield blocks of whole tiles with the rings that touch them, where there are any."""
    boxes = [_boxes(rings) for rings in outline]
    low = np.min([box[:, :2].min(axis=0) for box in boxes], axis=0)
    high = np.max([box[:, 2:].max(axis=0) for box in boxes], axis=0)
    count = 1 << zoom
    first = np.floor(low * count).astype(int).clip(0, count - 1)
    last = np.floor(high * count).astype(int).clip(0, count - 1)
    for row in range(first[1], last[1] + 1, _BLOCK):
        for col in range(first[0], last[0] + 1, _BLOCK):
            stop = np.minimum((col + _BLOCK, row + _BLOCK), last + 1)
            width, height = stop - (col, row)
            west, south = np.array((col, row)) / count
            east, north = stop / count
            met = []
            for rings, box in zip(outline, boxes, strict=True):
                here = (box[:, 0] <= east) & (box[:, 2] >= west)
                here &= (box[:, 1] <= north) & (box[:, 3] >= south)
                if here.any():
                    met.append(_chosen(rings, np.flatnonzero(here)))
            if met:
                size = TILE_PIXELS
                yield Window(col * size, row * size, int(width) * size, int(height) * size), met


def _boxes(rings: Rings) -> NDArray[np.float64]:
    starts = rings.starts[:-1]
    if not len(starts):
        return np.empty((0, 4))
    low = np.minimum.reduceat(rings.points, starts)
    return np.hstack([low, np.maximum.reduceat(rings.points, starts)])


def _chosen(rings: Rings, which: NDArray[np.intp]) -> Rings:
    sizes = np.diff(rings.starts)[which]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    step = np.arange(starts[-1]) - np.repeat(starts[:-1], sizes)
    points = rings.points[np.repeat(rings.starts[which], sizes) + step]
    return Rings(points, starts.astype(np.int64), rings.rows[which])


def _gaps(inside: Sequence[Rings], side: int, block: Window, uncovered: NDArray[np.bool_]) -> int:
    """Return how many uncovered pixels lie inside, farther than a step from the outline."""
    for shift in _SHIFTS if uncovered.any() else ():  # fast, and leaves few
        moved = np.zeros(block.shape, np.uint8)
        _fill(inside, side, block, moved, shift)
        uncovered = uncovered & (moved == 1)
    gaps = int(np.count_nonzero(uncovered))
    if gaps > _MOST_LOOKED_AT:
        return gaps
    boxes = [_boxes(rings) * side for rings in inside] if gaps else []
    gaps = 0
    for row, col in np.argwhere(uncovered).tolist():
        place = np.array([block.col + col + 0.5, block.row + row + 0.5])
        around = []
        for rings, box in zip(inside, boxes, strict=True):
            near = (box[:, :2] <= place + _STEP).all(axis=1)
            near &= (box[:, 2:] >= place - _STEP).all(axis=1)
            some = _chosen(rings, np.flatnonzero(near))
            around += [
                shapely.Polygon(some.points[start:stop] * side)
                for start, stop in pairwise(some.starts.tolist())
            ]
        disc = shapely.Point(place).buffer(_STEP)
        gaps += bool(shapely.union_all(around).covers(disc))
    return gaps


def _fill(
    inside: Sequence[Rings],
    side: int,
    block: Window,
    pixels: NDArray[np.uint8],
    shift: tuple[float, float] = (0.0, 0.0),
) -> None:
    for rings in inside:
        fill_rings(rings.points * side + shift, rings.starts, block, pixels)


def _missing(layer: TileLayer, rows: NDArray[np.intp], steps: int) -> int:
    """Return how many of the given triangles have an area when they are rounded to steps."""
    missing = 0
    for row in rows.tolist():
        wkb = layer.geometry(slice(row, row + 1)).to_numpy(zero_copy_only=False)
        placed: Any = shapely.transform(shapely.from_wkb(wkb), _rounded(steps))
        missing += bool(shapely.area(placed).sum() > 0)
    return missing


def _rounded(steps: int) -> Any:
    def place(points: Points) -> Points:
        rounded: Points = np.floor(to_world(points) * steps + 0.5)
        return rounded

    return place
