"""Open an array or a DataArray as a Scene."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine

from geomesh.errors import GeoreferenceError, SourceError, one_line
from geomesh.raster.band_names import BandText
from geomesh.raster.bands import array_bands
from geomesh.raster.dataarray import ArrayRaster, check_axes, check_shape, read_dataarray
from geomesh.raster.georeference import georeference
from geomesh.raster.grid import IDENTITY
from geomesh.raster.nodata import note_on_nodata
from geomesh.raster.pixels import Excerpt
from geomesh.raster.reading import Reading, read_crs
from geomesh.raster.scaling import PLAIN, SCALED, choose_scalings
from geomesh.raster.scene import Scene

if TYPE_CHECKING:
    from xarray import DataArray


def open_array(source: tuple[Any, Affine, Any], name: str | None, reading: Reading) -> Scene:
    """Return the scene of (array, transform, crs)."""
    array, transform, own = source
    if reading.crs is None and own is not None:
        reading = replace(reading, crs=read_crs("the CRS of the array,", own))
    return _scene(_array_raster(name or "the array", array, transform), reading)


def open_dataarray(source: DataArray, name: str | None, reading: Reading) -> Scene:
    """Return the scene of a DataArray."""
    return _scene(read_dataarray(source, name, with_crs=reading.crs is None), reading)


def _array_raster(name: str, array: Any, transform: Any) -> ArrayRaster:
    try:
        array = np.ma.asarray(array) if np.ma.isMaskedArray(array) else np.asarray(array)
    except (TypeError, ValueError) as error:  # such as lists of different lengths
        raise SourceError(
            f"{name} is not a numpy array ({one_line(error)}); give rows of equal length"
        ) from error
    check_shape(name, array.shape)
    check_axes(name, array.shape)
    if not isinstance(transform, Affine | None):
        raise GeoreferenceError(
            f"{name} has the transform {transform!r}: give affine.Affine; six numbers in the order "
            "of rasterio become one with Affine(*numbers), in GDAL's order with "
            "Affine.from_gdal(*numbers)"
        )
    return ArrayRaster(name, array[None] if array.ndim == 2 else array, transform or IDENTITY)


def _scene(raster: ArrayRaster, reading: Reading) -> Scene:
    name, array = raster.name, raster.array
    descriptions = raster.descriptions or (None,) * len(array)
    texts = raster.texts or (BandText(),) * len(array)
    bands = array_bands(name, array.dtype, descriptions, texts, reading.bidx, raster.unit)
    indexes = [band.index for band in bands]
    scalings, on_scale = choose_scalings(
        name, raster.scalings or (PLAIN,) * len(array), indexes, unscale=reading.unscale
    )
    grid, notes = georeference(name, raster, reading.crs)
    notes = (*raster.notes, *notes)
    on_nodata = note_on_nodata(name, [array.dtype], reading.nodata)
    return Scene(
        name,
        grid,
        grid.extent,
        bands,
        SCALED if scalings else array.dtype,
        Excerpt(array, grid.extent),
        (grid.width, grid.height),
        nodata=raster.nodata if reading.nodata is None else reading.nodata,
        alpha=reading.alpha,
        unscale=reading.unscale,
        scalings=scalings,
        notes=(*notes, *on_nodata, *on_scale),
    )
