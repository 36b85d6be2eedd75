"""Areas of triangles: in the plane, and on an ellipsoid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.table import blocks

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points


def signed_areas(points: Points, triangles: NDArray[np.integer]) -> Floats:
    """Return signed planar areas (T,) of triangles (T, 3); positive if counter-clockwise.

    `points` (N, 2) are the coordinates of the corners.
    """
    areas = np.empty(len(triangles))
    for block in blocks(len(triangles)):
        (ax, ay), (bx, by), (cx, cy) = np.moveaxis(points[triangles[block]], 0, -1)
        areas[block] = 0.5 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    return areas


def ellipsoidal_areas(
    points: Points,
    triangles: NDArray[np.integer],
    semi_major: float,
    semi_minor: float,
    to_geodetic: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """Return the areas of triangles on an ellipsoid.

    Parameters
    ----------
    points : float64 (N, 2)
        Longitude and latitude in radians, or what `to_geodetic` converts to them.
    triangles : int (T, 3)
    semi_major, semi_minor : float
        Axes of the ellipsoid, in metres.
    to_geodetic : callable, optional
        See `geomesh.raster.crs.to_geodetic`. A triangle may then lie around a pole.

    Returns
    -------
    float64 (T,)
        Square metres.
    """
    # A side of 180 degrees or more would be measured the other way round the globe: cut it.
    longitude = points[:, 0]
    sides = (longitude[triangles[:, k]] - longitude[triangles[:, k - 1]] for k in range(3))
    longest = max(float(np.abs(side).max(initial=0)) for side in sides)
    pieces = max(math.ceil(longest / (math.pi / 2)), 1)
    areas = np.empty(len(triangles))
    for block in blocks(len(triangles)):
        ring = _cut_sides(points[triangles[block]], pieces)
        if to_geodetic is not None:
            ring = to_geodetic(ring)
        areas[block] = _ring_areas(ring, semi_major, semi_minor)
    return areas


def _cut_sides(corners: NDArray[np.float64], pieces: int) -> NDArray[np.float64]:
    """Return rings (T, 3 pieces, 2) of triangles (T, 3, 2), each side cut into `pieces`."""
    side = np.roll(corners, -1, axis=1) - corners
    shares = np.arange(pieces)[:, None] / pieces
    ring = (corners[:, :, None] + side[:, :, None] * shares).reshape(len(corners), 3 * pieces, 2)
    np.clip(ring[..., 1], -math.pi / 2, math.pi / 2, out=ring[..., 1])
    return ring


def _ring_areas(
    ring: NDArray[np.float64], semi_major: float, semi_minor: float
) -> NDArray[np.float64]:
    """Return the areas of rings (T, N, 2) of longitudes and latitudes, no side above 180 degrees.

    Authalic latitudes (Snyder 1987, eq. 3-11 to 3-13) map the ellipsoid onto a sphere of
    equal area. On the sphere, the area between a great-circle arc and the equator has a
    closed form (Karney 2013, section 6). The area of a ring is the sum for its sides, or what
    that leaves of the hemisphere if the ring goes around a pole.
    """
    sine = np.sin(ring[..., 1])
    eccentricity = math.sqrt(max(1 - (semi_minor / semi_major) ** 2, 0.0))
    if eccentricity > 0:
        pole = float(_authalic_q(np.ones(1), eccentricity)[0])
        sine = np.clip(_authalic_q(sine, eccentricity) / pole, -1, 1)
    else:
        pole = 2.0
    radius_squared = semi_major**2 * pole / 2
    half_tangent = np.tan(np.arcsin(sine) / 2)
    t0, t1 = half_tangent, np.roll(half_tangent, -1, axis=1)
    turn = np.roll(ring[..., 0], -1, axis=1) - ring[..., 0]
    turn -= 2 * math.pi * np.round(turn / (2 * math.pi))
    excess = 2 * np.arctan2(np.tan(turn / 2) * (t0 + t1), 1 + t0 * t1).sum(axis=1)
    around = np.abs(turn.sum(axis=1)) > math.pi
    areas: NDArray[np.float64] = np.abs(2 * math.pi * around - np.abs(excess)) * radius_squared
    return areas


def _authalic_q(sine: NDArray[np.float64], e: float) -> NDArray[np.float64]:
    """Return Snyder's q for the sine of the latitude and the eccentricity `e` > 0."""
    es = e * sine
    q: NDArray[np.float64] = (1 - e**2) * (sine / (1 - es**2) + np.arctanh(es) / e)
    return q
