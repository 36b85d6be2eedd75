"""Crop a scene to a box on the map or to an area of interest."""

from __future__ import annotations

import math
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from pyproj.exceptions import ProjError

from geomesh.errors import EmptyError, GeoreferenceError, SourceError
from geomesh.raster.grid import Grid, Window, snap

if TYPE_CHECKING:
    import geopandas as gpd
    from shapely.geometry.base import BaseGeometry

    from geomesh.raster.scene import Scene

# A side of a box this close to a pixel border (in pixels) lies on it: rounding adds no pixel.
_SNAP = 1e-6

# A picture shows only the middle of a larger scene, at full resolution, so that details are
# visible. Both in pixels: the limit, and the size of the middle.
LARGEST_SIDE = 2048
SHOWN_SIDE = 1024

# Start of the CRS name that a GeoPackage gives to a layer without a CRS.
_UNDEFINED = "Undefined"


def restrict(
    scene: Scene,
    *,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
) -> Scene:
    """Return the scene cropped to `bounds` and `mask`; see `geomesh.raster.open.open_scene`."""
    area: BaseGeometry | None = None
    window = scene.grid.extent
    if bounds is not None:
        if len(bounds) != 4:
            raise GeoreferenceError(f"bounds is {bounds!r}: expected west, south, east, north")
        west, south, east, north = bounds
        if not (-math.inf < west < east < math.inf and -math.inf < south < north < math.inf):
            raise GeoreferenceError(
                f"bounds are {west:.10g} {south:.10g} {east:.10g} {north:.10g}: expected "
                "west < east and south < north, in the raster's CRS"
            )
        box = shapely.box(west, south, east, north)
        window = _around(scene, box, window, "`bounds`")
        area = None if scene.grid.is_rectilinear else box
    if mask is not None:
        polygons = _polygons(mask, scene)
        window = _around(scene, polygons, window, "`mask`")
        area = polygons if area is None else shapely.intersection(area, polygons)
        if area.is_empty:
            raise EmptyError(
                f"`bounds` and `mask` do not overlap on {scene.name}; change one of them"
            )
    if area is not None:
        corner = np.array([scene.window.col, scene.window.row])
        area = shapely.transform(area, lambda xy: snap(scene.grid.to_pixel(xy) + corner))
    return scene.crop(window, area)


def _around(scene: Scene, area: BaseGeometry, window: Window, parameter: str) -> Window:
    """Return the smallest part of `window` that contains `area`."""
    corners = scene.grid.to_pixel(shapely.get_coordinates(area))
    (left, top), (right, bottom) = corners.min(axis=0) + _SNAP, corners.max(axis=0) - _SNAP
    col, row = math.floor(left), math.floor(top)
    cropped = Window(col, row, math.ceil(right) - col, math.ceil(bottom) - row).clip(window)
    if cropped.width < 1 or cropped.height < 1:
        edges = " ".join(f"{value:.10g}" for value in scene.grid.bounds())
        raise EmptyError(
            f"{parameter} lies outside {scene.name}, whose bounds are {edges} in "
            f"{scene.grid.crs.to_string() if scene.grid.crs else 'pixels'}"
        )
    return cropped


def _polygons(mask: Any, scene: Scene) -> BaseGeometry:
    """Return the mask's polygons as one geometry in the scene's CRS."""
    name = f"mask {mask}" if isinstance(mask, str | PathLike) else "the mask"
    shapes = _shapes(mask, name)
    shapes = shapes[shapes.geom_type.isin(["Polygon", "MultiPolygon"]) & ~shapes.is_empty]
    if shapes.empty:
        raise SourceError(f"{name} contains no polygon; give polygons of the area to keep")
    grid: Grid = scene.grid
    if shapes.crs is not None and shapes.crs.name.startswith(_UNDEFINED):
        shapes = shapes.set_crs(None, allow_override=True)
    if shapes.crs is not None and grid.crs is None:
        raise GeoreferenceError(
            f"{name} is in {shapes.crs.to_string()} but {scene.name} has no CRS; "
            "georeference the raster, or give a mask without a CRS in the raster's coordinates"
        )
    if shapes.crs is not None:
        try:
            shapes = shapes.to_crs(grid.crs)
        except ProjError as error:
            raise GeoreferenceError(
                f"{name} is in the CRS {shapes.crs.name!r}, which cannot be transformed to the "
                f"CRS of {scene.name}; reproject the mask first"
            ) from error
    if not np.isfinite(shapes.total_bounds).all():
        raise GeoreferenceError(
            f"{name} has coordinates that cannot be transformed to the CRS of {scene.name}; "
            "check the CRS of the mask"
        )
    return shapes.make_valid().union_all()


def _shapes(mask: Any, name: str) -> gpd.GeoSeries:
    # Imported here because it takes 0.25 seconds (with pandas) and only masks need it.
    import geopandas as gpd
    import pyogrio
    from pyogrio.errors import DataSourceError

    if isinstance(mask, str | PathLike):
        try:
            # Not read_dataframe: pyogrio may have been imported before geopandas, without it.
            about, _, shapes, _ = pyogrio.raw.read(mask, columns=[])
        except DataSourceError as error:
            raise SourceError(
                f"{name} cannot be read as a vector file; give polygons in a file such as .gpkg"
            ) from error
        if shapes is not None:
            return gpd.GeoSeries(shapely.from_wkb(shapes), crs=about["crs"])
    if isinstance(mask, gpd.GeoDataFrame | gpd.GeoSeries):
        return gpd.GeoSeries(mask.geometry)
    raise SourceError(f"{name} has no geometry; give a file, GeoDataFrame or GeoSeries of polygons")


def middle(scene: Scene) -> Scene:
    """Return the scene, or its middle if it is too large for a picture."""
    width, height = scene.grid.width, scene.grid.height
    if max(width, height) <= LARGEST_SIDE:
        return scene
    w, h = min(width, SHOWN_SIDE), min(height, SHOWN_SIDE)
    return scene.crop(Window((width - w) // 2, (height - h) // 2, w, h), scene.area)
