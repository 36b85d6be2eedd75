"""Open a source as a Scene: a path, an open dataset, an array or a DataArray."""

from __future__ import annotations

from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, TypeAlias

from affine import Affine
from rasterio.io import BufferedDatasetWriter, DatasetReader, DatasetWriter
from rasterio.vrt import WarpedVRT

from geomesh.errors import SourceError
from geomesh.raster.aoi.restrict import restrict
from geomesh.raster.dataarray import is_xarray
from geomesh.raster.file_set import require_parts
from geomesh.raster.open_array import open_array, open_dataarray
from geomesh.raster.open_dataset import open_dataset, open_file
from geomesh.raster.reading import Reading

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rasterio
    from xarray import DataArray

    from geomesh.parameters import Alpha
    from geomesh.raster.scene import Scene

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
    reading = Reading.of(bidx=bidx, nodata=nodata, alpha=alpha, unscale=unscale, crs=crs)
    if mask_layer is not None and mask is None:
        raise SourceError("`mask_layer` chooses a layer of `mask`, which is not given")
    if isinstance(source, tuple) and len(source) == 3:
        scene = open_array(source, name, reading)
    elif is_xarray(source):
        scene = open_dataarray(source, name, reading)
    elif isinstance(source, _DATASETS):
        scene = open_dataset(source, name, reading)
    elif isinstance(source, str | PathLike):
        scene = open_file(fspath(source), name, reading)
    else:
        raise SourceError(
            f"cannot open a {type(source).__name__} as a raster: give a path, an open rasterio "
            "dataset, an xarray.DataArray or (array, transform, crs)"
        )
    if bounds is not None or mask is not None:
        scene = restrict(scene, bounds=bounds, mask=mask, mask_layer=mask_layer)
    if isinstance(scene.source, str):
        require_parts(scene.source, scene.window, [band.index for band in scene.bands])
    return scene
