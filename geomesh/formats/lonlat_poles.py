"""Grids of longitude and latitude that reach beyond a pole, as those with a pixel on it do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import GeoreferenceError
from geomesh.raster.crs import has_angles

if TYPE_CHECKING:
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid

# In pixels.
_ROUNDING = 1e-6


def check_poles(mesh: TriangleMesh) -> None:
    """Refuse a mesh with geometry beyond a pole, except for a part of the pixels on the pole.

    Raises
    ------
    GeoreferenceError
        It names the box to which the raster should be cropped.
    """
    crs = mesh.grid.crs
    if crs is None or not has_angles(crs):
        return
    pole = 90 / np.degrees(crs.axis_info[0].unit_conversion_factor)
    y = mesh.map_nodes[:, 1]
    if (np.abs(y) <= pole).all():
        return
    south, north, reach = _rows_between(mesh.grid, pole)
    nodes = np.count_nonzero(np.abs(y) > reach)
    corners = y[mesh.triangles]
    triangles = np.count_nonzero((corners >= pole).all(axis=1) | (corners <= -pole).all(axis=1))
    if not nodes and not triangles:
        return
    what = f"{nodes} of {len(y)} nodes" if nodes else f"{triangles} of {len(corners)} triangles"
    west, _, east, _ = mesh.grid.bounds()
    box = " ".join(f"{side:.15g}" for side in (west, south, east, north))
    crop = f"mesh the raster again with `bounds` {box}, or " if south < north else ""
    raise GeoreferenceError(
        f"GeoJSON needs longitude and latitude, but {what} lie beyond a pole: {crop}write .gpkg"
    )


def _rows_between(grid: Grid, pole: float) -> tuple[float, float, float]:
    """Return between which y pixels lie within the poles, and how far those on a pole reach."""
    _, _, _, d, e, f = grid.transform[:6]
    height = abs(d) + abs(e)
    if not grid.is_rectilinear:
        return height / 2 - pole, pole - height / 2, pole + height
    borders = f + e * np.arange(grid.height + 1)
    slack = _ROUNDING * height
    within = borders[np.abs(borders) <= pole + slack]
    outside = np.abs(borders[np.abs(borders) >= pole - slack])
    return (
        float(within.min(initial=np.inf)),
        float(within.max(initial=-np.inf)),
        float(outside.min(initial=np.inf)) + slack,
    )
