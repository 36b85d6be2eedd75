"""The contours of a mesh as a GeoDataFrame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely

from geomesh.errors import LevelError
from geomesh.parallel.progress import silent
from geomesh.raster.metres import metres_per_unit
from geomesh.terrain.contours import count_crossings, trace_contours
from geomesh.terrain.levels import plan_levels, round_interval

if TYPE_CHECKING:
    from collections.abc import Sequence

    import geopandas as gpd

    from geomesh.arrays.types import Floats
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.terrain.contours import Contours
    from geomesh.terrain.levels import Levels

# More do not fit into the memory of most computers: a vertex takes about 100 bytes.
_MOST_VERTICES = 100_000_000


def find_levels(
    mesh: TriangleMesh,
    *,
    interval: float | None = None,
    base: float = 0.0,
    levels: Sequence[float] | None = None,
    index: int = 5,
) -> Levels:
    """Return the levels of the contours of a mesh: see `plan_levels`.

    Raises
    ------
    LevelError
        If a value is not valid, or there would be too many levels or vertices.
    """
    heights = mesh_heights(mesh)
    low, high = height_range(mesh)
    planned = plan_levels(low, high, interval=interval, base=base, levels=levels, index=index)
    vertices = count_crossings(heights, mesh.edges, planned.values)
    if vertices > _MOST_VERTICES:
        raise LevelError(
            f"contours at {len(planned.values):,} levels would have {vertices:,} vertices, and at "
            f"most {_MOST_VERTICES:,} are possible: heights go from {low:g} to {high:g}, so try "
            f"an `interval` of {round_interval(high - low):g}"
        )
    return planned


def mesh_heights(mesh: TriangleMesh) -> Floats:
    """Return the heights of the nodes (N,) of a mesh that has some."""
    assert mesh.heights is not None
    return mesh.heights


def height_range(mesh: TriangleMesh) -> tuple[float, float]:
    """Return the least and the greatest height of the triangles; NaN if none has heights."""
    corners = mesh_heights(mesh)[mesh.triangles]
    corners = corners[np.isfinite(corners).all(axis=1)]
    if not len(corners):
        return np.nan, np.nan
    return float(corners.min()), float(corners.max())


def contour_frame(
    mesh: TriangleMesh, levels: Levels, progress: Progress = silent
) -> gpd.GeoDataFrame:
    """Return the contours of a mesh with heights.

    Returns
    -------
    geopandas.GeoDataFrame
        In the CRS of the mesh, by level. Columns: `level` (float64), `index` and `closed` (bool),
        `length` (float64) in metres, and geometry: LineString Z, higher ground to the left.
    """
    # Imported here: with pandas it takes 0.25 s.
    import geopandas as gpd

    heights = mesh_heights(mesh)
    found = trace_contours(
        mesh.map_nodes, heights, mesh.triangles, mesh.edges, levels.values, progress
    )
    level = levels.values[found.rank]
    sizes = np.diff(found.offsets)
    places = np.column_stack([found.places, np.repeat(level, sizes)])
    columns = {
        "level": level,
        "index": levels.is_index[found.rank],
        "closed": found.closed,
        "length": _lengths(mesh, found),
    }
    geometry = shapely.linestrings(places, indices=np.repeat(np.arange(len(sizes)), sizes))
    return gpd.GeoDataFrame(columns, geometry=geometry, crs=mesh.grid.crs)


def _lengths(mesh: TriangleMesh, contours: Contours) -> Floats:
    """Return the lengths of contours in metres; without a CRS, in pixels."""
    places = contours.places
    if not len(places):
        return np.empty(0)
    middles = (places[1:] + places[:-1]) / 2
    step = np.diff(places, axis=0) * metres_per_unit(mesh.grid.crs, middles)
    length = np.append(np.hypot(*step.T), 0.0)
    length[contours.offsets[1:] - 1] = 0.0  # from a line to the next
    lengths: Floats = np.add.reduceat(length, contours.offsets[:-1])
    return lengths
