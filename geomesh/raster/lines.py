"""Lines that become edges of a mesh: read them, and bring them to the pixels of a raster."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.errors import SourceError
from geomesh.raster.aoi.placed import Placed
from geomesh.raster.aoi.trace import LONGEST_PIECE, follow
from geomesh.raster.shapes import (
    Found,
    Shapes,
    check_angles,
    count_of,
    notes_on_crs,
    read_shapes,
    split_parts,
)
from geomesh.raster.vector_file import Role

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Points
    from geomesh.raster.scene import Scene

_BREAKLINES = Role("breaklines", "`breaklines`", "lines or polygons")


@dataclass(frozen=True, eq=False)
class PixelLines:
    """Lines on the pixels of a raster.

    Parameters
    ----------
    name : str
        What they were read from.
    lines : array of shapely LineString
        In pixel-edge coordinates. They may cross, and leave the raster.
    digest : str
        The same for the same coordinates in the same CRS.
    notes : tuple of str
        Warnings for the user.
    """

    name: str
    lines: NDArray[Any]
    digest: str
    notes: tuple[str, ...] = ()


def read_lines(value: Any, scene: Scene, layer: str | None = None) -> PixelLines:
    """Return lines, and the rings of polygons, on the pixels of a scene.

    Parameters
    ----------
    value : path, GeoDataFrame, GeoSeries, shapely geometry, GeoJSON mapping, or str of WKT
        A geometry without a CRS is in the raster's coordinates. A mapping without a "crs" is in
        longitude and latitude.
    scene : Scene
    layer : str, optional
        The layer of a file that has several.

    Raises
    ------
    SourceError
        If it cannot be read, contains no line, or has several layers and none is chosen.
    GeoreferenceError
        If its CRS is not known, or there is no transformation from it to that of the raster.
    """
    found = read_shapes(value, layer, _BREAKLINES)
    lines, notes = _lines(found)
    known = found.crs or scene.grid.crs
    points, line = shapely.get_coordinates(lines, return_index=True)
    if not np.isfinite(points).all():
        raise SourceError(f"{found.name} has coordinates that are not finite numbers; correct them")
    notes += notes_on_crs(found, scene.grid.crs)
    notes += check_angles(points, line, known, found.name, _BREAKLINES)
    shape = shapely.multilinestrings(lines)
    placed = Placed.of(
        Shapes(found.name, shape, known, parameter="breaklines"), scene.grid, scene.name
    )
    crs = "" if known is None else known.to_wkt()
    digest = hashlib.sha256(crs.encode() + points.tobytes() + line.tobytes()).hexdigest()
    pieces = [each for each in _located(placed, points, line) if len(each)]
    located = np.concatenate(pieces) if pieces else np.empty(0, object)
    name = found.name.removeprefix("breaklines ") if found.is_file else found.name.strip("`")
    return PixelLines(name, located, digest, notes)


def _lines(found: Found) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Return the lines among the geometries and the rings of polygons, and a note about points."""
    parts = split_parts(found.shapes)
    parts = shapely.force_2d(parts[~shapely.is_empty(parts)])
    dimensions = shapely.get_dimensions(parts)
    rings = shapely.get_rings(parts[dimensions == 2])
    lines = np.concatenate([parts[dimensions == 1], rings])
    if not len(lines):
        raise SourceError(f"{found.name} contains no line; give {_BREAKLINES.content}")
    points = count_of(int((dimensions == 0).sum()), "point")
    return lines, ((f"{found.name}: {points} left out, only lines count",) if points else ())


def _located(placed: Placed, points: Points, line: Counts) -> Iterator[NDArray[Any]]:
    """Yield the lines in pixels, for each turn that brings them to the grid."""
    size = np.array([placed.grid.width, placed.grid.height], np.float64)
    for turn in placed.turns():

        def locate(xy: Points, turn: float = turn) -> Points:
            return placed.to_pixel(xy, turn)

        if placed.transformer is None:
            yield shapely.linestrings(locate(points), indices=line)
            continue
        same = np.diff(line) == 0
        begins, ends, places = follow(points[:-1][same], points[1:][same], locate, size)
        short = np.hypot(*(ends - begins).T) <= LONGEST_PIECE
        order = np.flatnonzero(short)[np.argsort(places[short], kind="stable")]
        yield _joined(begins[order], ends[order])


def _joined(begins: Points, ends: Points) -> NDArray[Any]:
    """Join consecutive pieces to lines, where one begins exactly where the one before ends."""
    if not len(begins):
        return np.empty(0, object)
    broken = (begins[1:] != ends[:-1]).any(axis=1)
    number = np.concatenate([[0], np.cumsum(broken)])
    last = np.append(broken, True)
    # A line has the begins of its pieces, and the end of its last one.
    points = np.insert(begins, np.flatnonzero(last) + 1, ends[last], axis=0)
    numbers = np.insert(number, np.flatnonzero(last) + 1, number[last])
    return np.asarray(shapely.linestrings(points, indices=numbers))
