"""Where a raster lies on the map: transform, ground control points or nothing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS
from rasterio.transform import from_gcps

from geomesh.errors import GeoreferenceError, one_line
from geomesh.raster.grid import IDENTITY, Grid

if TYPE_CHECKING:
    import rasterio
    from affine import Affine
    from numpy.typing import NDArray

    from geomesh.raster.dataarray import ArrayRaster

_NO_CRS = "{} has no CRS: the mesh has none either"


def georeference(
    name: str, dataset: rasterio.DatasetReader | ArrayRaster, given: CRS | None = None
) -> tuple[Grid, tuple[str, ...]]:
    """Return the grid of a dataset, and what the user should know about it.

    Parameters
    ----------
    name : str
        What messages call the dataset.
    dataset : rasterio.DatasetReader or ArrayRaster
    given : pyproj.CRS, optional
        Takes the place of the file's own.
    """
    gcps, gcp_crs = dataset.gcps
    crs = given or _crs(name, dataset.crs)
    if dataset.transform != IDENTITY or (crs is not None and not gcps):
        notes = () if crs else (_NO_CRS.format(name),)
        return _grid(name, dataset, dataset.transform, crs), notes
    pixels = np.array([(gcp.col, gcp.row) for gcp in gcps], np.float64).reshape(-1, 2)
    places = np.array([(gcp.x, gcp.y) for gcp in gcps], np.float64).reshape(-1, 2)
    if _spread(pixels) and _spread(places):
        fitted = _grid(name, dataset, from_gcps(gcps), given or _crs(name, gcp_crs))
        offsets = fitted.to_map(pixels) - places
        residual = float(np.sqrt((offsets**2).sum(axis=1).mean()))
        pixel = math.sqrt(abs(fitted.transform.determinant))
        return fitted, (
            f"{name} is placed by {len(gcps)} ground control points: an affine transform was "
            f"fitted, residual {residual:.4g} map units RMS ({residual / pixel:.2g} pixels)",
        )
    if gcps:
        why = f"has {len(gcps)} ground control points, too few or on a line: give three or more"
    elif dataset.rpcs is not None:
        why = "has rational polynomial coefficients (RPC) only: orthorectify it for map coordinates"
    else:
        why = "has no georeference"
    notes = (f"{name} {why}; the mesh is in pixel coordinates, without a CRS",)
    return _grid(name, dataset, IDENTITY, None), notes


def _grid(
    name: str, dataset: rasterio.DatasetReader | ArrayRaster, transform: Affine, crs: CRS | None
) -> Grid:
    try:
        return Grid(dataset.width, dataset.height, transform, crs)
    except GeoreferenceError as error:
        raise GeoreferenceError(f"{name}: {error}") from error


def _spread(points: NDArray[np.float64]) -> bool:
    """Tell whether points (n, 2) span a plane: only then do they fix an affine transform."""
    if len(points) < 3:
        return False
    centred = points - points.mean(axis=0)
    return bool(np.linalg.matrix_rank(centred, tol=1e-9 * np.abs(centred).max()) == 2)


def _crs(name: str, crs: Any) -> CRS | None:
    """Return rasterio's CRS as pyproj's, by authority code where there is one."""
    if not crs:
        return None
    try:
        authority = crs.to_authority()
        return CRS.from_authority(*authority) if authority else CRS.from_wkt(crs.to_wkt())
    except Exception as error:
        raise GeoreferenceError(
            f"{name}: PROJ does not understand its CRS ({one_line(error)}); give another with `crs`"
        ) from error
