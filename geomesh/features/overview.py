"""Overview of a scene: its pixels, decimated to at most 1024 per side, for global statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import EmptyError, SourceError
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.raster.grid import Window

if TYPE_CHECKING:
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.pixels import Pixels
    from geomesh.raster.scene import Scene

_SIZE = 1024

# Side of the block that one read decimates, in pixels. It gives enough tasks for a few workers,
# and few reads if the file has overviews.
_BLOCK = 2048

# A million tiles. No raster is known that has more pixels, but a wrong header can claim any size.
_MOST_PIXELS = 2**40


def read_overview(scene: Scene, workers: Workers, progress: Progress) -> Pixels:
    """Return the bands (B, h, w) and the valid pixels (h, w) of every n-th pixel of a scene.

    n is the smallest step for which no side is longer than 1024 pixels. If none of these
    pixels is valid, return the first tile that contains a valid pixel.

    Raises
    ------
    EmptyError
        If no pixel of the scene is valid.
    SourceError
        If the scene has more than 2**40 pixels.
    """
    extent = scene.grid.extent
    if extent.width * extent.height > _MOST_PIXELS:
        raise SourceError(
            f"{scene.name} has {extent.width} x {extent.height} pixels, more than one mesh can "
            "have; choose a part with `bounds`, or correct the size in its header"
        )
    step = -(-max(extent.width, extent.height) // _SIZE)
    # Use whole steps only, so that all blocks are decimated to one common lattice.
    shown = Window(0, 0, _whole(extent.width, step), _whole(extent.height, step))
    tiles = plan_tiles(shown, core=step * max(_BLOCK // step, 1), halo=0)
    shape = _steps(shown.height, step), _steps(shown.width, step)
    bands = np.empty((len(scene.bands), *shape), scene.dtype)
    valid = np.empty(shape, np.bool_)
    tasks = [(scene.excerpt(tile.core), tile) for tile in tiles]
    parts = map_tiles(
        _Decimate(step),
        tasks,
        len(tasks),
        workers,
        progress=progress,
        message="Looking at the scene",
    )
    for tile, (block, known) in zip(tiles, parts, strict=True):
        row, col = tile.core.row // step, tile.core.col // step
        part = slice(row, row + known.shape[0]), slice(col, col + known.shape[1])
        bands[:, *part], valid[part] = block, known
    if valid.any():
        return bands, valid
    for tile in plan_tiles(extent) if step > 1 else []:
        bands, valid = scene.read(tile.core)
        if valid.any():
            return bands, valid
    raise EmptyError(
        f"{scene.name} has no valid pixel here: all are nodata, masked, not finite or outside "
        "`mask`; choose other bands or another area, or override the nodata value with `nodata`"
    )


@dataclass(frozen=True)
class _Decimate:
    """Read one pixel of each block of `step` x `step` pixels."""

    step: int

    def __call__(self, task: tuple[Scene, Tile]) -> Pixels:
        scene, tile = task
        shape = _steps(tile.core.height, self.step), _steps(tile.core.width, self.step)
        return scene.read(tile.core, shape if self.step > 1 else None)


def _whole(size: int, step: int) -> int:
    """Return the largest multiple of `step` up to `size`; or `size`, if it is less than `step`."""
    return size // step * step or size


def _steps(size: int, step: int) -> int:
    return max(size // step, 1)
