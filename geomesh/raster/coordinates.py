"""The transform of a DataArray: from its coordinates, and from the transform stored with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine

from geomesh.errors import GeoreferenceError
from geomesh.raster.grid import IDENTITY

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from xarray import DataArray

# Largest difference between coordinates and evenly spaced ones, in pixels.
_TOLERANCE = 1e-3

# With coordinates that are rounded to this part of a pixel, a shift by a half cannot be seen.
_TOO_COARSE = 0.2


def find_transform(name: str, source: DataArray, x: Any, y: Any) -> tuple[Affine, tuple[str, ...]]:
    """Return the transform of a DataArray, and notes about it for the user.

    This is the stored transform, which is exact, if it agrees with the coordinates as the centres
    of pixels. If a part was cut out, the transform is computed from the coordinates. If both are
    half a pixel apart, the coordinates are those of the upper left corners of pixels, as stackstac
    gives them. Without coordinates a cut cannot be detected.

    Parameters
    ----------
    name : str
        Name in messages.
    source : xarray.DataArray
    x, y : hashable
        Names of its spatial dimensions.

    Raises
    ------
    GeoreferenceError
        If the coordinates are not evenly spaced, or lie at another part of the pixels than the
        stored transform says.
    """
    stored = _stored(source)
    if x in source.coords and y in source.coords:
        xs, ys = source.coords[x].values[None, :], source.coords[y].values[:, None]
    elif "xc" in source.coords and "yc" in source.coords:  # from rioxarray, for a rotated grid
        xs, ys = (source.coords[each].transpose(y, x).values for each in ("xc", "yc"))
    else:
        return stored or IDENTITY, ()
    for axis, values in ((x, xs), (y, ys)):
        if values.dtype.kind not in "iuf":
            raise GeoreferenceError(
                f"{name} has {axis} coordinates of type {values.dtype}: give numbers in units of "
                "its CRS"
            )
    if stored is not None and not any(_misfits(stored, xs, ys)):
        return stored, ()
    if stored is None and 1 in (source.sizes[x], source.sizes[y]):
        raise GeoreferenceError(
            f"{name} is only one pixel {'wide' if source.sizes[x] == 1 else 'high'}, so its "
            "coordinates do not give the pixel size: set it with .rio.write_transform(transform)"
        )
    fitted = _fit(xs, ys, stored)
    for axis, misfit in zip((x, y), _misfits(fitted, xs, ys), strict=True):
        if misfit:
            raise GeoreferenceError(
                f"{name} has {axis} coordinates that are not evenly spaced, by up to {misfit:.2g} "
                "pixels: resample it to a regular grid, as with "
                f".interp({axis}=numpy.linspace(...))"
            )
    return (fitted, ()) if stored is None else _reconciled(name, fitted, stored, xs, ys)


def _reconciled(
    name: str, fitted: Affine, stored: Affine, xs: NDArray[Any], ys: NDArray[Any]
) -> tuple[Affine, tuple[str, ...]]:
    """Return the transform for coordinates that differ from those of the stored transform.

    A whole number of pixels between them is a cut; the grid of other pixels is another grid.
    """
    sizes = np.abs([fitted[:2] + fitted[3:5], stored[:2] + stored[3:5]])
    pixel = sizes[1].max()
    if pixel == 0 or stored.is_degenerate or np.abs(sizes[0] - sizes[1]).max() > _TOLERANCE * pixel:
        return fitted, ()
    rounding = max(
        2 * float(np.finfo(values.dtype).eps * np.abs(values).max())
        if values.dtype.kind == "f"
        else 0.0
        for values in (xs, ys)
    )
    allowed = 10 * _TOLERANCE + rounding / float(sizes[1][sizes[1] > 0].min())
    if allowed > _TOO_COARSE:
        return fitted, ()
    shift = np.array(~stored @ (fitted.c, fitted.f))
    if np.abs(shift - np.rint(shift)).max() <= allowed:
        return fitted, ()
    if np.abs(shift - np.floor(shift) - 0.5).max() <= allowed:
        a, b, c, d, e, f = fitted[:6]
        corner = Affine(*(a, b, c + (stored.a + stored.b) / 2, d, e, f + (stored.d + stored.e) / 2))
        near = corner.almost_equals(stored, precision=allowed * pixel)
        return stored if near else corner, (
            f"the coordinates of {name} are taken for the upper left corners of its pixels, as its "
            "stored transform says; if they are the centres, store that with "
            ".rio.write_transform(array.rio.transform(recalc=True))",
        )
    parts = " and ".join(f"{part:.2g}" for part in np.abs(shift - np.rint(shift)))
    raise GeoreferenceError(
        f"{name} has coordinates that lie {parts} pixels beside its stored transform: if the "
        "coordinates are right, store that with "
        ".rio.write_transform(array.rio.transform(recalc=True))"
    )


def _stored(source: DataArray) -> Affine | None:
    """Return the transform that is stored with a DataArray, or None.

    rioxarray stores it with the CRS, in GDAL's order; stackstac and older versions of xarray as
    an attribute, in the order of Affine.
    """
    keeper = source.coords.get(source.rio.grid_mapping)
    numbers = [] if keeper is None else str(keeper.attrs.get("GeoTransform", "")).split()
    if len(numbers) == 6:
        return Affine.from_gdal(*map(float, numbers))
    given = source.attrs.get("transform")
    if given is None:
        given = getattr(source.attrs.get("spec"), "transform", None)
    if isinstance(given, Affine):
        return given
    if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) and len(given) >= 6:
        try:
            return Affine(*(float(number) for number in given[:6]))
        except (TypeError, ValueError):
            return None
    return None


def _fit(xs: NDArray[Any], ys: NDArray[Any], stored: Affine | None) -> Affine:
    """Return the transform of evenly spaced coordinates; `xs` and `ys` as in `_misfits`.

    A single column or row has no spacing: then that of the stored transform is taken.
    """
    (x, a, b), (y, d, e) = (
        (float(values[0, 0]), _step(values[0, :]), _step(values[:, 0])) for values in (xs, ys)
    )
    if stored is not None and xs.shape[1] == 1:
        a, d = stored.a, stored.d
    if stored is not None and ys.shape[0] == 1:
        b, e = stored.b, stored.e
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
