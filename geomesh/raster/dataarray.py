"""A raster in memory, with the attributes of a rasterio dataset: an array or a DataArray."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from affine import Affine

from geomesh.errors import GeoreferenceError, SourceError, extra_required, one_line
from geomesh.raster.dataarray_bands import describe_bands, read_scalings
from geomesh.raster.grid import IDENTITY
from geomesh.raster.nodata import Number, parse_nodata

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from xarray import DataArray, Variable

    from geomesh.raster.band_names import BandText
    from geomesh.raster.scaling import Scaling

# Names of the third dimension: from rioxarray, from Dataset.to_dataarray() and from openEO.
_BAND_DIMENSIONS = ("band", "variable", "bands")

# Largest difference between coordinates and evenly spaced ones, in pixels.
_TOLERANCE = 1e-3


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
        raise SourceError(
            f"{name} has no dimensions x and y (its dimensions: {names}); rename them, as in "
            ".rename(lon='x', lat='y')"
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
    return ArrayRaster(
        name,
        Pixels(source.variable.transpose(*others, y, x)),
        _transform(name, source, x, y),
        crs,
        (source.rio.get_gcps() or (), crs),
        _nodata(name, source),
        *describe_bands(source, others[0] if others else None),
        read_scalings(name, source, others[0] if others else None),
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


def _transform(name: str, source: DataArray, x: Any, y: Any) -> Affine:
    """Return the transform that maps pixel centres to the coordinates.

    This is the stored transform, which is exact, if it agrees with the coordinates. If a part
    was cut out, the transform is computed from the coordinates. Without coordinates a cut
    cannot be detected.
    """
    stored = _stored(source)
    if x in source.coords and y in source.coords:
        xs, ys = source.coords[x].values[None, :], source.coords[y].values[:, None]
    elif "xc" in source.coords and "yc" in source.coords:  # from rioxarray, for a rotated grid
        xs, ys = (source.coords[each].transpose(y, x).values for each in ("xc", "yc"))
    else:
        return stored or IDENTITY
    for axis, values in ((x, xs), (y, ys)):
        if values.dtype.kind not in "iuf":
            raise GeoreferenceError(
                f"{name} has {axis} coordinates of type {values.dtype}: give numbers in units of "
                "its CRS"
            )
    if stored is not None and not any(_misfits(stored, xs, ys)):
        return stored
    if 1 in (source.sizes[x], source.sizes[y]):
        raise GeoreferenceError(
            f"{name} is only one pixel {'wide' if source.sizes[x] == 1 else 'high'}, so its "
            "coordinates do not give the pixel size: set it with .rio.write_transform()"
        )
    fitted = _fit(xs, ys)
    for axis, misfit in zip((x, y), _misfits(fitted, xs, ys), strict=True):
        if misfit:
            raise GeoreferenceError(
                f"{name} has {axis} coordinates that are not evenly spaced, by up to {misfit:.2g} "
                "pixels: resample it to a regular grid with .interp() or .rio.reproject()"
            )
    return fitted


def _stored(source: DataArray) -> Affine | None:
    """Return the transform that rioxarray stores with the CRS, in GDAL's order, or None."""
    keeper = source.coords.get(source.rio.grid_mapping)
    numbers = [] if keeper is None else str(keeper.attrs.get("GeoTransform", "")).split()
    return Affine.from_gdal(*map(float, numbers)) if len(numbers) == 6 else None


def _fit(xs: NDArray[Any], ys: NDArray[Any]) -> Affine:
    """Return the transform of evenly spaced coordinates; `xs` and `ys` as in `_misfits`."""
    (x, a, b), (y, d, e) = (
        (float(values[0, 0]), _step(values[0, :]), _step(values[:, 0])) for values in (xs, ys)
    )
    return Affine(a, b, x - (a + b) / 2, d, e, y - (d + e) / 2)


def _step(values: NDArray[Any]) -> float:
    return (float(values[-1]) - float(values[0])) / max(len(values) - 1, 1)


def _misfits(transform: Affine, xs: NDArray[Any], ys: NDArray[Any]) -> list[float]:
    """Return how far the x and y coordinates are from those of the transform, in pixels.

    The result is 0 if they agree up to rounding.

    Parameters
    ----------
    transform : Affine
    xs, ys : (1, W) and (H, 1), or both (H, W)
        Coordinates of the centres of pixels.
    """
    cols, rows = np.arange(xs.shape[1]) + 0.5, np.arange(ys.shape[0])[:, None] + 0.5
    misfits = []
    for values, (along, down, start) in ((xs, transform[:3]), (ys, transform[3:6])):
        expected = start + (along * cols if along else 0) + (down * rows if down else 0)
        off = float(np.abs(values - expected).max())
        pixel = max(abs(along), abs(down))
        rounding = np.finfo(values.dtype).eps if values.dtype.kind == "f" else 0
        agree = off <= _TOLERANCE * pixel + 2 * rounding * np.abs(values).max()
        misfits.append(0.0 if agree else off / pixel if pixel else math.inf)
    return misfits
