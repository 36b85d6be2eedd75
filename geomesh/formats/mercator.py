"""Web Mercator and its tiles: where longitude and latitude lie in the square of the world."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.hilbert import along_hilbert

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points

# The latitude at which the world becomes a square, and half its side on the map, in metres.
LIMIT = 85.05112877980659
HALF_SIDE = 20037508.342789244

# Pixels along the side of a tile, as maps on the web show it, and steps of its coordinates.
TILE_PIXELS = 512
EXTENT = 4096

# How far a tile goes on beyond its sides, in steps, so that no seam shows.
BUFFER = 64

# The deepest zoom that GDAL writes.
DEEPEST = 22


def to_world(lonlat: Points) -> Points:
    """Return the places of longitudes and latitudes (N, 2) in the world as a unit square (N, 2).

    x runs from 0 at the antimeridian to the east, y from 0 at 85.05 degrees north to the south.
    Longitudes may go on beyond 180 degrees; latitudes beyond 85.05 degrees become that.
    """
    lon, lat = lonlat[:, 0], np.radians(lonlat[:, 1].clip(-LIMIT, LIMIT))
    return np.column_stack([lon / 360 + 0.5, 0.5 - np.arcsinh(np.tan(lat)) / (2 * np.pi)])


def metres_to_world(places: Points) -> Points:
    """Return the places of map coordinates in metres (N, 2), EPSG:3857, in the unit square."""
    return places * (0.5 / HALF_SIDE, -0.5 / HALF_SIDE) + 0.5


def to_lonlat(world: Points) -> Points:
    """Return longitude and latitude, in degrees, of places in the unit square (N, 2)."""
    lat = np.degrees(np.arctan(np.sinh((0.5 - world[:, 1]) * 2 * np.pi)))
    return np.column_stack([(world[:, 0] - 0.5) * 360, lat])


def tile_ids(zoom: int, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of tiles in the order of PMTiles: zoom by zoom, along a Hilbert curve.

    Parameters
    ----------
    zoom : int
    x, y : int64 (n,)
        Column and row of each tile, from the north-west.
    """
    ids: NDArray[np.int64] = along_hilbert(x, y, zoom) + (4**zoom - 1) // 3
    return ids
