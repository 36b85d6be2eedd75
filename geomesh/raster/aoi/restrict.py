"""Restrict a scene to an area of interest: to a box on the map, to polygons, or to both."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import shapely

from geomesh.errors import EmptyError, GeoreferenceError
from geomesh.raster.aoi.polygons import Polygons, read_polygons
from geomesh.raster.crs import crs_label, full_turn, has_angles

if TYPE_CHECKING:
    from geomesh.raster.aoi.burn import Burnt
    from geomesh.raster.grid import Grid
    from geomesh.raster.scene import Scene


def restrict(
    scene: Scene,
    *,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    mask_layer: str | None = None,
) -> Scene:
    """Return the scene cropped to `bounds` and `mask`; see `geomesh.raster.open.open_scene`.

    The scene is a whole raster. The pixels that are kept are those whose centres lie in both.
    """
    from geomesh.raster.aoi.burn import burn  # imports OpenCV, which takes a tenth of a second

    areas = {}
    if bounds is not None:
        areas["`bounds`"] = _box(bounds, scene.grid)
    if mask is not None:
        areas["`mask`"] = read_polygons(mask, scene.grid.crs, mask_layer)
    burnt = burn(list(areas.values()), scene.grid, scene.name)
    if burnt.window.width == 0:
        raise EmptyError(_why_empty(areas, burnt, scene))
    notes = tuple(note for area in areas.values() for note in area.notes)
    return replace(scene.crop(burnt.window, burnt.mask), notes=(*scene.notes, *notes))


def _box(bounds: tuple[float, float, float, float], grid: Grid) -> Polygons:
    if len(bounds) != 4:
        raise GeoreferenceError(f"bounds is {bounds!r}: expected west, south, east, north")
    west, south, east, north = bounds
    if east < west and grid.crs is not None and has_angles(grid.crs):
        east += full_turn(grid.crs)  # a box across the antimeridian, as in RFC 7946, section 5.2
    if not (-math.inf < west < east < math.inf and -math.inf < south < north < math.inf):
        raise GeoreferenceError(
            f"bounds are {' '.join(f'{value:.10g}' for value in bounds)}: expected west < east and "
            "south < north, in the raster's CRS"
        )
    return Polygons("the box", shapely.box(west, south, east, north), grid.crs)


def _why_empty(areas: dict[str, Polygons], burnt: Burnt, scene: Scene) -> str:
    """Return why no pixel is in the areas, and the way out."""
    from geomesh.raster.aoi.burn import burn

    grid = scene.grid
    empty = (name for name, area in areas.items() if not burn([area], grid, "").window.width)
    parameter = next(empty, None)
    if parameter is None:
        return f"`bounds` and `mask` do not overlap on {scene.name}; change one of them"
    if burnt.touched:
        return (
            f"{parameter} contains no centre of a pixel of {scene.name}, whose pixels are "
            f"{abs(grid.transform.a):.5g} map units wide; give a larger area"
        )
    edges = " ".join(f"{value:.10g}" for value in grid.bounds())
    crs = crs_label(grid.crs) if grid.crs else "pixels"
    return f"{parameter} lies outside {scene.name}, whose bounds are {edges} in {crs}"
