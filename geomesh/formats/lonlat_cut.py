"""Cut geometry at the antimeridian and at the poles, as RFC 7946 (section 3.1.9) has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.formats.format import MOST_DECIMALS

if TYPE_CHECKING:
    from geomesh.arrays.types import Points
    from geomesh.formats.arrow import GeometryType

_WORLD = shapely.box(-180, -90, 180, 90)


# A triangle that is the outside of its own ring covers a good part of the world: one that is
# only turned over, as a sliver may be, is smaller than this share of the sphere.
_LEAST_OUTSIDE = 1 / 8


def cut(xy: Points, geometry_type: GeometryType) -> bytes:
    """Return the WKB of a ring or line (V, 2) within -180 to 180 and -90 to 90 degrees.

    Parameters
    ----------
    xy : float64 (V, 2)
        Longitudes go on from vertex to vertex. What a ring holds is to its left: if its last
        longitude is not its first, it holds a pole; and it may hold both.
    geometry_type : {"Polygon", "LineString"}

    Returns
    -------
    bytes
        Rings are counter-clockwise. Pieces are of the given type, or its multiple.
    """
    if geometry_type == "LineString":
        return _joined(_pieces(shapely.LineString(xy)), geometry_type)
    turn = xy[-1, 0] - xy[0, 0]
    if turn != 0:
        # The ring is closed along the pole's line of latitude. It goes around twice, so that one
        # turn from antimeridian to antimeridian can be cut out of it.
        path = np.vstack([xy, xy[1:] + np.array([turn, 0.0])])
        pole = 90.0 * _pole_inside(xy)
        whole = shapely.Polygon([*path, (path[-1, 0], pole), (path[0, 0], pole)])
        origin = 360 * np.ceil((path[:, 0].min() + 180) / 360)
        return _joined(_cut_out(_valid(whole), origin), geometry_type)
    pieces = _pieces(_valid(shapely.Polygon(xy)))
    if _share_of_sphere(xy) < -_LEAST_OUTSIDE:
        pieces = list(shapely.get_parts(shapely.difference(_WORLD, shapely.union_all(pieces))))
    return _joined(pieces, geometry_type)


def _pole_inside(ring: Points) -> int:
    """Return 1 or -1 for the pole that is to the left of a ring (V, 2) around both."""
    side = 1 if ring[-1, 0] > ring[0, 0] else -1
    # No triangle covers nearly all the world: such a ring is turned over.
    return side if 1 / 2 + _share_of_sphere(ring) < 1 - _LEAST_OUTSIDE else -side


def _share_of_sphere(ring: Points) -> float:
    """Return the share between a ring (V, 2) and the equator; positive if that is to its left."""
    lon, height = np.radians(ring[:, 0]), np.sin(np.radians(ring[:, 1]))
    return float(-(np.diff(lon) * (height[1:] + height[:-1])).sum() / (8 * np.pi))


def _pieces(whole: Any) -> list[Any]:
    """Return the parts of a geometry between -180 and 180, after whole turns."""
    west, south, east, north = whole.bounds
    if west >= -180 and east <= 180 and south >= -90 and north <= 90:
        return list(shapely.get_parts(whole))
    first, last = np.floor((np.array([west, east]) + 180) / 360)
    pieces = []
    for origin in 360 * np.arange(first, last + 1):
        pieces += _cut_out(whole, origin)
    if east - west > 360:
        pieces = list(shapely.get_parts(shapely.union_all(pieces)))
    return pieces


def _cut_out(whole: Any, origin: float) -> list[Any]:
    """Return the parts of a geometry within 180 degrees of a longitude, moved by it."""
    box = shapely.box(origin - 180, -90, origin + 180, 90)
    cut_out = shapely.intersection(whole, box)
    # Rounded, because 245.8 - 360 is not quite -114.2.
    moved = shapely.transform(cut_out, lambda at: (at - [origin, 0.0]).round(MOST_DECIMALS))
    # A geometry that only touches the antimeridian leaves a line or a point there: drop it.
    return _parts(shapely.make_valid(moved), shapely.get_dimensions(whole))


def _parts(geometry: Any, dimensions: int) -> list[Any]:
    """Return the parts that have so many dimensions; a collection may hold multiples in turn."""
    parts = shapely.get_parts(shapely.get_parts(geometry))
    return list(parts[(shapely.get_dimensions(parts) == dimensions) & ~shapely.is_empty(parts)])


def _valid(polygon: Any) -> Any:
    """Return a polygon whose sides do not cross: those of a sliver may, where they are curves."""
    if shapely.is_valid(polygon):
        return polygon
    kept = _parts(shapely.make_valid(polygon), 2)
    return shapely.MultiPolygon(kept) if kept else polygon


def _joined(pieces: list[Any], geometry_type: GeometryType) -> bytes:
    if len(pieces) == 1:
        joined = pieces[0]
    elif geometry_type == "LineString":
        joined = shapely.MultiLineString(pieces)
    else:
        joined = shapely.MultiPolygon(pieces)
    encoded: bytes = shapely.to_wkb(shapely.orient_polygons(joined), byte_order=1)
    return encoded
