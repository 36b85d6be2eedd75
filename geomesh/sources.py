"""Any kind of source becomes a Scene: a path, an open dataset, or an array."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike, fspath
from typing import Any, TypeAlias

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.io import BufferedDatasetWriter, DatasetReader, DatasetWriter
from rasterio.vrt import WarpedVRT

from geomesh.bands import array_bands, dataset_bands
from geomesh.errors import BandError, GeoreferenceError, SourceError, one_line
from geomesh.extent import restrict
from geomesh.georeference import NO_CRS, georeference
from geomesh.grid import IDENTITY, Grid
from geomesh.handles import Borrowed, open_raster
from geomesh.raster import Excerpt, Scene

_DATASETS = (DatasetReader, DatasetWriter, BufferedDatasetWriter, WarpedVRT)

ArraySource = tuple[Any, Affine, Any]
Source: TypeAlias = "str | PathLike[str] | rasterio.DatasetReader | ArraySource"


def open_scene(
    source: Source,
    *,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    crs: Any = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    name: str | None = None,
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
    crs : str, int or pyproj.CRS, optional
        Takes the place of the file's own coordinate system; nothing is reprojected.
    bounds : (west, south, east, north), optional
        Box in map coordinates to crop to. Rows and columns that it touches are kept
        whole; on a turned grid, pixels with their centre in it.
    mask : path, GeoDataFrame or GeoSeries, optional
        Area of interest: polygons, reprojected to the raster's CRS if need be.
    name : str, optional
        What messages and metadata call the source, if not by its path.

    Raises
    ------
    SourceError, BandError, GeoreferenceError, EmptyError
    """
    if bidx is not None and not (
        isinstance(bidx, Sequence) and all(isinstance(index, int) for index in bidx)
    ):
        raise BandError(f"bidx is {bidx!r}: give a list of band numbers such as [3, 2, 1]")
    given = None if crs is None else _parse_crs("the CRS given,", crs)
    if isinstance(source, tuple) and len(source) == 3:
        scene = _array_scene(source, bidx, given)
    elif isinstance(source, _DATASETS):
        if source.closed:
            raise SourceError(f"{source.name} is closed; give the dataset open, or its path")
        scene = _dataset_scene(name or source.name, Borrowed(source), source, bidx, given)
    elif isinstance(source, str | PathLike):
        path = fspath(source)
        with open_raster(path) as dataset:
            # Workers elsewhere may work in another folder.
            place = os.path.abspath(path) if os.path.exists(path) else path  # noqa: PTH100, PTH110
            scene = _dataset_scene(name or path, place, dataset, bidx, given)
    else:
        raise SourceError(
            f"a {type(source).__name__} is no source: give a path, an open rasterio dataset or "
            "(array, transform, crs)"
        )
    scene = replace(scene, nodata=None if nodata is None else float(nodata))
    if bounds is not None or mask is not None:
        scene = restrict(scene, bounds=bounds, mask=mask)
    return scene


def _parse_crs(whose: str, crs: Any) -> CRS:
    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{whose} {crs!r} is unknown ({one_line(error)}); give a code such as EPSG:32722"
        ) from error


def _array_scene(source: ArraySource, bidx: Sequence[int] | None, given: CRS | None) -> Scene:
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
    placed = given
    if placed is None and crs is not None:
        placed = _parse_crs("the array's CRS", crs)
    if not isinstance(transform, Affine | None):
        raise GeoreferenceError(
            f"the array's transform {transform!r} is no affine.Affine; GDAL's order of the numbers "
            "is another one: use Affine.from_gdal"
        )
    grid = Grid(width, height, transform or IDENTITY, placed)
    notes = () if grid.crs else (NO_CRS.format("the array"),)
    held = Excerpt(array, grid.extent)
    size = (width, height)
    return Scene("array", grid, grid.extent, bands, array.dtype, held, size, notes=notes)


def _dataset_scene(
    name: str,
    source: str | Borrowed,
    dataset: rasterio.DatasetReader,
    bidx: Sequence[int] | None,
    given: CRS | None,
) -> Scene:
    if dataset.count == 0:
        raise SourceError(
            f"{name} holds no bands of its own; name one of its subdatasets: "
            f"{', '.join(dataset.subdatasets[:3]) or 'none found'}"
        )
    bands, dtype = dataset_bands(name, dataset, bidx)
    grid, notes = georeference(name, dataset, given)
    size = (dataset.width, dataset.height)
    return Scene(name, grid, grid.extent, bands, dtype, source, size, notes=notes)
