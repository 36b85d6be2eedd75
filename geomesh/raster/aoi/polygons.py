"""Polygons of an area of interest: read them from whatever is given, and make them valid."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from pyproj.exceptions import CRSError

from geomesh.errors import GeoreferenceError, SourceError, one_line
from geomesh.raster.crs import LONLAT, full_turn, has_angles, to_pyproj
from geomesh.raster.paths import is_remote, plain_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray
    from pyproj import CRS
    from shapely.geometry.base import BaseGeometry

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

_KINDS = {0: "point", 1: "line"}


@dataclass(frozen=True, eq=False)
class Polygons:
    """Valid polygons in one CRS.

    Parameters
    ----------
    name : str
        How messages call them.
    shape : Polygon or MultiPolygon
        Valid and not empty.
    crs : pyproj.CRS or None
        None if neither they nor the raster have a CRS.
    notes : tuple of str
        What was dropped or repaired, for the user.
    """

    name: str
    shape: BaseGeometry
    crs: CRS | None
    notes: tuple[str, ...] = ()


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
    from_file = is_file(mask)
    if layer is not None and not from_file:
        raise SourceError("`mask_layer` chooses a layer of a file, but `mask` is not a file")
    name = f"mask {fspath(mask)}" if from_file else "the mask"
    shapes, crs = _read_file(fspath(mask), name, layer) if from_file else _read_object(mask)
    shape, notes = _clean(shapes, name)
    own = None if crs is None else _read_crs(crs, name)
    if own is None and from_file and raster_crs is not None:
        notes += (f"{name} has no CRS: its coordinates are taken as those of the raster",)
    known = own or raster_crs
    if known is not None and has_angles(known):
        degrees = 360 / full_turn(known)
        _require_degrees(shape, degrees, known, name)
        notes += _wide_sides(shape, degrees, name)
    return Polygons(name, shape, known, notes)


def is_file(mask: Any) -> bool:
    """Return whether an area is given as the path of a file, and not as text in WKT or GeoJSON."""
    if isinstance(mask, str):
        if not mask.strip():
            raise SourceError("`mask` is empty; give a file of polygons")
        return _WKT.fullmatch(mask) is None and not mask.lstrip().startswith("{")
    return isinstance(mask, PathLike)


def _read_object(mask: Any) -> tuple[NDArray[Any], Any]:
    """Return the geometries of an object or of text, and their CRS."""
    if isinstance(mask, shapely.Geometry):
        return np.array([mask]), None
    if type(mask).__module__.partition(".")[0] == "geopandas":
        try:
            return np.asarray(mask.geometry.array), mask.crs
        except AttributeError as error:
            raise SourceError(
                f"the mask is a {type(mask).__name__} without geometry; choose it with "
                ".set_geometry()"
            ) from error
    wkt = _WKT.fullmatch(mask) if isinstance(mask, str) else None
    if wkt is not None:
        shape = _parse(shapely.from_wkt, wkt["shape"], "WKT")
        return np.array([shape]), int(wkt["code"]) if wkt["code"] else None
    if isinstance(mask, str | Mapping) or hasattr(mask, "__geo_interface__"):
        found: tuple[NDArray[Any], Any] = _parse(_read_geojson, mask, "GeoJSON")
        return found
    raise SourceError(
        f"the mask is a {type(mask).__name__}: give a file, GeoDataFrame, GeoSeries, shapely "
        "geometry, GeoJSON mapping or WKT of polygons"
    )


def _parse(parser: Any, text: Any, kind: str) -> Any:
    try:
        return parser(text)
    except (shapely.GEOSException, ValueError, TypeError, KeyError, AttributeError) as error:
        raise SourceError(f"the mask is not valid {kind} ({one_line(error)})") from error


def _read_geojson(mask: Any) -> tuple[NDArray[Any], Any]:
    """Return the geometries and the CRS of a GeoJSON mapping, of its text, or of an object."""
    if isinstance(mask, str):
        mask = json.loads(mask)
    elif not isinstance(mask, Mapping):
        mask = mask.__geo_interface__
    features = mask.get("features", [mask])
    geometries = [
        feature["geometry"] if feature.get("type") == "Feature" else feature for feature in features
    ]
    texts = [json.dumps(geometry, default=list) for geometry in geometries if geometry is not None]
    crs = (mask.get("crs") or {}).get("properties", {}).get("name", LONLAT)
    return shapely.from_geojson(np.array(texts, object)), crs


def _read_file(path: str, name: str, layer: str | None) -> tuple[NDArray[Any], str | None]:
    """Return the geometries of the layer of a file, and its CRS as GDAL names it."""
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError

    _require_set(path, name)
    source = path if is_remote(path) else plain_name(path)
    try:
        layers = {str(found): kind for found, kind in pyogrio.list_layers(source)}
        chosen = _choose_layer(layers, layer, name)
        # Not read_dataframe: it imports pandas, which takes a quarter of a second.
        about, _, shapes, _ = pyogrio.raw.read(source, layer=chosen, columns=[], force_2d=True)
        found = shapely.from_wkb(shapes)
    except (DataSourceError, DataLayerError, shapely.GEOSException) as error:
        reason = one_line(error) if Path(path).exists() else "no such file; check the path"
        raise SourceError(
            f"{name} cannot be read as a vector file ({reason}); give polygons in a file such as "
            ".gpkg"
        ) from error
    return found, about["crs"]


def _choose_layer(layers: Mapping[str, str | None], layer: str | None, name: str) -> str:
    spatial = [found for found, kind in layers.items() if kind is not None]
    if layer is not None:
        if layer not in spatial:
            raise SourceError(
                f"{name} has no layer {layer!r} of geometries; choose from {_listed(spatial)} with "
                "`mask_layer`"
            )
        return layer
    if not spatial:
        raise SourceError(f"{name} has no geometry; give polygons of the area to keep")
    if len(spatial) > 1:
        raise SourceError(
            f"{name} has several layers, {_listed(spatial)}: choose one with `mask_layer`"
        )
    return spatial[0]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))


def _require_set(path: str, name: str) -> None:
    """Raise an error that names the file that is missing beside a shapefile."""
    file = Path(path)
    if file.suffix.lower() == ".shp" and file.exists():
        beside = {each.name.lower() for each in file.parent.glob(f"{_exactly(file.stem)}.*")}
        missing = f"{file.stem}.shx"
        if missing.lower() not in beside:
            raise SourceError(
                f"{name} is incomplete: its index {missing} is missing; copy it too, or export the "
                "polygons again, as .gpkg"
            )


def _exactly(text: str) -> str:
    """Return a pattern that matches exactly this text."""
    return re.sub(r"([*?[])", r"[\1]", text)


def _read_crs(crs: Any, name: str) -> CRS | None:
    try:
        return to_pyproj(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{name} has a CRS that PROJ cannot read ({one_line(error)}); save it in another CRS"
        ) from error


def _require_degrees(shape: BaseGeometry, degrees: float, crs: CRS, name: str) -> None:
    """Raise an error if coordinates cannot be longitude and latitude, in units of `degrees`."""
    x, y = np.abs(shapely.get_coordinates(shape)).T
    far = np.flatnonzero((x * degrees > _FARTHEST[0]) | (y * degrees > _FARTHEST[1]))
    if len(far):
        where = shapely.get_coordinates(shape)[far[0]]
        raise GeoreferenceError(
            f"{name} is in {crs.name}, but {where[0]:.10g}, {where[1]:.10g} is no longitude and "
            "latitude; check the CRS of the mask (a GeoJSON mapping has none: give a GeoSeries "
            "with a CRS, or a shapely geometry in the raster's coordinates)"
        )


def _clean(shapes: NDArray[Any], name: str) -> tuple[BaseGeometry, tuple[str, ...]]:
    """Return the union of the polygons, and notes about what was dropped and repaired."""
    parts = _parts(shapes[~shapely.is_missing(shapes)])
    parts = parts[~shapely.is_empty(parts)]
    dimensions = shapely.get_dimensions(parts)
    polygons = shapely.force_2d(parts[dimensions == 2])
    if not np.isfinite(shapely.get_coordinates(polygons)).all():
        raise SourceError(f"{name} has coordinates that are not finite numbers; correct them")
    broken = ~shapely.is_valid(polygons)
    if broken.any():
        # One polygon after the other: where two overlap, both count.
        mended = _parts(shapely.make_valid(polygons[broken]))
        polygons = np.concatenate([polygons[~broken], mended[shapely.get_dimensions(mended) == 2]])
    polygons = polygons[shapely.area(polygons) > 0]
    if not len(polygons):
        raise SourceError(f"{name} contains no polygon; give polygons of the area to keep")
    dropped = [_count(int((dimensions == d).sum()), kind) for d, kind in _KINDS.items()]
    notes = []
    if any(dropped):
        notes.append(f"{name}: {' and '.join(filter(None, dropped))} left out, only polygons count")
    if broken.any():
        reason = shapely.is_valid_reason(parts[dimensions == 2][broken][0])
        notes.append(f"{name}: {_count(int(broken.sum()), 'polygon')} repaired ({reason})")
    return shapely.disjoint_subset_union_all(polygons), tuple(notes)


def _parts(shapes: NDArray[Any]) -> NDArray[Any]:
    """Return the points, lines and polygons of geometries and of collections in collections."""
    while (shapely.get_type_id(shapes) >= 4).any():
        shapes = shapely.get_parts(shapes)
    return shapes


def _count(number: int, kind: str) -> str:
    return f"{number} {kind}{'s' if number > 1 else ''}" if number else ""


def _wide_sides(shape: BaseGeometry, degrees: float, name: str) -> tuple[str, ...]:
    """Return a note if sides span more than half a turn, but not the whole turn of a world box."""
    rings = shapely.get_parts(shapely.boundary(shapely.get_parts(shape)))
    lon, ring = shapely.get_coordinates(rings, return_index=True)
    turns = np.abs(np.diff(lon[:, 0]))[np.diff(ring) == 0] * degrees
    wide = turns[(turns > _HALF_TURN) & (turns < 2 * _HALF_TURN - 1)]
    if not len(wide):
        return ()
    return (
        f"{name} has a side that spans {wide.max():.5g} degrees of longitude; if the area crosses "
        "the antimeridian, write longitudes beyond 180 or cut it there",
    )
