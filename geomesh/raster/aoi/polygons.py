"""Polygons of an area of interest: read them from whatever is given, and make them valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.errors import SourceError
from geomesh.raster.shapes import (
    Shapes,
    check_angles,
    count_of,
    notes_on_crs,
    read_shapes,
    split_parts,
)
from geomesh.raster.vector_file import Role

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pyproj import CRS
    from shapely.geometry.base import BaseGeometry

_MASK = Role("mask", "the mask", "polygons")
_KINDS = {0: "point", 1: "line"}


@dataclass(frozen=True, eq=False)
class Polygons(Shapes):
    """Valid polygons in one CRS: `shape` is a Polygon or a MultiPolygon."""


def read_polygons(mask: Any, raster_crs: CRS | None, layer: str | None = None) -> Polygons:
    """Return the polygons of an area of interest.

    Parameters
    ----------
    mask : path, GeoDataFrame, GeoSeries, shapely geometry, GeoJSON mapping, or str of WKT
        A shapely geometry and WKT are in coordinates of the raster, unless WKT begins with
        "SRID=4326;" or the like. A mapping without a "crs" is in longitude and latitude.
    raster_crs : pyproj.CRS or None
        The CRS of an area that has none.
    layer : str, optional
        The layer of a file that has several.

    Raises
    ------
    SourceError
        If it cannot be read, contains no polygon, or has several layers and none is chosen.
    GeoreferenceError
        If its CRS is not known.
    """
    found = read_shapes(mask, layer, _MASK)
    shape, notes = _clean(found.shapes, found.name)
    known = found.crs or raster_crs
    rings = shapely.get_parts(shapely.boundary(shapely.get_parts(shape)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    notes += notes_on_crs(found, raster_crs)
    notes += check_angles(points, ring, known, found.name, _MASK)
    return Polygons(found.name, shape, known, notes)


def _clean(shapes: NDArray[Any], name: str) -> tuple[BaseGeometry, tuple[str, ...]]:
    """Return the union of the polygons, and notes about what was dropped and repaired."""
    parts = split_parts(shapes)
    parts = parts[~shapely.is_empty(parts)]
    dimensions = shapely.get_dimensions(parts)
    polygons = shapely.force_2d(parts[dimensions == 2])
    if not np.isfinite(shapely.get_coordinates(polygons)).all():
        raise SourceError(f"{name} has coordinates that are not finite numbers; correct them")
    broken = ~shapely.is_valid(polygons)
    if broken.any():
        # One polygon after the other: where two overlap, both count.
        mended = split_parts(shapely.make_valid(polygons[broken]))
        polygons = np.concatenate([polygons[~broken], mended[shapely.get_dimensions(mended) == 2]])
    polygons = polygons[shapely.area(polygons) > 0]
    if not len(polygons):
        raise SourceError(f"{name} contains no polygon; give polygons of the area to keep")
    dropped = [count_of(int((dimensions == d).sum()), kind) for d, kind in _KINDS.items()]
    notes = []
    if any(dropped):
        notes.append(f"{name}: {' and '.join(filter(None, dropped))} left out, only polygons count")
    if broken.any():
        reason = shapely.is_valid_reason(parts[dimensions == 2][broken][0])
        notes.append(f"{name}: {count_of(int(broken.sum()), 'polygon')} repaired ({reason})")
    return shapely.disjoint_subset_union_all(polygons), tuple(notes)
