"""Images of a mesh at the size in which a map shows it: each pixel is a block of the raster's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from affine import Affine

from geomesh.mesh.colors import parse_colors
from geomesh.mesh.topology import FILL
from geomesh.parallel.tiles import CORE, plan_tiles
from geomesh.raster.grid import Grid
from geomesh.zonal.owners import find_owners
from geomesh.zonal.tile_mesh import split_by_tiles

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress

# Of the values that are shown as gray, these percentiles are black and white.
_GRAY_RANGE = (2, 98)


@dataclass(frozen=True, eq=False)
class LevelImage:
    """A mesh in the colours of its triangles, seen from far away.

    Attributes
    ----------
    bands : uint8 (3, h, w), or (1, h, w) if the mesh has no colours
    inside : bool (h, w)
        Which blocks the mesh covers, wholly or in part.
    factor : int
        Side of a block in pixels of the raster.
    margin : int
        Blocks that were added on each side of the raster.
    """

    bands: NDArray[np.uint8]
    inside: NDArray[np.bool_]
    factor: int
    margin: int = 0

    def grid(self, raster: Grid) -> Grid:
        """Return the grid of the blocks."""
        height, width = self.inside.shape
        a, b, _, d, e, _ = raster.transform[:6]
        edge = -self.margin * self.factor
        x, y = map(float, raster.to_map([(edge, edge)])[0])
        scaled = Affine(a * self.factor, b * self.factor, x, d * self.factor, e * self.factor, y)
        return Grid(width, height, scaled, raster.crs)

    def halved(self) -> LevelImage:
        """Return the image with blocks of twice the side."""
        weights = _blocks(self.inside.astype(np.uint32), 2)
        sums = [_blocks(np.where(self.inside, band, 0), 2) for band in self.bands]
        return _averaged(np.stack(sums), weights, 2 * self.factor)

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
        return LevelImage(bands, wide, self.factor, self.margin + 1)


def paint_image(mesh: TriangleMesh, factor: int, progress: Progress) -> LevelImage:
    """Return the image of a mesh with blocks of `factor` pixels. It is painted tile by tile."""
    colors = _levels(mesh)
    height, width = (-(-side // factor) for side in (mesh.grid.height, mesh.grid.width))
    sums = np.zeros((colors.shape[1], height, width), np.uint8)
    inside = np.zeros((height, width), bool)
    tiles = plan_tiles(mesh.grid.extent, core=-(-CORE // factor) * factor, halo=0)
    parts = split_by_tiles(mesh.nodes, mesh.triangles, tiles)
    for done, (tile, part) in enumerate(zip(tiles, parts, strict=True), start=1):
        owners = find_owners(part.nodes, part.triangles, tile.core)
        known = owners != FILL
        weights = _blocks(known.astype(np.uint32), factor)
        own = np.vstack([colors[part.triangle_ids], np.zeros((1, colors.shape[1]), np.uint8)])
        shown = own[owners]
        block = _averaged(
            np.stack([_blocks(shown[..., k], factor) for k in range(own.shape[1])]), weights, factor
        )
        row, col = tile.core.row // factor, tile.core.col // factor
        place = np.s_[row : row + weights.shape[0], col : col + weights.shape[1]]
        sums[(slice(None), *place)], inside[place] = block.bands, block.inside
        progress(done / len(tiles), "Painting")
    return LevelImage(sums, inside, factor)


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


def _blocks(values: NDArray[np.generic], factor: int) -> NDArray[np.uint32]:
    """Return the sums of blocks of `factor` x `factor` values (h, w). The last may be smaller."""
    height, width = (-(-side // factor) * factor for side in values.shape)
    padded = np.zeros((height, width), np.uint32)
    padded[: values.shape[0], : values.shape[1]] = values
    rows = padded.reshape(height // factor, factor, width).sum(axis=1, dtype=np.uint32)
    sums: NDArray[np.uint32] = rows.reshape(len(rows), -1, factor).sum(axis=2, dtype=np.uint32)
    return sums


def _averaged(sums: NDArray[np.uint32], weights: NDArray[np.uint32], factor: int) -> LevelImage:
    bands = np.rint(sums / np.maximum(weights, 1)).astype(np.uint8)
    return LevelImage(bands, weights > 0, factor)
