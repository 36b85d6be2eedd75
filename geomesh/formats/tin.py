"""The surface in space that formats for terrain and 3-D models store: a TIN."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import GeoreferenceError, OutputError
from geomesh.formats.arrow import Layer
from geomesh.raster.crs import has_angles, horizontal, is_lonlat
from geomesh.raster.metres import metres_per_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

# Coordinates that are stored as float32 are rounded to a multiple of this: the origin is, too.
_ROUND = 1000.0


@dataclass(frozen=True, eq=False)
class Tin:
    """The triangles whose corners have heights, and their nodes.

    Parameters
    ----------
    points : float64 (N, 3)
        x, y and height.
    triangles : int32 (T, 3)
        Rows of `points`, counter-clockwise on the map.
    nodes : int (N,)
        Node of the mesh of each point.
    rows : int (T,)
        Triangle of the mesh of each triangle.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    nodes: NDArray[np.intp]
    rows: NDArray[np.intp]


@dataclass(frozen=True)
class LocalFrame:
    """Metres east and north of an origin, and heights in metres: for 3-D models.

    Parameters
    ----------
    origin : (float, float)
        On the map, in the units of the CRS.
    metres : (float, float)
        Metres for a unit of x and of y.
    height_metres : float
        Metres for a unit of height.
    """

    origin: tuple[float, float]
    metres: tuple[float, float]
    height_metres: float

    @classmethod
    def of(cls, mesh: TriangleMesh) -> LocalFrame:
        """Return a frame whose origin is in the middle of a mesh, at a round number."""
        places = mesh.map_nodes
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        crs = mesh.grid.crs
        is_angle = crs is not None and has_angles(crs)
        origin = middle.round(3) if is_angle else (middle / _ROUND).round() * _ROUND
        metres = metres_per_unit(crs, origin[None])[0]
        height_metres = mesh.height.metres if mesh.height is not None else 1.0
        x, y = map(float, origin)
        return cls((x, y), (float(metres[0]), float(metres[1])), height_metres)

    def to_local(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points (N, 3) of a TIN."""
        scale = np.array([*self.metres, self.height_metres])
        local: NDArray[np.float64] = (points - np.array([*self.origin, 0.0])) * scale
        return local

    def __str__(self) -> str:
        x, y = self.origin
        return f"metres east and north of x {x:.12g}, y {y:.12g}"


def require_heights(mesh: TriangleMesh, driver: str) -> None:
    """Raise OutputError if a mesh is flat, or none of its triangles has heights."""
    if mesh.height is None or mesh.heights is None:
        raise OutputError(
            f"{driver} needs heights, and the mesh has none: choose the band of heights with `z=1`"
        )
    if not np.isfinite(mesh.heights[mesh.triangles]).all(axis=1).any():
        raise OutputError(f"{driver} needs heights, and no triangle of the mesh has any")


def require_lengths(mesh: TriangleMesh, driver: str) -> None:
    """Raise GeoreferenceError if x and y of a mesh are angles."""
    crs = mesh.grid.crs
    if crs is not None and has_angles(crs):
        zone = _utm_zone(crs, mesh.map_nodes)
        raise GeoreferenceError(
            f"{driver} needs x and y in metres or feet, and those of {crs.name!r} are angles: "
            f"reproject the raster first, for example with gdalwarp {zone}"
        )


def _utm_zone(crs: CRS, places: Points) -> str:
    """Return the option of gdalwarp for the UTM zone in the middle of places on the map."""
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_utm_crs_info

    if is_lonlat(crs):
        degrees = math.degrees(horizontal(crs).axis_info[0].unit_conversion_factor)
        x, y = (places.min(axis=0) + places.max(axis=0)) / 2 * degrees
        around = AreaOfInterest((x + 180) % 360 - 180, y, (x + 180) % 360 - 180, y)
        # Of the same datum if it has zones, so that nothing is shifted.
        for datum in (horizontal(crs).name, "WGS 84"):
            found = query_utm_crs_info(datum_name=datum, area_of_interest=around)
            if found:
                return f"-t_srs {found[0].auth_name}:{found[0].code}"
    return "to a projected CRS"


def tin_layer(mesh: TriangleMesh, name: LayerName) -> Layer:
    """Return the layer of the triangles with heights."""
    layer = Layer.of(mesh, name)
    rows = _with_heights(mesh)
    if len(rows) == len(layer):
        return layer
    return replace(layer, columns=layer.columns.take(rows), vertices=layer.vertices[rows])


def tin_of(mesh: TriangleMesh) -> Tin:
    """Return the triangles of a mesh that have heights; see `require_heights`."""
    assert mesh.heights is not None
    rows = _with_heights(mesh)
    corners = mesh.triangles[rows]
    used = np.zeros(len(mesh.nodes), np.bool_)
    used[corners] = True
    nodes = np.flatnonzero(used)
    points: Points = np.column_stack([mesh.map_nodes[nodes], mesh.heights[nodes]])
    triangles = (np.cumsum(used, dtype=np.int32) - np.int32(1))[corners]
    return Tin(points, triangles, nodes, rows)


def notes_on_voids(mesh: TriangleMesh) -> tuple[str, ...]:
    """Return what to say if triangles have no heights and so are left out."""
    left_out = len(mesh.triangles) - len(_with_heights(mesh))
    if not left_out:
        return ()
    return (f"{left_out} of {len(mesh.triangles)} triangles have no heights and are left out",)


def _with_heights(mesh: TriangleMesh) -> NDArray[np.intp]:
    assert mesh.heights is not None
    return np.flatnonzero(np.isfinite(mesh.heights[mesh.triangles]).all(axis=1))
