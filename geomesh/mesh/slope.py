"""Slope, aspect and area of the triangles of a surface in space."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.table import blocks

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Points, Triangles

# Columns of the triangles of a mesh with heights.
SLOPE_COLUMNS = ("slope", "aspect", "area_3d")


class Slopes(NamedTuple):
    """What the planes of triangles are like; NaN where a corner has no height.

    Attributes
    ----------
    slope : float64 (T,)
        Angle with the horizontal, in degrees: 0 to 90.
    aspect : float64 (T,)
        Direction in which the plane falls, in degrees clockwise from the top of the map (north):
        0 to 360. NaN if it is horizontal.
    stretch : float64 (T,)
        Area in space over area on the map: at least 1.
    """

    slope: Floats
    aspect: Floats
    stretch: Floats


def measure_slopes(points: Points, heights: Floats, triangles: Triangles, metres: Floats) -> Slopes:
    """Return slope and aspect of triangles.

    Parameters
    ----------
    points : float64 (N, 2)
        Map coordinates of the nodes.
    heights : float64 (N,)
        In metres.
    triangles : int (T, 3)
    metres : float64 (T, 2)
        Metres for a unit of x and of y, at each triangle.
    """
    slope, aspect, stretch = np.empty((3, len(triangles)))
    for block in blocks(len(triangles)):
        corners = triangles[block]
        side = (points[corners[:, 1:]] - points[corners[:, :1]]) * metres[block][:, None]
        rise = heights[corners[:, 1:]] - heights[corners[:, :1]]
        (ux, uy), (vx, vy) = np.moveaxis(side, -1, 1).transpose(2, 1, 0)
        doubled = ux * vy - uy * vx
        east = (rise[:, 0] * vy - rise[:, 1] * uy) / doubled
        north = (rise[:, 1] * ux - rise[:, 0] * vx) / doubled
        steepness = np.hypot(east, north)
        slope[block] = np.degrees(np.arctan(steepness))
        falling = np.degrees(np.arctan2(-east, -north)) % 360.0
        falling[falling == 360.0] = 0.0  # of an angle just below 0
        aspect[block] = np.where(steepness > 0, falling, np.nan)
        stretch[block] = np.hypot(1.0, steepness)
    return Slopes(slope, aspect, stretch)


def slope_columns(
    points: Points, heights: Floats, triangles: Triangles, metres: Floats, areas: Floats
) -> dict[str, Floats]:
    """Return the columns `SLOPE_COLUMNS`; `areas` (T,) are those on the map."""
    slopes = measure_slopes(points, heights, triangles, metres)
    measured = (slopes.slope, slopes.aspect, areas * slopes.stretch)
    return dict(zip(SLOPE_COLUMNS, measured, strict=True))
