"""A raster in memory, with the attributes of a rasterio dataset: an array or a DataArray."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from geomesh.errors import GeoreferenceError, SourceError, extra_required, one_line
from geomesh.raster.coordinates import find_transform
from geomesh.raster.dataarray_bands import describe_bands, read_scalings
from geomesh.raster.grid import IDENTITY
from geomesh.raster.nodata import Number, parse_nodata

if TYPE_CHECKING:
    from affine import Affine
    from numpy.typing import NDArray
    from xarray import DataArray, Variable

    from geomesh.raster.band_names import BandText
    from geomesh.raster.scaling import Scaling

# Names of the third dimension: from rioxarray, from Dataset.to_dataarray() and from openEO.
_BAND_DIMENSIONS = ("band", "variable", "bands")

# A first axis this short can only be the bands. A last axis this short may be: few rasters are so
# narrow.
_FEW_BANDS = 4
_MANY_BANDS = 16


@dataclass(frozen=True, eq=False)
class ArrayRaster:
    """Pixels in memory and their georeference. Attributes have the names of rasterio.

    Parameters
    ----------
    name : str
        Name in messages and metadata.
    array : (B, H, W)
        A numpy array, which may be masked, or the `Pixels` of a DataArray.
    transform : Affine
    crs : rasterio.crs.CRS, optional
    gcps : (list of rasterio.control.GroundControlPoint, rasterio.crs.CRS or None)
    nodata : float, optional
    descriptions : tuple of str or None, optional
        One for each band.
    texts : tuple of BandText, optional
        One for each band: what to name it after.
    scalings : tuple of (float, float), optional
        Scale and offset of each band.
    notes : tuple of str
        Notes about the transform, for the user.
    unit : str
        Of the values; empty if it is not known.
    """

    name: str
    array: Any
    transform: Affine = IDENTITY
    crs: Any = None
    gcps: tuple[Any, Any] = ((), None)
    nodata: Number | None = None
    descriptions: tuple[str | None, ...] | None = None
    texts: tuple[BandText, ...] | None = None
    scalings: tuple[Scaling, ...] | None = None
    notes: tuple[str, ...] = ()
    unit: str = ""

    rpcs = None

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.array.shape[2])

    @property
    def height(self) -> int:
        """Number of rows."""
        return int(self.array.shape[1])


@dataclass(frozen=True, eq=False)
class Pixels:
    """The values of a DataArray as (B, H, W). They are read or computed when numpy needs them.

    Parameters
    ----------
    variable : xarray.Variable (H, W) or (B, H, W)
        Its data may be in a file or in Dask: only the part that is sliced is computed.
    """

    variable: Variable

    @property
    def shape(self) -> tuple[int, ...]:
        """(B, H, W)."""
        return (1, *self.variable.shape)[-3:]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""
        dtype: np.dtype[Any] = self.variable.dtype
        return dtype

    def __getitem__(self, key: tuple[Any, Any, Any]) -> Pixels:
        return Pixels(self.variable[key[-self.variable.ndim :]])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        values = np.asarray(self.variable.values, dtype)
        return values.reshape(self.shape)


def check_shape(name: str, shape: tuple[int, ...]) -> None:
    """Raise an error if an array of this shape is not a raster.

    Raises
    ------
    SourceError
    """
    if len(shape) not in (2, 3) or 0 in shape:
        raise SourceError(
            f"{name} of shape {shape} is not a raster: expected (rows, columns) or "
            "(bands, rows, columns), all greater than 0"
        )


def check_axes(name: str, shape: tuple[int, ...]) -> None:
    """Raise an error if the last axis of a numpy array seems to be its bands.

    Raises
    ------
    SourceError
        If the first two axes are long and the last is as short as bands are, or if the first two
        are equal and the last is not.
    """
    if len(shape) != 3 or shape[0] <= _FEW_BANDS:
        return
    rows, columns, last = shape
    is_short = last < rows and last <= _MANY_BANDS
    is_square = rows == columns != last and rows > _MANY_BANDS
    if is_short or is_square:
        raise SourceError(
            f"{name} of shape {shape} seems to have its bands on the last axis: give "
            "np.moveaxis(array, -1, 0), or, if its bands do come first, a DataArray with the "
            "dimensions ('band', 'y', 'x')"
        )


def is_xarray(source: Any) -> TypeGuard[DataArray]:
    """Return whether a source is a DataArray or a Dataset, without importing xarray."""
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(source, xarray.DataArray | xarray.Dataset)


def read_dataarray(
    source: DataArray, name: str | None = None, *, with_crs: bool = True
) -> ArrayRaster:
    """Return a DataArray as a raster. No pixel is read yet.

    Parameters
    ----------
    source : xarray.DataArray
        With two spatial dimensions and at most one of bands, in any order.
    name : str, optional
        Default: the name of the DataArray.
    with_crs : bool
        Whether to read its CRS.

    Raises
    ------
    MissingExtraError
        If rioxarray is not installed. It reads the CRS, transform and nodata value.
    SourceError
        If it is a Dataset, has another dimension, or lacks a spatial one.
    GeoreferenceError
        If the coordinates are not those of a raster.
    """
    if not hasattr(source, "variable"):
        raise SourceError(
            "a Dataset contains several rasters: choose a variable, as in ds['red'], or stack the "
            "variables of one grid as bands with .to_dataarray()"
        )
    with extra_required("rioxarray, which reads a DataArray's georeference,", "xarray"):
        import rioxarray  # noqa: F401
        from rioxarray.exceptions import MissingSpatialDimensionError
    name = name or str(source.name or "the DataArray")
    try:
        y, x = source.rio.y_dim, source.rio.x_dim
    except MissingSpatialDimensionError as error:
        names = ", ".join(map(str, source.dims)) or "none"
        columns, rows = (*map(str, source.dims[::-1]), "lon", "lat")[:2]
        raise SourceError(
            f"{name} has no dimensions x and y (its dimensions: {names}); rename them, as in "
            f".rename({columns}='x', {rows}='y')"
        ) from error
    others = [dimension for dimension in source.dims if dimension not in (y, x)]
    unknown = [dimension for dimension in others if dimension not in _BAND_DIMENSIONS]
    if unknown or len(others) > 1:
        first = (unknown or others)[0]
        raise SourceError(
            f"{name} has another dimension, {first}, of size {source.sizes[first]}: choose one "
            f"index with .isel({first}=0)"
            + (f", or .rename({first}='band') if they are bands" if len(others) == 1 else "")
        )
    check_shape(name, source.shape)
    crs = _crs(name, source) if with_crs else None
    transform, notes = find_transform(name, source, x, y)
    return ArrayRaster(
        name,
        Pixels(source.variable.transpose(*others, y, x)),
        transform,
        crs,
        (source.rio.get_gcps() or (), crs),
        _nodata(name, source),
        *describe_bands(source, others[0] if others else None),
        read_scalings(name, source, others[0] if others else None),
        notes,
        str(source.attrs.get("units", "")),
    )


def _crs(name: str, source: DataArray) -> Any:
    try:
        return source.rio.crs
    except Exception as error:
        raise GeoreferenceError(
            f"{name} has an invalid CRS ({one_line(error)}); give another, crs='EPSG:32722'"
        ) from error


def _nodata(name: str, source: DataArray) -> Number | None:
    try:
        nodata = source.rio.nodata
    except OverflowError:
        return None  # the data type cannot represent the value, so no pixel has it
    except (TypeError, ValueError) as error:
        raise SourceError(
            f"{name} has an invalid nodata value ({one_line(error)}); set it with "
            ".rio.write_nodata()"
        ) from error
    # NaN is never valid, and rioxarray's masking replaces the nodata value with NaN.
    return None if nodata is None or np.isnan(nodata) else parse_nodata(nodata)
