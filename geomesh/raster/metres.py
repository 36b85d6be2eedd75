"""Metres for the units of a CRS: of its x and y at a place, and of its heights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.raster.crs import has_angles, horizontal

if TYPE_CHECKING:
    from pyproj import CRS

    from geomesh.arrays.types import Floats, Points


def metres_per_unit(crs: CRS | None, places: Points) -> Floats:
    """Return how many metres a step of one unit in x and in y is, at places on the map.

    Where x and y are angles it depends on the latitude: the radius of the parallel, and that of
    the meridian's curvature, on the ellipsoid of the CRS, of whatever planet. In a projected CRS
    it is the size of the unit; the distortion of the projection is left out. Without a CRS it
    is 1.

    Parameters
    ----------
    crs : pyproj.CRS, optional
    places : float64 (P, 2)
        Map coordinates.

    Returns
    -------
    float64 (P, 2)
    """
    if crs is None:
        return np.ones((len(places), 2))
    plain = horizontal(crs)
    # 0 stands for an unknown unit.
    units = np.array([axis.unit_conversion_factor or 1.0 for axis in plain.axis_info[:2]])
    if not has_angles(plain) or plain.ellipsoid is None:
        return np.tile(units, (len(places), 1))
    semi_major, semi_minor = plain.ellipsoid.semi_major_metre, plain.ellipsoid.semi_minor_metre
    latitude = np.clip(places[:, 1] * units[1], -np.pi / 2, np.pi / 2)
    squared = 1 - (semi_minor / semi_major) ** 2
    root = np.sqrt(1 - squared * np.sin(latitude) ** 2)
    east = semi_major * np.cos(latitude) / root
    north = semi_major * (1 - squared) / root**3
    return np.column_stack([east * units[0], north * units[1]])


def vertical_unit(crs: CRS) -> tuple[str, float] | None:
    """Return name and size in metres of the unit of the heights of a CRS; None if it has none."""
    axes = [axis for axis in crs.axis_info if axis.direction in ("up", "down")]
    if not axes or not axes[0].unit_conversion_factor:
        return None
    return axes[0].unit_name, float(axes[0].unit_conversion_factor)
