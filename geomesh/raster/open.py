"""Open a source as a Scene: a path, an open dataset, an array or a DataArray."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from affine import Affine
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.io import BufferedDatasetWriter, DatasetReader, DatasetWriter
from rasterio.vrt import WarpedVRT

from geomesh.errors import BandError, GeoreferenceError, SourceError, one_line
from geomesh.raster.band_names import BandText
from geomesh.raster.bands import array_bands, class_band, dataset_bands
from geomesh.raster.crop import restrict
from geomesh.raster.dataarray import ArrayRaster, check_shape, is_xarray, read_dataarray
from geomesh.raster.gdal import BorrowedDataset, open_raster
from geomesh.raster.georeference import georeference
from geomesh.raster.grid import IDENTITY
from geomesh.raster.scene import Excerpt, Scene

if TYPE_CHECKING:
    import rasterio
    from xarray import DataArray

_DATASETS = (DatasetReader, DatasetWriter, BufferedDatasetWriter, WarpedVRT)

ArraySource = tuple[Any, Affine, Any]
Source: TypeAlias = "str | PathLike[str] | rasterio.DatasetReader | DataArray | ArraySource"


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
    """Open a source and return it as a Scene. No pixel is read yet.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
        An array is (H, W) or (B, H, W); masked arrays keep their mask. A DataArray has two
        spatial dimensions and at most one of bands; rioxarray reads its georeference. If it
        is lazy (in Dask or in a file), it is computed window by window, never as a whole.
    bidx : sequence of int, optional
        Bands to use; the first band is 1. Default: all except alpha.
    nodata : float, optional
        Used instead of the file's own nodata value.
    crs : str, int or pyproj.CRS, optional
        Used instead of the file's own CRS. The raster is not reprojected.
    bounds : (west, south, east, north), optional
        Box in map coordinates to crop to. All rows and columns that it touches are kept.
        On a rotated grid, the pixels whose centre is in the box are kept.
    mask : path, GeoDataFrame or GeoSeries, optional
        Polygons of the area of interest. They are reprojected to the CRS of the raster.
    name : str, optional
        Name of the source in messages and metadata. Default: its path.

    Raises
    ------
    SourceError, BandError, GeoreferenceError, EmptyError
    """
    if bidx is not None and not (
        isinstance(bidx, Sequence) and all(isinstance(index, int) for index in bidx)
    ):
        raise BandError(f"bidx is {bidx!r}: give a list of band numbers such as [3, 2, 1]")
    given = None if crs is None else _parse_crs("the CRS", crs)
    if isinstance(source, tuple) and len(source) == 3:
        array, transform, own = source
        if given is None and own is not None:
            given = _parse_crs("the CRS of the array,", own)
        scene = _array_scene(_array_raster(name or "the array", array, transform), bidx, given)
    elif is_xarray(source):
        raster = read_dataarray(source, name, with_crs=given is None)
        scene = _array_scene(raster, bidx, given)
    elif isinstance(source, _DATASETS):
        if source.closed:
            raise SourceError(f"{source.name} is closed; give an open dataset, or its path")
        scene = _dataset_scene(name or source.name, BorrowedDataset(source), source, bidx, given)
    elif isinstance(source, str | PathLike):
        path = fspath(source)
        with open_raster(path) as dataset:
            # Absolute, because workers in other processes may have another working folder.
            absolute = os.path.abspath(path) if os.path.exists(path) else path  # noqa: PTH100, PTH110
            scene = _dataset_scene(name or path, absolute, dataset, bidx, given)
    else:
        raise SourceError(
            f"cannot open a {type(source).__name__} as a raster: give a path, an open rasterio "
            "dataset, an xarray.DataArray or (array, transform, crs)"
        )
    if nodata is not None:
        scene = replace(scene, nodata=float(nodata))
    if bounds is not None or mask is not None:
        scene = restrict(scene, bounds=bounds, mask=mask)
    return scene


def _parse_crs(label: str, crs: Any) -> CRS:
    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{label} {crs!r} is unknown ({one_line(error)}); give a code such as EPSG:32722"
        ) from error


def _array_raster(name: str, array: Any, transform: Any) -> ArrayRaster:
    array = np.ma.asarray(array) if np.ma.isMaskedArray(array) else np.asarray(array)
    check_shape(name, array.shape)
    if not isinstance(transform, Affine | None):
        raise GeoreferenceError(
            f"{name} has the transform {transform!r}: expected affine.Affine; for six numbers in "
            "GDAL's order use Affine.from_gdal"
        )
    return ArrayRaster(name, array[None] if array.ndim == 2 else array, transform or IDENTITY)


def _array_scene(raster: ArrayRaster, bidx: Sequence[int] | None, given: CRS | None) -> Scene:
    name, array = raster.name, raster.array
    descriptions = raster.descriptions or (None,) * len(array)
    texts = raster.texts or (BandText(),) * len(array)
    bands = array_bands(name, array.dtype, descriptions, texts, bidx)
    grid, notes = georeference(name, raster, given)
    source, size = Excerpt(array, grid.extent), (grid.width, grid.height)
    return Scene(
        name, grid, grid.extent, bands, array.dtype, source, size, nodata=raster.nodata, notes=notes
    )


def _dataset_scene(
    name: str,
    source: str | BorrowedDataset,
    dataset: rasterio.DatasetReader,
    bidx: Sequence[int] | None,
    given: CRS | None,
) -> Scene:
    if dataset.count == 0:
        raise SourceError(
            f"{name} contains no bands of its own; name one of its subdatasets: "
            f"{', '.join(dataset.subdatasets[:3]) or 'none found'}"
        )
    bands, dtype = dataset_bands(name, dataset, bidx)
    grid, notes = georeference(name, dataset, given)
    size = (dataset.width, dataset.height)
    classes = class_band(dataset)
    return Scene(
        *(name, grid, grid.extent, bands, dtype, source, size), class_band=classes, notes=notes
    )
