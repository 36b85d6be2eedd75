"""The triangles of a mesh for tiles: longitude and latitude, as far as Web Mercator reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import shapely

from geomesh.errors import GeoreferenceError
from geomesh.formats.lonlat import LonLatLayer, lonlat_of
from geomesh.formats.lonlat_poles import check_poles
from geomesh.formats.mercator import LIMIT, to_world
from geomesh.raster.crs import is_on_earth

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Points
    from geomesh.mesh.triangle_mesh import TriangleMesh

_SQUARE = shapely.box(-180, -LIMIT, 180, LIMIT)
_ROWS = 65_536


@dataclass(frozen=True, eq=False, kw_only=True)
class TileLayer(LonLatLayer):
    """The triangles in longitude and latitude, cut at the antimeridian and at 85.05 degrees."""

    def geometry(self, rows: slice) -> pa.Array:
        """Return the WKB of the given rows; what lies beyond Web Mercator is empty."""
        found = super().geometry(rows)
        if (np.abs(self.points[:, 1]) <= LIMIT).all():
            return found
        shapes = shapely.from_wkb(found.to_numpy(zero_copy_only=False))
        south, north = shapely.bounds(shapes)[:, [1, 3]].T
        beyond = (south < -LIMIT) | (north > LIMIT)
        shapes[beyond] = [_areas(shape) for shape in shapely.intersection(shapes[beyond], _SQUARE)]
        return pa.array(shapely.to_wkb(shapes, byte_order=1), pa.binary())

    def rings(self) -> Iterator[Rings]:
        """Yield the outlines of triangles in the unit square, some rows at a time."""
        for start in range(0, len(self), _ROWS):
            wkb = self.geometry(slice(start, start + _ROWS)).to_numpy(zero_copy_only=False)
            yield Rings.of(shapely.from_wkb(wkb), to_world, start)


@dataclass(frozen=True, eq=False)
class Rings:
    """Outlines of polygons.

    Attributes
    ----------
    points : float64 (P, 2)
    starts : int64 (R + 1,)
        Where each ring begins, and the end of the last.
    rows : int64 (R,)
        To which row a ring belongs.
    """

    points: Points
    starts: NDArray[np.int64]
    rows: NDArray[np.int64]

    @classmethod
    def of(
        cls, shapes: NDArray[np.object_], project: Callable[[Points], Points], first: int = 0
    ) -> Rings:
        """Return the rings of polygons and multiple polygons, of rows from `first` on."""
        parts, rows = shapely.get_parts(shapes, return_index=True)
        rings, owners = shapely.get_rings(parts, return_index=True)
        points, of_ring = shapely.get_coordinates(rings, return_index=True)
        counts = np.bincount(of_ring, minlength=len(rings))
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return cls(project(points), starts, rows[owners].astype(np.int64) + first)


def check_crs(crs: CRS | None, what: str) -> CRS:
    """Return the CRS of `what`; GeoreferenceError if there is none or it is not on Earth."""
    if crs is None:
        raise GeoreferenceError(
            f"tiles need a place on Earth, but {what} has no CRS: georeference the raster, or mesh "
            "it with `crs`"
        )
    if not is_on_earth(crs):
        raise GeoreferenceError(
            f"tiles need a place on Earth, and {crs.name!r}, the CRS of {what}, is not on Earth"
        )
    return crs


def require_place(mesh: TriangleMesh) -> Points:
    """Return longitude and latitude of the nodes, in degrees (N, 2).

    Raises
    ------
    GeoreferenceError
        If the mesh has no CRS or one of another celestial body, or lies where a map on the web
        has no place for it.
    """
    crs = check_crs(mesh.grid.crs, "the mesh")
    try:
        lonlat = lonlat_of(crs)(mesh.map_nodes)
        check_poles(mesh)
    except GeoreferenceError as error:
        raise GeoreferenceError(str(error).replace("GeoJSON needs", "tiles need", 1)) from error
    off = np.count_nonzero(np.isnan(lonlat).any(axis=1))
    if off:
        raise GeoreferenceError(
            f"tiles need longitude and latitude, but {off} of {len(lonlat)} nodes have none: "
            "mesh a part of the raster with `bounds` or `mask`"
        )
    if (np.abs(lonlat[:, 1]) > LIMIT).all():
        raise GeoreferenceError(
            f"tiles are in Web Mercator, which ends at {LIMIT:.2f} degrees of latitude, and the "
            "whole mesh lies beyond: write .gpkg instead"
        )
    return lonlat


def _areas(shape: shapely.Geometry) -> shapely.Geometry:
    """Return the parts of a geometry that have an area."""
    parts = shapely.get_parts(shape)
    kept = [part for part in parts if shapely.get_dimensions(part) == 2]
    return kept[0] if len(kept) == 1 else shapely.MultiPolygon(kept)
