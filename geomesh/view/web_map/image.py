"""A raster as a picture of the page, beside the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.warp import Resampling, reproject

from geomesh.errors import BandError, GeoreferenceError, SourceError, one_line
from geomesh.features.gray import Tone, fit_tone
from geomesh.raster.crs import crs_label, same_crs
from geomesh.raster.grid import LATTICE
from geomesh.raster.open import Source, open_scene
from geomesh.recipe import Recipe
from geomesh.surface.original import open_original
from geomesh.view.web_map.codec import pack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid
    from geomesh.raster.scene import Scene

# Longest side of the picture, in pixels: what every browser can show, in 1 to 3 megabytes.
_LONGEST = 4096
_QUALITY = 82


@dataclass(frozen=True, eq=False)
class Image:
    """A picture and its place.

    Parameters
    ----------
    name : str
    encoded : bytes
        WebP, with the opacity of each pixel.
    affine : Affine
        From its width and height, as 0 to 1, to the lattice of the page.
    """

    name: str
    encoded: bytes
    affine: Affine

    def head(self) -> dict[str, Any]:
        """Return everything but the picture as plain JSON values."""
        return {"name": self.name, "type": "image/webp", "affine": list(self.affine[:6])}

    def packed(self) -> str:
        """Return the picture as a block of the page."""
        return pack(self.encoded)


def read_image(mesh: TriangleMesh, source: Source) -> Image:
    """Return a raster as a picture on the plane of a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
    source : path, rasterio dataset, xarray.DataArray, or (array, transform, crs)
        The raster from which the mesh was made, or another one of the same place in any CRS.

    Raises
    ------
    SourceError, BandError
        If the raster cannot be read.
    GeoreferenceError
        If it is not known where it lies on the mesh.
    """
    scene, tone = _open(mesh, source)
    with scene.open():
        step = -(-max(scene.grid.width, scene.grid.height) // _LONGEST)
        shape = -(-scene.grid.height // step), -(-scene.grid.width // step)
        bands, valid = scene.read(scene.grid.extent, shape if step > 1 else None)
    if tone is None:
        tone = fit_tone(bands, valid, Recipe(), rgb=scene.rgb) if valid.any() else None
    height, width = valid.shape
    rgba = np.zeros((height, width, 4), np.uint8)
    if tone is not None:
        rgba[..., :3] = np.moveaxis(tone.display(bands)[list(scene.display)], 0, -1)
    rgba[..., 3] = np.where(valid, 255, 0)
    grid = scene.grid.scaled(width, height)
    if not _same_plane(mesh.grid, grid):
        grid, rgba = _warped(mesh.grid, grid, rgba, scene.name)
    _, encoded = cv2.imencode(
        ".webp", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA), (cv2.IMWRITE_WEBP_QUALITY, _QUALITY)
    )
    to_lattice = Affine.scale(LATTICE) @ ~mesh.grid.transform @ grid.transform
    affine = to_lattice @ Affine.scale(grid.width, grid.height)
    return Image(Path(scene.name).name, encoded.tobytes(), affine)


def _open(mesh: TriangleMesh, source: Source) -> tuple[Scene, Tone | None]:
    """Return the scene, and the colours of the mesh if it was made from this raster."""
    try:
        scene = open_original(mesh, source)
    except (GeoreferenceError, BandError):
        # Another raster: a newer image, or one with smaller pixels.
        scene = open_scene(source)
        if mesh.grid.crs is None or scene.grid.crs is None:
            raise
        return scene, None
    display = None if mesh.provenance is None else mesh.provenance.display
    if display is None or scene.dtype == np.uint8:
        return scene, None
    ranges = dict(zip(display.bands, display.ranges, strict=True))
    known = tuple(ranges.get(band.name, (0.0, 0.0)) for band in scene.bands)
    return scene, Tone((1.0,) * len(known), None, None, known)


def _same_plane(one: Grid, other: Grid) -> bool:
    if one.crs is None or other.crs is None:
        return one.crs is other.crs
    return same_crs(one.crs, other.crs)


def _warped(
    target: Grid, grid: Grid, rgba: NDArray[np.uint8], name: str
) -> tuple[Grid, NDArray[np.uint8]]:
    """Return a picture on the area of a grid in another CRS."""
    step = max(target.width, target.height) / min(_LONGEST, 2 * max(grid.width, grid.height))
    width, height = (max(round(side / step), 1) for side in (target.width, target.height))
    there = target.scaled(width, height)
    warped = np.zeros((4, height, width), np.uint8)
    assert grid.crs is not None
    assert there.crs is not None
    try:
        reproject(
            np.ascontiguousarray(np.moveaxis(rgba, -1, 0)),
            warped,
            src_transform=grid.transform,
            src_crs=grid.crs.to_wkt(),
            dst_transform=there.transform,
            dst_crs=there.crs.to_wkt(),
            resampling=Resampling.bilinear,
        )
    except (RasterioError, ValueError) as error:
        raise GeoreferenceError(
            f"{name} cannot be brought from {crs_label(grid.crs)} to {crs_label(there.crs)} "
            f"({one_line(error)}): use a raster in the CRS of the mesh"
        ) from error
    if not warped[3].any():
        raise SourceError(f"{name} has no pixels where the mesh is: use a raster of its place")
    return there, np.ascontiguousarray(np.moveaxis(warped, 0, -1))
