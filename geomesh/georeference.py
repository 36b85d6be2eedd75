"""Where a raster lies on the map: transform, ground control points or nothing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.transform import from_gcps

from geomesh.errors import GeoreferenceError, one_line
from geomesh.grid import IDENTITY, Grid

NO_CRS = "{} has no CRS: the mesh has none either"


def georeference(name: str, dataset: rasterio.DatasetReader) -> tuple[Grid, tuple[str, ...]]:
    """Return the grid of a dataset, and what the user should know about it."""
    size = dataset.width, dataset.height
    crs = _crs(name, dataset.crs)
    if dataset.transform != IDENTITY or crs is not None:
        notes = () if crs else (NO_CRS.format(name),)
        return Grid(*size, dataset.transform, crs), notes
    gcps, gcp_crs = dataset.gcps
    if len(gcps) >= 3:
        transform = from_gcps(gcps)
        if transform.determinant != 0:
            crs = _crs(name, gcp_crs)
            fitted = Grid(*size, transform, crs)
            points = fitted.to_map([(gcp.col, gcp.row) for gcp in gcps])
            offsets = points - np.array([(gcp.x, gcp.y) for gcp in gcps])
            residual = float(np.sqrt((offsets**2).sum(axis=1).mean()))
            pixel = math.sqrt(abs(transform.determinant))
            return fitted, (
                f"{name} is placed by {len(gcps)} ground control points: an affine transform was "
                f"fitted, residual {residual:.4g} map units RMS ({residual / pixel:.2g} pixels)",
            )
    if dataset.rpcs is not None:
        why = "has rational polynomial coefficients (RPC) only: orthorectify it for map coordinates"
    else:
        why = "has no georeference"
    return Grid(*size), (f"{name} {why}; the mesh is in pixel coordinates, without a CRS",)


def _crs(name: str, crs: Any) -> CRS | None:
    """Return rasterio's CRS as pyproj's, by authority code where there is one."""
    if not crs:
        return None
    try:
        authority = crs.to_authority()
        return CRS.from_authority(*authority) if authority else CRS.from_wkt(crs.to_wkt())
    except Exception as error:
        raise GeoreferenceError(
            f"{name}: PROJ does not understand its CRS ({one_line(error)}); assign another one"
        ) from error
