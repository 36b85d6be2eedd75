"""Open a source as a Scene: a path, an open dataset, an array or a DataArray."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from affine import Affine
from pyproj.exceptions import CRSError
from rasterio.io import BufferedDatasetWriter, DatasetReader, DatasetWriter
from rasterio.vrt import WarpedVRT

from geomesh.errors import BandError, GeoreferenceError, SourceError, one_line
from geomesh.parameters import ALPHA, Alpha
from geomesh.raster.alpha import note_on_alpha
from geomesh.raster.aoi.restrict import restrict
from geomesh.raster.band_names import BandText
from geomesh.raster.bands import array_bands, class_band, dataset_bands, palette
from geomesh.raster.crs import to_pyproj
from geomesh.raster.dataarray import (
    ArrayRaster,
    check_axes,
    check_shape,
    is_xarray,
    read_dataarray,
)
from geomesh.raster.file_set import require_parts
from geomesh.raster.gdal import GDAL_ERRORS, BorrowedDataset, open_raster, opening_error
from geomesh.raster.georeference import georeference
from geomesh.raster.grid import IDENTITY
from geomesh.raster.nodata import Number, note_on_nodata, parse_nodata
from geomesh.raster.pixels import Excerpt
from geomesh.raster.scaling import PLAIN, SCALED, choose_scalings
from geomesh.raster.scene import Scene
from geomesh.raster.side_files import find_contradiction
from geomesh.raster.tiff import check_blocks

if TYPE_CHECKING:
    import rasterio
    from pyproj import CRS
    from xarray import DataArray

_DATASETS = (DatasetReader, DatasetWriter, BufferedDatasetWriter, WarpedVRT)

ArraySource = tuple[Any, Affine, Any]
Source: TypeAlias = "str | PathLike[str] | rasterio.DatasetReader | DataArray | ArraySource"


def open_scene(
    source: Source,
    *,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    alpha: Alpha = "mask",
    unscale: bool = False,
    crs: Any = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    mask_layer: str | None = None,
    name: str | None = None,
) -> Scene:
    """Open a source and return it as a Scene. Only a few pixels of an alpha band are read yet.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
        An array is (H, W) or (B, H, W); masked arrays keep their mask. A DataArray has two
        spatial dimensions and at most one of bands; rioxarray reads its georeference. If it
        is lazy (in Dask or in a file), it is computed window by window, never as a whole.
    bidx : sequence of int, optional
        Bands to use; the first band is 1. Default: all except alpha.
    nodata : float, optional
        Used instead of the file's own nodata value, as a stored value. NaN: there is none.
    alpha : {"mask", "data"}
        "mask": bands tagged as alpha and masks in the file or beside it hide pixels.
        "data": they do not, and a band tagged as alpha is an ordinary band.
    unscale : bool
        Use scale * stored value + offset of each band instead of the stored values.
    crs : str, int or pyproj.CRS, optional
        Used instead of the file's own CRS. The raster is not reprojected.
    bounds : (west, south, east, north), optional
        Box in map coordinates. The pixels whose centre is in the box are kept. In longitude and
        latitude, west may be greater than east: then the box crosses the antimeridian.
    mask : path, GeoDataFrame, GeoSeries, shapely geometry, GeoJSON mapping or WKT, optional
        Polygons of the area of interest, in any CRS. The pixels whose centre is in a polygon
        are kept. A geometry without a CRS is in the coordinates of the raster; a GeoJSON
        mapping is in longitude and latitude.
    mask_layer : str, optional
        The layer to use, if `mask` is a file with several.
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
    if alpha not in ALPHA:
        raise BandError(f"alpha is {alpha!r}: choose from {', '.join(ALPHA)}")
    values = _Values(None if nodata is None else parse_nodata(nodata), alpha, bool(unscale))
    given = None if crs is None else _parse_crs("the CRS", crs)
    if isinstance(source, tuple) and len(source) == 3:
        array, transform, own = source
        if given is None and own is not None:
            given = _parse_crs("the CRS of the array,", own)
        raster = _array_raster(name or "the array", array, transform)
        scene = _array_scene(raster, bidx, given, values)
    elif is_xarray(source):
        raster = read_dataarray(source, name, with_crs=given is None)
        scene = _array_scene(raster, bidx, given, values)
    elif isinstance(source, _DATASETS):
        if source.closed:
            raise SourceError(f"{source.name} is closed; give an open dataset, or its path")
        borrowed, shown = BorrowedDataset(source), name or source.name
        with _described(shown):
            on_opening = _note_on_opening(shown, source)
            scene = _dataset_scene(shown, borrowed, source, bidx, given, values)
            scene = replace(scene, notes=(*on_opening, *_note_on_side_file(source), *scene.notes))
    elif isinstance(source, str | PathLike):
        path = fspath(source)
        with _described(name or path):
            scene = _file_scene(path, name or path, bidx, given, values)
    else:
        raise SourceError(
            f"cannot open a {type(source).__name__} as a raster: give a path, an open rasterio "
            "dataset, an xarray.DataArray or (array, transform, crs)"
        )
    if mask_layer is not None and mask is None:
        raise SourceError("`mask_layer` chooses a layer of `mask`, which is not given")
    if bounds is not None or mask is not None:
        scene = restrict(scene, bounds=bounds, mask=mask, mask_layer=mask_layer)
    if isinstance(scene.source, str):
        require_parts(scene.source, scene.window, [band.index for band in scene.bands])
    return scene


@contextmanager
def _described(name: str) -> Iterator[None]:
    """Raise SourceError if GDAL opens a dataset but cannot describe it."""
    try:
        yield
    except GDAL_ERRORS as error:
        raise SourceError(
            f"{name} is damaged: its bands or its georeference cannot be read (GDAL: "
            f"{one_line(error)}); download or export it again"
        ) from error


def _parse_crs(label: str, crs: Any) -> CRS | None:
    try:
        if crs == "":
            raise CRSError("it is empty")
        return to_pyproj(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{label} {crs!r} is unknown ({one_line(error)}); give a code such as EPSG:32722"
        ) from error


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


@dataclass(frozen=True)
class _Values:
    """How to understand the stored values: see `open_scene`."""

    nodata: Number | None
    alpha: Alpha
    unscale: bool


def _array_scene(
    raster: ArrayRaster, bidx: Sequence[int] | None, given: CRS | None, values: _Values
) -> Scene:
    name, array = raster.name, raster.array
    descriptions = raster.descriptions or (None,) * len(array)
    texts = raster.texts or (BandText(),) * len(array)
    bands = array_bands(name, array.dtype, descriptions, texts, bidx)
    indexes = [band.index for band in bands]
    scalings, on_scale = choose_scalings(
        name, raster.scalings or (PLAIN,) * len(array), indexes, unscale=values.unscale
    )
    grid, notes = georeference(name, raster, given)
    notes = (*raster.notes, *notes)
    on_nodata = note_on_nodata(name, [array.dtype], values.nodata)
    return Scene(
        name,
        grid,
        grid.extent,
        bands,
        SCALED if scalings else array.dtype,
        Excerpt(array, grid.extent),
        (grid.width, grid.height),
        nodata=raster.nodata if values.nodata is None else values.nodata,
        alpha=values.alpha,
        unscale=values.unscale,
        scalings=scalings,
        notes=(*notes, *on_nodata, *on_scale),
    )


def _file_scene(
    path: str, name: str, bidx: Sequence[int] | None, given: CRS | None, values: _Values
) -> Scene:
    # Absolute, because workers in other processes may have another working folder.
    absolute = os.path.abspath(path) if os.path.exists(path) else path  # noqa: PTH100, PTH110
    with open_raster(path) as dataset:
        on_opening = _note_on_opening(name, dataset)
        contradiction = find_contradiction(dataset)
        if contradiction is None:
            scene = _dataset_scene(name, absolute, dataset, bidx, given, values)
            return replace(scene, notes=(*on_opening, *scene.notes))
    with open_raster(path, side_files=False) as dataset:
        opening_error(dataset)
        scene = _dataset_scene(name, absolute, dataset, bidx, given, values)
    note = f"{name}: {contradiction}; the side file is not used"
    return replace(scene, side_files=False, notes=(note, *scene.notes))


def _note_on_opening(name: str, dataset: Any) -> tuple[str, ...]:
    """Return a note if GDAL reported an error and opened the dataset nevertheless."""
    error = opening_error(dataset)
    if error is None:
        return ()
    return (
        f"{name}: GDAL reports an error in this file ({error}); check the georeference and the "
        "values",
    )


def _note_on_side_file(dataset: Any) -> tuple[str, ...]:
    """Return a note if a dataset that the caller opened follows a side file, not the file."""
    with suppress(SourceError):  # its name may be nothing that can be opened
        contradiction = find_contradiction(getattr(dataset, "src_dataset", dataset))
        if contradiction is not None:
            return (f"{dataset.name}: {contradiction}; to use the file itself, give its path",)
    return ()


def _dataset_scene(
    name: str,
    source: str | BorrowedDataset,
    dataset: rasterio.DatasetReader,
    bidx: Sequence[int] | None,
    given: CRS | None,
    values: _Values,
) -> Scene:
    if dataset.count == 0:
        raise SourceError(
            f"{name} contains no bands of its own; name one of its subdatasets: "
            f"{', '.join(dataset.subdatasets[:3]) or 'none found'}"
        )
    if dataset.driver == "GTiff":
        check_blocks(name, dataset)
    bands, dtype = dataset_bands(name, dataset, bidx, values.alpha)
    indexes = [band.index for band in bands]
    # The values of a palette are classes, which cannot be scaled.
    own = [PLAIN] * dataset.count
    if palette(dataset) is None:
        own = list(zip(dataset.scales, dataset.offsets, strict=True))
    scalings, on_scale = choose_scalings(name, own, indexes, unscale=values.unscale)
    types = [np.dtype(dataset.dtypes[index - 1]) for index in indexes]
    on_nodata = note_on_nodata(name, types, values.nodata)
    on_alpha = note_on_alpha(name, dataset, values.alpha)
    grid, notes = georeference(name, dataset, given)
    return Scene(
        name,
        grid,
        grid.extent,
        bands,
        SCALED if scalings else dtype,
        source,
        (dataset.width, dataset.height),
        class_band=class_band(dataset),
        nodata=values.nodata,
        alpha=values.alpha,
        unscale=values.unscale,
        scalings=scalings,
        notes=(*notes, *on_nodata, *on_alpha, *on_scale),
    )
