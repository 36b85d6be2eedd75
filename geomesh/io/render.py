"""Render a mesh on the pixels of its raster, as a GeoTIFF that is written atomically."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np
import rasterio.windows
from numpy.typing import NDArray

from geomesh.errors import OutputError, SourceError
from geomesh.io.atomic import staged, writing_to
from geomesh.io.geotiff import (
    Style,
    check_geotiff,
    choose_options,
    create_like,
    find_style,
    is_exact,
)
from geomesh.parallel.progress import Progress, part_of, reporting
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.parallel.workers import Workers, open_workers
from geomesh.raster.grid import Window
from geomesh.raster.open import Source, open_scene
from geomesh.surface.fidelity import ErrorSums, Fidelity, sum_errors, summarise
from geomesh.surface.fit import Surface, SurfaceTile, walk
from geomesh.surface.original import open_original
from geomesh.surface.paint import to_pixels
from geomesh.surface.stored import choose, find_surface

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import Alpha, Model
    from geomesh.raster.scene import Scene
    from geomesh.surface.stored import Shown

Sums = tuple[int, int]
Painted = tuple[Window, NDArray[Any], NDArray[np.bool_]]


def render_file(
    mesh: TriangleMesh,
    source: Source,
    path: str | PathLike[str],
    *,
    model: Model | None = None,
    fit: Shown | None = None,
    bidx: Sequence[int] | None = None,
    alpha: Alpha | None = None,
    crs: Any = None,
    creation: Mapping[str, str] | None = None,
    overwrite: bool = False,
    workers: int | None = None,
    progress: bool | Progress = False,
) -> Fidelity:
    """Paint a mesh on the pixels of its raster, as a GeoTIFF, and return its fidelity.

    The file has the grid of the mesh, which is a part of the raster's grid. It has the data
    type, the bands and the band metadata of the raster. Integers are rounded and clipped to
    the limits of the type. Pixels that no triangle owns get the raster's nodata value; if it
    has none, the file has a mask.

    Parameters
    ----------
    mesh : TriangleMesh
    source, model, fit, bidx, alpha, crs, workers, progress
        As in `geomesh.surface.fidelity.measure_fidelity`.
    path : path-like
        Must end in .tif or .tiff.
    creation : mapping of str to str, optional
        Creation options of GDAL's GTiff driver, such as ``{"COMPRESS": "ZSTD"}``. By default
        the file has compressed tiles of 256 x 256 pixels.
    overwrite : bool
        Replace an existing file, as the last step.

    Returns
    -------
    Fidelity
        Measured on the finished file, which is read again.

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do; then an existing file does not
        change.
    """
    target, options = Path(path), choose_options(creation or {})
    check_geotiff(target, overwrite=overwrite)
    scene = open_original(mesh, source, bidx=bidx, alpha=alpha, crs=crs)
    model, fit = choose(mesh, model, fit, bidx)
    share = 0.0 if fit == "stored" else 0.6
    with (
        reporting(progress) as report,
        open_workers(workers) as pool,
        scene.open(),
        staged(target, ".tif", overwrite=overwrite) as temporary,
    ):
        surface = find_surface(
            mesh,
            scene,
            model=model,
            fit=fit,
            bidx=bidx,
            workers=pool,
            progress=part_of(report, 0, share),
        )
        with writing_to(target, "rasterio", way_out="choose other creation options"):
            sums = _write(temporary, options, surface, scene, pool, part_of(report, share, 0.9))
        try:
            shown = open_scene(temporary, name=str(target))
        except SourceError as error:
            raise _damaged(target) from error
        return _read_back(shown, sums, is_exact(options), scene, pool, part_of(report, 0.9, 1))


@dataclass(frozen=True)
class _Painter:
    """Paint a tile; return its window, its pixels and which of them the mesh covers."""

    style: Style

    def __call__(self, task: SurfaceTile) -> Painted:
        _, tile, surface = task
        image = surface.image(tile.core)
        pixels = to_pixels(image, self.style.dtype, self.style.nodata)
        return tile.core, pixels, ~np.isnan(image[0])


def _write(
    path: Path,
    options: Mapping[str, Any],
    surface: Surface,
    scene: Scene,
    workers: Workers,
    progress: Progress,
) -> list[Sums]:
    """Write the image and return the checksums of its tiles."""
    style = find_style(scene)
    sums = []
    with create_like(path, scene, style, options) as dataset:
        painted = walk(_Painter(style), surface, scene, workers, progress, "Painting")
        for _, (core, pixels, known) in painted:
            window = rasterio.windows.Window(core.col, core.row, core.width, core.height)
            dataset.write(pixels, window=window)
            if style.nodata is None:
                dataset.write_mask(known, window=window)
            sums.append(_checksums(pixels, known))
    return sums


def _checksums(pixels: NDArray[Any], known: NDArray[np.bool_]) -> Sums:
    """Return two checksums of a tile: of its pixels, and of the mask of covered pixels."""
    return crc32(pixels.data), crc32(known.data)


def _read_back(
    shown: Scene,
    sums: Sequence[Sums],
    exact: bool,
    scene: Scene,
    workers: Workers,
    progress: Progress,
) -> Fidelity:
    """Check that the file is complete, and compare it with the raster.

    On a full disk, GDAL may lose data when it closes the file, without an error.
    """
    tiles = plan_tiles(scene.grid.extent, halo=0)
    tasks = (
        (shown, expected, exact, scene.excerpt(tile.core), tile)
        for expected, tile in zip(sums, tiles, strict=True)
    )
    with shown.open():
        errors = map_tiles(
            _compare_tile, tasks, len(tiles), workers, progress=progress, message="Comparing"
        )
        return summarise(scene, errors)


def _compare_tile(task: tuple[Scene, Sums, bool, Scene, Tile]) -> ErrorSums:
    shown, expected, exact, scene, tile = task
    try:
        pixels, known = shown.read(tile.core)
    except SourceError as error:
        raise _damaged(shown.name) from error
    found = _checksums(pixels, known)
    if found != expected and (exact or found[1] != expected[1]):
        raise _damaged(shown.name)
    bands, valid = scene.read(tile.core)
    return sum_errors(pixels, bands, valid & known)


def _damaged(target: str | Path) -> OutputError:
    return OutputError(
        f"{target} does not contain what was written to it: free some space, or choose another "
        "folder or other creation options"
    )
