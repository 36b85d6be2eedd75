"""The layers of a mesh for GeoJSON: longitude and latitude, cut at the antimeridian.

GDAL writes the file, but without its option RFC7946=YES. With that option, GDAL assumes that
a triangle crosses the antimeridian if it has corners within 10 degrees on both sides of it.
Other triangles that cross it, for example near the poles, would reach around the world, and
a triangle that really spans the world would be cut to a sliver. So GDAL gets geometries that
are already cut. It gets no CRS, because RFC 7946 allows only one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from pyproj import Transformer
from pyproj.exceptions import ProjError

from geomesh.arrays.table import Table
from geomesh.errors import GeoreferenceError
from geomesh.formats.arrow import Layer, binary, wkb

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points, Triangles
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

LONLAT = "OGC:CRS84"

# RFC 7946 (section 11.2) recommends 7 decimals, about a centimetre. A longitude in float64
# has 13 decimals.
_DECIMALS = (7, 9, 11, 13)

# Significant digits of attributes: the precision of float32.
_DIGITS = 7

# If the longitude seems to change by more degrees along an edge, the edge is followed in
# steps, to find out in which direction around the Earth it goes.
_SUSPECT_TURN = 90.0
_STEPS = 16


@dataclass(frozen=True, eq=False)
class LonLatLayer(Layer):
    """A layer with `points` in longitude and latitude.

    Inside a geometry, longitudes continue beyond 180 degrees. Then the geometry is cut there.

    Parameters
    ----------
    map_points : float64 (N, 2)
        Node coordinates on the map.
    transformer : pyproj.Transformer, optional
        From the map to longitude and latitude. None if x on the map is a longitude: then
        `points` show in which direction an edge goes.
    decimals : int
        Number of decimals to which coordinates are rounded.
    """

    map_points: Points
    transformer: Transformer | None
    decimals: int

    @classmethod
    def of(cls, mesh: TriangleMesh, name: LayerName) -> LonLatLayer:
        """Return the layer `name` of a mesh.

        Raises
        ------
        GeoreferenceError
            If the mesh has no CRS or one of another celestial body, or if nodes have no
            longitude and latitude (outside the disc of a geostationary image).
        """
        transformer = _transformer(mesh)
        lonlat = np.column_stack(transformer.transform(*mesh.map_nodes.T))
        off = ~np.isfinite(lonlat).all(axis=1) | (np.abs(lonlat[:, 1]) > 90)
        if off.any():
            raise GeoreferenceError(
                "GeoJSON needs longitude and latitude, but "
                f"{np.count_nonzero(off)} of {len(off)} nodes have none: leave them out with "
                "`bounds` or `mask`, or write .gpkg"
            )
        layer = Layer.of(mesh, name)
        crs = mesh.grid.crs
        geographic = crs is not None and crs.is_geographic
        if crs is not None and geographic:
            degrees = np.degrees(crs.axis_info[0].unit_conversion_factor)
            lonlat[:, 0] += _whole_turns(mesh.map_nodes[:, 0] * degrees - lonlat[:, 0])
        return cls(
            name,
            Table({name: _rounded(values) for name, values in layer.columns.items()}),
            lonlat,
            layer.vertices,
            layer.geometry_type,
            map_points=mesh.map_nodes,
            transformer=None if geographic else transformer,
            decimals=enough_decimals(lonlat, mesh.triangles),
        )

    def geometry(self, rows: slice) -> pa.Array:
        """Return the WKB of the given rows; rings are counter-clockwise."""
        xy = self.points[self.vertices[rows]]
        turns = _whole_turns(self._unrolled(self.vertices[rows]) - xy[..., 0])
        middle = ((xy[..., 0] + turns).min(axis=1) + (xy[..., 0] + turns).max(axis=1)) / 2
        xy[..., 0] += turns - _whole_turns(middle)[:, None]
        xy = xy.round(self.decimals)
        lon = xy[..., 0]
        around = np.zeros(len(xy), np.bool_)
        if self.geometry_type == "Polygon":
            around = lon[:, 0] != lon[:, -1]
            # A side that is straight on the map may be a curve here: a sliver can flip over.
            clockwise = _orientation(xy) < 0
            xy[clockwise] = xy[clockwise][:, ::-1]
        cut = np.flatnonzero((np.abs(lon) > 180).any(axis=1) | around)
        pieces = {int(row): _cut(xy[row], self.geometry_type) for row in cut}
        return binary(wkb(xy, self.geometry_type), pieces)

    def _unrolled(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return longitudes (R, V) that continue from vertex to vertex, without jumps at 180."""
        lon = self.points[:, 0][nodes]
        start, stop = nodes[:, :-1], nodes[:, 1:]
        turn = lon[:, 1:] - lon[:, :-1]
        if self.transformer is not None:
            suspect = np.abs(turn) > _SUSPECT_TURN
            turn[suspect] = self._turn_along(start[suspect], stop[suspect], turn[suspect])
        return np.column_stack([lon[:, :1], lon[:, :1] + np.cumsum(turn, axis=1)])

    def _turn_along(
        self, start: NDArray[np.int32], stop: NDArray[np.int32], turn: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the change of longitude along edges that are straight on the map.

        An edge is followed in the same direction for both of its triangles, so they agree.
        """
        assert self.transformer is not None
        low, high = np.minimum(start, stop), np.maximum(start, stop)
        part = np.linspace(0, 1, _STEPS + 1)[:, None, None]
        path = self.map_points[low] * (1 - part) + self.map_points[high] * part
        lon, _ = self.transformer.transform(path[..., 0], path[..., 1])
        steps = np.diff(lon, axis=0)
        total = (steps - _whole_turns(steps)).sum(axis=0) * np.where(start < stop, 1, -1)
        short = turn - _whole_turns(turn)
        followed: NDArray[np.float64] = np.where(np.isfinite(total), total, short)
        return followed


def _rounded(values: NDArray[Any]) -> NDArray[Any]:
    """Return floats rounded to `_DIGITS` significant digits: half as much data to load."""
    if values.dtype.kind != "f":
        return values
    sizes = np.abs(values, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        places = _DIGITS - 1 - np.floor(np.log10(sizes))
    scale = 10.0 ** np.clip(np.where(np.isfinite(places), places, 0), -300, 300)
    rounded: NDArray[np.float64] = np.rint(values * scale) / scale
    return rounded


def enough_decimals(lonlat: Points, triangles: Triangles) -> int:
    """Return the number of decimals with which no triangle collapses.

    It is the smallest of 7, 9, 11 and 13 with which rounding neither flips a triangle nor
    makes it flat.
    """
    before = _orientation(_short_way(lonlat[triangles]))
    for places in _DECIMALS:
        if (_orientation(_short_way(lonlat.round(places)[triangles])) == before).all():
            return places
    return _DECIMALS[-1]


def _transformer(mesh: TriangleMesh) -> Transformer:
    crs = mesh.grid.crs
    if crs is None:
        raise GeoreferenceError(
            "GeoJSON needs longitude and latitude, but the mesh has no CRS: "
            "georeference the raster, or write .gpkg"
        )
    try:
        # PROJ itself refuses a transformation between two celestial bodies.
        return Transformer.from_crs(crs, LONLAT, always_xy=True)
    except ProjError as error:
        raise GeoreferenceError(
            "GeoJSON needs longitude and latitude on Earth, but there is no transformation from "
            f"{crs.name!r} to them: write .gpkg"
        ) from error


def _whole_turns(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nearest multiple of 360; for -180 and for 180 it is 0."""
    turns: NDArray[np.float64] = 360 * np.round(degrees / 360)
    return turns


def _short_way(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the longitudes of (T, 3, 2) to within 180 degrees of the first corner, in place."""
    lon = corners[..., 0]
    lon -= _whole_turns(lon - lon[:, :1])
    return corners


def _orientation(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 if the first three corners are counter-clockwise, -1 if clockwise, else 0."""
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, k] - corners[:, 0], 1, 0) for k in (1, 2))
    orientation: NDArray[np.float64] = np.sign(ax * by - ay * bx)
    return orientation


def _cut(xy: NDArray[np.float64], geometry_type: str) -> Any:
    """Return the WKB of a geometry that leaves the range -180 to 180, or contains a pole."""
    turns: tuple[float, ...] = (-360, 0, 360)
    if geometry_type == "LineString":
        whole = shapely.LineString(xy)
    elif xy[0, 0] == xy[-1, 0]:
        whole = shapely.Polygon(xy)
    else:
        # A ring around a pole is closed along the line of latitude 90. The ring goes around
        # twice, so that one turn from antimeridian to antimeridian can be cut out of it.
        path = np.vstack([xy, xy[1:] + np.array([xy[-1, 0] - xy[0, 0], 0])])
        pole = np.copysign(90.0, xy[:, 1].sum())
        whole = shapely.Polygon([*path, (path[-1, 0], pole), (path[0, 0], pole)])
        turns = (360 * np.ceil((path[:, 0].min() + 180) / 360),)
    parts = []
    for turn in turns:
        part = shapely.intersection(whole, shapely.box(turn - 180, -90, turn + 180, 90))
        # A geometry that only touches the antimeridian leaves a line or a point there: drop it.
        pieces = [
            piece
            for piece in shapely.get_parts(part)
            if piece.geom_type == whole.geom_type and not piece.is_empty
        ]
        parts += list(shapely.transform(pieces, lambda at, turn=turn: at - (turn, 0)))
    if len(parts) == 1:
        joined = parts[0]
    elif geometry_type == "LineString":
        joined = shapely.MultiLineString(parts)
    else:
        joined = shapely.MultiPolygon(parts)
    return shapely.to_wkb(shapely.orient_polygons(joined), byte_order=1)
