"""Lines inside the triangles of a mesh for GeoJSON: longitude and latitude, cut where they must."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.errors import GeoreferenceError
from geomesh.formats.lonlat import crs_on_earth, is_distorted, lonlat_of
from geomesh.formats.lonlat_cut import cut
from geomesh.formats.lonlat_paths import Follower, whole_turns
from geomesh.formats.lonlat_poles import check_poles
from geomesh.formats.lonlat_precision import DECIMALS
from geomesh.raster.crs import is_lonlat

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh


def to_lonlat_lines(mesh: TriangleMesh, lines: NDArray[Any]) -> NDArray[Any]:
    """Return level lines in longitude and latitude, as RFC 7946 has them.

    They get points where a straight line of the map is a curve, and are cut at the antimeridian
    and at the poles. Coordinates have 7 decimals, or more if a line would become a point.

    Parameters
    ----------
    mesh : TriangleMesh
    lines : array of LineString Z (K,)
        On the map. All vertices of a line have the same height.

    Raises
    ------
    GeoreferenceError
        If the mesh has no CRS or one of another celestial body, or if vertices have no longitude
        and latitude.
    """
    crs = crs_on_earth(mesh)
    check_poles(mesh)
    if not len(lines):
        return lines
    to_lonlat = lonlat_of(crs)
    places, line = shapely.get_coordinates(lines, include_z=True, return_index=True)
    level = places[np.searchsorted(line, np.arange(len(lines))), 2]
    lonlat = to_lonlat(places[:, :2])
    off = np.count_nonzero(np.isnan(lonlat).any(axis=1))
    if off:
        raise GeoreferenceError(
            f"GeoJSON needs longitude and latitude, but {off} of {len(lonlat)} vertices of the "
            "contours have none: write .gpkg"
        )
    if is_lonlat(crs) and not is_distorted(mesh, to_lonlat(mesh.map_nodes)):
        unrolled = _unrolled(lonlat, line)
    else:
        unrolled, line = _followed(mesh, places[:, :2], lonlat, line)
    decimals = next((some for some in DECIMALS if _extents(unrolled, line, some).all()), 13)
    rounded = unrolled.round(decimals)
    return _cut(rounded, line, level)


def _unrolled(lonlat: Points, line: Counts) -> Points:
    """Return places whose longitudes go on from vertex to vertex, in a turn that suits a line."""
    steps = np.diff(lonlat[:, 0])
    return _continued(lonlat, steps - whole_turns(steps), line)


def _continued(lonlat: Points, steps: Floats, line: Counts) -> Points:
    """Return places (P, 2) with longitudes that change by the steps (P - 1,) along lines."""
    begins = np.flatnonzero(np.diff(line, prepend=-1))
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    number = np.cumsum(np.diff(line, prepend=line[0]) != 0)
    lon = lonlat[begins, 0][number] + (gone - gone[begins][number])
    middle = (np.minimum.reduceat(lon, begins) + np.maximum.reduceat(lon, begins)) / 2
    lon -= whole_turns(middle)[number]
    # The steps only say in which turn a vertex is: their sum has lost digits.
    return np.column_stack([lonlat[:, 0] + whole_turns(lon - lonlat[:, 0]), lonlat[:, 1]])


def _followed(
    mesh: TriangleMesh, places: Points, lonlat: Points, line: Counts
) -> tuple[Points, Counts]:
    """Return places with points where the lines are curves, and the line of each."""
    to_lonlat = lonlat_of(crs_on_earth(mesh))
    of_mesh = Follower.of(
        mesh.map_nodes, to_lonlat(mesh.map_nodes), mesh.nodes, mesh.triangles, to_lonlat
    )
    follower = Follower(places, lonlat, mesh.grid.to_pixel(places), to_lonlat, of_mesh.pixel)
    begin = np.flatnonzero(line[1:] == line[:-1])
    paths = follower.follow(begin, begin + 1)
    steps = np.zeros(len(places) - 1)
    steps[begin] = paths.turn
    unrolled = _continued(lonlat, steps, line)
    # The points of a side come after the vertex at which it begins.
    owner = np.repeat(begin, np.diff(paths.offsets))
    shift = whole_turns(unrolled[owner, 0] - lonlat[owner, 0])
    inner = paths.inner + np.column_stack([shift, np.zeros(len(shift))])
    return np.insert(unrolled, owner + 1, inner, axis=0), np.insert(line, owner + 1, line[owner])


def _extents(places: Points, line: Counts, decimals: int) -> Floats:
    """Return how far lines reach when they are rounded: 0 for one that has become a point."""
    begins = np.flatnonzero(np.diff(line, prepend=-1))
    rounded = places.round(decimals)
    reach: Floats = (
        np.maximum.reduceat(rounded, begins) - np.minimum.reduceat(rounded, begins)
    ).max(axis=1)
    return reach


def _cut(places: Points, line: Counts, level: Floats) -> NDArray[Any]:
    """Return lines with heights, cut where they leave -180 to 180 or -90 to 90 degrees."""
    kept = np.ones(len(places), np.bool_)
    kept[1:] = (places[1:] != places[:-1]).any(axis=1) | (line[1:] != line[:-1])
    single = np.bincount(line[kept], minlength=len(level)) < 2
    kept |= single[line]  # a line that no digits can tell from a point
    places, line = places[kept], line[kept]
    whole: NDArray[Any] = shapely.linestrings(np.column_stack([places, level[line]]), indices=line)
    beyond = np.flatnonzero(
        np.bincount(line, (np.abs(places) > (180, 90)).any(axis=1), minlength=len(level))
    )
    for k in beyond.tolist():
        pieces = shapely.from_wkb(cut(places[line == k], "LineString"))
        whole[k] = shapely.force_3d(pieces, z=level[k])
    return whole
