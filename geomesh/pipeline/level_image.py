"""Images of a mesh at the size in which a map shows it: each pixel is a block of the raster's."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from affine import Affine

from geomesh.mesh.colors import parse_colors
from geomesh.mesh.topology import FILL
from geomesh.parallel.tiles import Tile
from geomesh.raster.grid import Grid, Window
from geomesh.zonal.owners import find_owners
from geomesh.zonal.tile_mesh import split_by_tiles

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress

# Of the values that are shown as gray, these percentiles are black and white.
_GRAY_RANGE = (2, 98)

# Pixels that are painted at once.
_STRIP = 4_000_000


@dataclass(frozen=True, eq=False)
class LevelImage:
    """A mesh in the colours of its triangles, seen from far away.

    Attributes
    ----------
    bands : uint8 (3, h, w), or (1, h, w) if the mesh has no colours
    inside : bool (h, w)
        Which blocks the mesh covers, wholly or in part.
    raster : Grid
        The grid of the mesh, which the blocks divide evenly.
    margin : int
        Blocks that were added on each side of the raster.
    """

    bands: NDArray[np.uint8]
    inside: NDArray[np.bool_]
    raster: Grid
    margin: int = 0

    @property
    def block(self) -> tuple[float, float]:
        """Width and height of a block in pixels of the raster."""
        height, width = (side - 2 * self.margin for side in self.inside.shape)
        return self.raster.width / width, self.raster.height / height

    @property
    def grid(self) -> Grid:
        """The grid of the blocks."""
        height, width = self.inside.shape
        across, down = self.block
        a, b, _, d, e, _ = self.raster.transform[:6]
        corner = self.raster.to_map([(-self.margin * across, -self.margin * down)])
        x, y = map(float, corner[0])
        scaled = Affine(a * across, b * down, x, d * across, e * down, y)
        return Grid(width, height, scaled, self.raster.crs)

    def to_raster(self, points: Points) -> Points:
        """Convert coordinates in blocks (N, 2) to pixels of the raster."""
        return (points - self.margin) * self.block

    def halved(self) -> LevelImage:
        """Return the image with half as many blocks along each side."""
        rows, cols = (_starts(side, -(-side // 2)) for side in self.inside.shape)
        weights = _pooled(self.inside, rows, cols)
        sums = np.stack([_pooled(np.where(self.inside, b, 0), rows, cols) for b in self.bands])
        return LevelImage(_means(sums, weights), weights > 0, self.raster)

    def widened(self) -> LevelImage:
        """Return the image with one more block around what the mesh covers.

        The outline of a mesh may cut off up to half a block. So it cuts nothing that is inside.
        An image without blocks outside stays as it is, because its outline is exact.
        """
        if self.inside.all():
            return self
        inside = np.pad(self.inside, 1)
        bands = np.pad(self.bands, ((0, 0), (1, 1), (1, 1)))
        near = cv2.blur(inside.astype(np.float32), (3, 3), borderType=cv2.BORDER_CONSTANT)
        wide = near > 0
        for band in bands:
            known = np.where(inside, band, 0).astype(np.float32)
            around = cv2.blur(known, (3, 3), borderType=cv2.BORDER_CONSTANT)
            added = wide & ~inside
            band[added] = np.rint(around[added] / near[added])
        return LevelImage(bands, wide, self.raster, self.margin + 1)


def paint_image(mesh: TriangleMesh, factor: int, progress: Progress) -> LevelImage:
    """Return the image of a mesh with blocks of about `factor` pixels. It is painted in strips."""
    colors, grid = _levels(mesh), mesh.grid
    height, width = (-(-side // factor) for side in (grid.height, grid.width))
    bands = np.zeros((colors.shape[1], height, width), np.uint8)
    inside = np.zeros((height, width), bool)
    rows, cols = _starts(grid.height, height), _starts(grid.width, width)
    step = max(_STRIP // (grid.width * factor), 1)
    firsts = list(range(0, height, step))
    borders = [*rows[firsts].tolist(), grid.height]
    cores = [Window(0, top, grid.width, stop - top) for top, stop in pairwise(borders)]
    tiles = [Tile(core, core) for core in cores]
    parts = split_by_tiles(mesh.nodes, mesh.triangles, tiles)
    for done, (first, core, part) in enumerate(zip(firsts, cores, parts, strict=True), start=1):
        owners = find_owners(part.nodes, part.triangles, core)
        place = np.s_[first : first + step]
        weights = _pooled(owners != FILL, rows[place] - core.row, cols)
        # A pixel without an owner has the id FILL, which is -1: it gets the last row, 0.
        own = np.vstack([colors[part.triangle_ids], np.zeros((1, colors.shape[1]), np.uint8)])
        sums = [_pooled(own[:, k][owners], rows[place] - core.row, cols) for k in range(len(bands))]
        bands[:, place], inside[place] = _means(np.stack(sums), weights), weights > 0
        progress(done / len(tiles), "Painting")
    return LevelImage(bands, inside, grid)


def _levels(mesh: TriangleMesh) -> NDArray[np.uint8]:
    """Return the colours of triangles (T, 3), or the gray (T, 1) of the first band's means."""
    table = mesh.triangle_table
    if "color" in table:
        return parse_colors(table["color"])
    means = [values for name, values in table.items() if name.endswith("_mean")]
    known = means[0][np.isfinite(means[0])] if means else np.empty(0)
    if not len(known):
        return np.zeros((len(mesh.triangles), 1), np.uint8)
    low, high = np.percentile(known, _GRAY_RANGE)
    gray = (np.nan_to_num(means[0], nan=low) - low) / max(high - low, np.finfo(float).tiny)
    levels: NDArray[np.uint8] = np.rint(gray.clip(0, 1) * 255).astype(np.uint8)[:, None]
    return levels


def _starts(pixels: int, blocks: int) -> NDArray[np.intp]:
    """Return the first pixel of each of `blocks` blocks, which divide `pixels` evenly."""
    # The centre of a pixel decides to which block it belongs.
    return np.searchsorted((np.arange(pixels) + 0.5) * blocks / pixels, np.arange(blocks))


def _pooled(
    values: NDArray[Any], rows: NDArray[np.intp], cols: NDArray[np.intp]
) -> NDArray[np.uint32]:
    """Return the sums of values (h, w) in blocks that start at the given rows and columns."""
    strips = np.add.reduceat(values, rows, axis=0, dtype=np.uint32)
    sums: NDArray[np.uint32] = np.add.reduceat(strips, cols, axis=1)
    return sums


def _means(sums: NDArray[np.uint32], weights: NDArray[np.uint32]) -> NDArray[np.uint8]:
    return np.rint(sums / np.maximum(weights, 1)).astype(np.uint8)
