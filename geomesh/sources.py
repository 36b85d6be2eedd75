"""Any kind of source becomes a Scene: a path, an open dataset, or an array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike, fspath
from typing import Any, TypeAlias

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS

from geomesh.bands import array_bands, dataset_bands
from geomesh.errors import SourceError
from geomesh.extent import restrict
from geomesh.georeference import NO_CRS, georeference
from geomesh.grid import IDENTITY, Grid
from geomesh.raster import Scene, open_dataset

ArraySource = tuple[Any, Affine, Any]
Source: TypeAlias = "str | PathLike[str] | rasterio.DatasetReader | ArraySource"


def open_scene(
    source: Source,
    *,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
) -> Scene:
    """Look at a source and return the Scene to work on.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, or (array, transform, crs)
        An array is (H, W) or (B, H, W); masked arrays keep their mask.
    bidx : sequence of int, optional
        1-based bands; all but alpha by default.
    nodata : float, optional
        Takes the place of the file's own nodata value.
    bounds : (west, south, east, north), optional
        Box in map coordinates to crop to.
    mask : path, GeoDataFrame or GeoSeries, optional
        Area of interest: polygons, reprojected to the raster's CRS if need be.

    Raises
    ------
    SourceError, BandError, GeoreferenceError, EmptyError
    """
    if isinstance(source, tuple):
        scene = _array_scene(source, bidx)
    elif isinstance(source, rasterio.DatasetReader | rasterio.vrt.WarpedVRT):
        scene = _dataset_scene(source.name, source, source, bidx)
    else:
        name = fspath(source)
        with open_dataset(name) as dataset:
            scene = _dataset_scene(name, name, dataset, bidx)
    scene = replace(scene, nodata=nodata)
    if bounds is not None or mask is not None:
        scene = restrict(scene, bounds=bounds, mask=mask)
    return scene


def _array_scene(source: ArraySource, bidx: Sequence[int] | None) -> Scene:
    array, transform, crs = source
    array = np.ma.asarray(array) if np.ma.isMaskedArray(array) else np.asarray(array)
    array = array[None] if array.ndim == 2 else array
    if array.ndim != 3 or 0 in array.shape:
        raise SourceError(
            f"an array of shape {array.shape} is no raster: expected (rows, columns) or "
            "(bands, rows, columns), none of them 0"
        )
    count, height, width = array.shape
    bands = array_bands("the array", array.dtype, count, bidx)
    grid = Grid(width, height, transform or IDENTITY, CRS.from_user_input(crs) if crs else None)
    notes = () if grid.crs else (NO_CRS.format("the array"),)
    return Scene("array", grid, grid.extent, bands, array.dtype, (array,), notes=notes)


def _dataset_scene(
    name: str, source: Any, dataset: rasterio.DatasetReader, bidx: Sequence[int] | None
) -> Scene:
    if dataset.count == 0:
        raise SourceError(
            f"{name} holds no bands of its own; name one of its subdatasets: "
            f"{', '.join(dataset.subdatasets[:3]) or 'none found'}"
        )
    bands, dtype = dataset_bands(name, dataset, bidx)
    grid, notes = georeference(name, dataset)
    return Scene(name, grid, grid.extent, bands, dtype, source, notes=notes)
