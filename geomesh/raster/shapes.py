"""Read geometries from whatever is given: a file, an object of a library, or text."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely
from pyproj.exceptions import CRSError

from geomesh.errors import GeoreferenceError, SourceError, one_line
from geomesh.raster.crs import LONLAT, full_turn, has_angles, to_pyproj
from geomesh.raster.vector_file import Role, read_file

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pyproj import CRS
    from shapely.geometry.base import BaseGeometry

    from geomesh.arrays.types import Points

# WKT of a geometry, perhaps with the code of its CRS in front as PostGIS writes it.
_WKT = re.compile(
    r"\s*(?:SRID=(?P<code>\d+);)?\s*(?P<shape>(?:(?:MULTI)?(?:POINT|LINESTRING|POLYGON)"
    r"|LINEARRING|GEOMETRYCOLLECTION)(?:\s+(?:Z|M|ZM))?\s*(?:\(.*\)|EMPTY))\s*",
    re.IGNORECASE | re.DOTALL,
)

# Limits of longitude and latitude, in degrees: two turns, and a little more than the poles,
# because pixels of a global raster may reach beyond them.
_FARTHEST = (720.0, 100.0)

# A side that changes the longitude by more than this, in degrees, may be meant the short way.
_HALF_TURN = 180.0


@dataclass(frozen=True, eq=False)
class Shapes:
    """Geometries in one CRS.

    Parameters
    ----------
    name : str
        How messages call them.
    shape : shapely geometry
        Not empty.
    crs : pyproj.CRS or None
        None if neither they nor the raster have a CRS.
    notes : tuple of str
        What was dropped or repaired, for the user.
    parameter : str
        The parameter that the user gave them with.
    """

    name: str
    shape: BaseGeometry
    crs: CRS | None
    notes: tuple[str, ...] = ()
    parameter: str = "mask"


class Found(NamedTuple):
    """Geometries as they were found.

    Attributes
    ----------
    name : str
    shapes : array of shapely geometries
    crs : pyproj.CRS or None
    is_file : bool
    """

    name: str
    shapes: NDArray[Any]
    crs: CRS | None
    is_file: bool


def read_shapes(value: Any, layer: str | None, role: Role) -> Found:
    """Return the geometries of a file, an object or a text.

    Raises
    ------
    SourceError
        If it cannot be read, or has several layers and none is chosen.
    GeoreferenceError
        If its CRS is not known.
    """
    from_file = is_file(value, role)
    if layer is not None and not from_file:
        name = role.parameter
        raise SourceError(f"`{name}_layer` chooses a layer of a file, but `{name}` is not a file")
    name = f"{role.parameter} {fspath(value)}" if from_file else role.title
    if from_file:
        shapes, crs = read_file(fspath(value), name, layer, role)
    else:
        shapes, crs = _read_object(value, role)
    own = None if crs is None else _read_crs(crs, name)
    return Found(name, shapes[~shapely.is_missing(shapes)], own, from_file)


def is_file(value: Any, role: Role) -> bool:
    """Return whether geometries are given as the path of a file, not as text in WKT or GeoJSON."""
    if isinstance(value, str):
        if not value.strip():
            raise SourceError(f"`{role.parameter}` is empty; give a file of {role.content}")
        return _WKT.fullmatch(value) is None and not value.lstrip().startswith("{")
    return isinstance(value, PathLike)


def _read_object(value: Any, role: Role) -> tuple[NDArray[Any], Any]:
    """Return the geometries of an object or of text, and their CRS."""
    if isinstance(value, shapely.Geometry):
        return np.array([value]), None
    if type(value).__module__.partition(".")[0] == "geopandas":
        try:
            return np.asarray(value.geometry.array), value.crs
        except AttributeError as error:
            raise SourceError(
                f"{role.title} is a {type(value).__name__} without geometry; choose it with "
                ".set_geometry()"
            ) from error
    wkt = _WKT.fullmatch(value) if isinstance(value, str) else None
    if wkt is not None:
        shape = _parse(shapely.from_wkt, wkt["shape"], f"{role.title} is not valid WKT")
        return np.array([shape]), int(wkt["code"]) if wkt["code"] else None
    if isinstance(value, str | Mapping) or hasattr(value, "__geo_interface__"):
        found: tuple[NDArray[Any], Any]
        found = _parse(_read_geojson, value, f"{role.title} is not valid GeoJSON")
        return found
    raise SourceError(
        f"{role.title} is a {type(value).__name__}: give a file, GeoDataFrame, GeoSeries, shapely "
        f"geometry, GeoJSON mapping or WKT of {role.content}"
    )


def _parse(parser: Any, text: Any, problem: str) -> Any:
    try:
        return parser(text)
    except (shapely.GEOSException, ValueError, TypeError, KeyError, AttributeError) as error:
        raise SourceError(f"{problem} ({one_line(error)})") from error


def _read_geojson(value: Any) -> tuple[NDArray[Any], Any]:
    """Return the geometries and the CRS of a GeoJSON mapping, of its text, or of an object."""
    if isinstance(value, str):
        value = json.loads(value)
    elif not isinstance(value, Mapping):
        value = value.__geo_interface__
    features = value.get("features", [value])
    geometries = [
        feature["geometry"] if feature.get("type") == "Feature" else feature for feature in features
    ]
    texts = [json.dumps(geometry, default=list) for geometry in geometries if geometry is not None]
    crs = (value.get("crs") or {}).get("properties", {}).get("name", LONLAT)
    return shapely.from_geojson(np.array(texts, object)), crs


def _read_crs(crs: Any, name: str) -> CRS | None:
    try:
        return to_pyproj(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{name} has a CRS that PROJ cannot read ({one_line(error)}); save it in another CRS"
        ) from error


def split_parts(shapes: NDArray[Any]) -> NDArray[Any]:
    """Return the points, lines and polygons of geometries and of collections in collections."""
    while (shapely.get_type_id(shapes) >= 4).any():
        shapes = shapely.get_parts(shapes)
    return shapes


def count_of(number: int, kind: str) -> str:
    """Return a number with its noun; empty for 0."""
    return f"{number} {kind}{'s' if number > 1 else ''}" if number else ""


def _require_degrees(points: Points, crs: CRS, name: str, role: Role) -> None:
    """Raise an error if coordinates (N, 2) in an angular CRS cannot be longitude and latitude."""
    degrees = 360 / full_turn(crs)
    x, y = np.abs(points).T
    far = np.flatnonzero((x * degrees > _FARTHEST[0]) | (y * degrees > _FARTHEST[1]))
    if len(far):
        where = points[far[0]]
        raise GeoreferenceError(
            f"{name} is in {crs.name}, but {where[0]:.10g}, {where[1]:.10g} is no longitude and "
            f"latitude; check the CRS of {role.title} (a GeoJSON mapping has none: give a "
            "GeoSeries with a CRS, or a shapely geometry in the raster's coordinates)"
        )


def _wide_sides(points: Points, line: NDArray[np.integer], crs: CRS, name: str) -> tuple[str, ...]:
    """Return a note if sides span more than half a turn, but not the whole turn of a world box.

    Parameters
    ----------
    points : float64 (N, 2)
        In an angular CRS.
    line : int (N,)
        The line of each point.
    """
    turns = np.abs(np.diff(points[:, 0]))[np.diff(line) == 0] * (360 / full_turn(crs))
    wide = turns[(turns > _HALF_TURN) & (turns < 2 * _HALF_TURN - 1)]
    if not len(wide):
        return ()
    return (
        f"{name} has a side that spans {wide.max():.5g} degrees of longitude; if it crosses "
        "the antimeridian, write longitudes beyond 180 or cut it there",
    )


def check_angles(
    points: Points, line: NDArray[np.integer], crs: CRS | None, name: str, role: Role
) -> tuple[str, ...]:
    """Check longitudes and latitudes (N, 2), if `crs` has them, and return notes about them.

    `line` (N,) is the line or ring of each point.
    """
    if crs is None or not has_angles(crs):
        return ()
    _require_degrees(points, crs, name, role)
    return _wide_sides(points, line, crs, name)


def notes_on_crs(found: Found, raster_crs: CRS | None) -> tuple[str, ...]:
    """Return a note if a file has no CRS and its coordinates are taken as the raster's."""
    if found.crs is not None or not found.is_file or raster_crs is None:
        return ()
    return (f"{found.name} has no CRS: its coordinates are taken as those of the raster",)
