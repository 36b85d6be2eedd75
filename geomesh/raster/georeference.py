"""The georeference of a raster: from its transform, its ground control points, or none."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from rasterio.transform import from_gcps

from geomesh.errors import GeoreferenceError, one_line
from geomesh.raster.crs import full_turn, has_angles, is_of_map, to_pyproj
from geomesh.raster.grid import IDENTITY, Grid

if TYPE_CHECKING:
    import rasterio
    from affine import Affine
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.raster.dataarray import ArrayRaster

_NO_CRS = "{} has no CRS, so the mesh has no CRS either"


# A raster may reach half a pixel beyond the poles, or go around the globe more than once. Twice
# the latitude of a pole and more turns than these are no degrees.
_MOST_TURNS = 3


def georeference(
    name: str, dataset: rasterio.DatasetReader | ArrayRaster, given: CRS | None = None
) -> tuple[Grid, tuple[str, ...]]:
    """Return the grid of a dataset, and notes about it for the user.

    Parameters
    ----------
    name : str
        Name of the dataset in messages.
    dataset : rasterio.DatasetReader or ArrayRaster
    given : pyproj.CRS, optional
        Used instead of the dataset's own CRS.
    """
    gcps, gcp_crs = dataset.gcps
    crs = _of_map(name, given or _crs(name, dataset.crs))
    if dataset.transform != IDENTITY or (crs is not None and not gcps):
        notes = () if crs else (_NO_CRS.format(name),)
        return _grid(name, dataset, dataset.transform, crs), notes
    pixels = np.array([(gcp.col, gcp.row) for gcp in gcps], np.float64).reshape(-1, 2)
    places = np.array([(gcp.x, gcp.y) for gcp in gcps], np.float64).reshape(-1, 2)
    if _spread(pixels) and _spread(places):
        fitted = _grid(name, dataset, from_gcps(gcps), _of_map(name, given or _crs(name, gcp_crs)))
        offsets = fitted.to_map(pixels) - places
        residual = float(np.sqrt((offsets**2).sum(axis=1).mean()))
        pixel = math.sqrt(abs(fitted.transform.determinant))
        return fitted, (
            f"{name} has {len(gcps)} ground control points: an affine transform was fitted to "
            f"them, residual {residual:.4g} map units RMS ({residual / pixel:.2g} pixels)",
        )
    if gcps:
        reason = (
            f"has {len(gcps)} ground control points, not finite, too few or on one line: give "
            "three or more"
        )
    elif dataset.rpcs is not None:
        reason = (
            "has rational polynomial coefficients (RPC) only: orthorectify it for map coordinates"
        )
    else:
        reason = "has no georeference"
    notes = (f"{name} {reason}; the mesh is in pixel coordinates, without a CRS",)
    return _grid(name, dataset, IDENTITY, None), notes


def _grid(
    name: str, dataset: rasterio.DatasetReader | ArrayRaster, transform: Affine, crs: CRS | None
) -> Grid:
    try:
        grid = Grid(dataset.width, dataset.height, transform, crs)
    except GeoreferenceError as error:
        raise GeoreferenceError(f"{name}: {error}") from error
    if crs is not None and has_angles(crs):
        west, south, east, north = grid.bounds()
        full = full_turn(crs)
        if east - west > _MOST_TURNS * full or max(-south, north) > full / 2:
            raise GeoreferenceError(
                f"{name} has the CRS {crs.name!r}, which is in angles, but x runs from {west:.7g} "
                f"to {east:.7g} and y from {south:.7g} to {north:.7g}: correct the georeference, "
                "or give the CRS of these coordinates with `crs`"
            )
    return grid


def _spread(points: NDArray[np.float64]) -> bool:
    """Return whether points (n, 2) are not on one line, so that they fix an affine transform."""
    if len(points) < 3 or not np.isfinite(points).all():
        return False
    centred = points - points.mean(axis=0)
    return bool(np.linalg.matrix_rank(centred, tol=1e-9 * np.abs(centred).max()) == 2)


def _crs(name: str, crs: Any) -> CRS | None:
    try:
        return to_pyproj(crs)
    except Exception as error:
        raise GeoreferenceError(
            f"{name} has a CRS that PROJ cannot read ({one_line(error)}); give another with `crs`"
        ) from error


def _of_map(name: str, crs: CRS | None) -> CRS | None:
    if crs is not None and not is_of_map(crs):
        raise GeoreferenceError(
            f"{name} has the {crs.type_name} {crs.name!r}, in which x and y are no place on a "
            "map: give that of its columns and rows with `crs`"
        )
    return crs
