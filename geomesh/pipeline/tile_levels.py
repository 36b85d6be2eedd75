"""The plan of a map: from which zoom to which, and how many nodes a mesh has at each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from geomesh.errors import OutputError
from geomesh.formats.mercator import DEEPEST, TILE_PIXELS, to_lonlat, to_world
from geomesh.raster.areas import signed_areas

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh

Bounds: TypeAlias = tuple[float, float, float, float]

# Screen pixels for each node of a smaller mesh: see docs/tiles.md, where others are compared.
PIXELS_PER_NODE = 64

_FEWEST = 4

# Pixels of a map that are up to so many pixels of the raster wide show each of them.
_NEAR = 2**0.5

# With this share of its nodes, the mesh itself is shown: one with a few nodes less is no gain.
_NEARLY_ALL = 0.7


@dataclass(frozen=True)
class LevelPlan:
    """The mesh of one zoom.

    Parameters
    ----------
    zoom : int
    factor : int
        Pixels of the raster along the side of a pixel of the map, rounded.
    nodes : int, optional
        Number of nodes of a smaller mesh. None: the mesh itself is shown.
    """

    zoom: int
    factor: int = 1
    nodes: int | None = None


@dataclass(frozen=True)
class TilePlan:
    """The zooms of a map.

    Parameters
    ----------
    levels : tuple of LevelPlan
        The nearest zoom first.
    bounds : (west, south, east, north)
        In degrees. A mesh that crosses the antimeridian reaches around the world.
    view : (west, south, east, north)
        The same, but a mesh that crosses the antimeridian has an east beyond 180 degrees.
    """

    levels: tuple[LevelPlan, ...]
    bounds: Bounds
    view: Bounds


def plan_levels(
    mesh: TriangleMesh, lonlat: Points, min_zoom: int | None = None, max_zoom: int | None = None
) -> TilePlan:
    """Return which mesh a map shows at each zoom.

    Parameters
    ----------
    mesh : TriangleMesh
    lonlat : float64 (N, 2)
        Longitude and latitude of its nodes.
    min_zoom, max_zoom : int, optional
        Default: from a zoom at which the mesh fits half a tile to that at which a pixel of the map
        is about one of the raster. A mesh with many nodes has more.

    Raises
    ------
    OutputError
        If the zooms are in the wrong order or out of range.
    """
    for name, value in (("min_zoom", min_zoom), ("max_zoom", max_zoom)):
        if value is not None and not 0 <= value <= DEEPEST:
            raise OutputError(f"`{name}` is {value}: give a zoom from 0 to {DEEPEST}")
    world = to_world(lonlat)
    corners = world[mesh.triangles]
    corners[..., 0] -= np.rint(corners[..., 0] - corners[:, :1, 0])
    area, (side, bounds, view) = _area(corners), _extent(corners, world)
    pixel = np.sqrt(area / np.abs(signed_areas(mesh.nodes, mesh.triangles)).sum())
    # From this zoom on, the mesh itself has as many nodes as a smaller one would have.
    own = _zoom(np.sqrt(_NEARLY_ALL * len(mesh.nodes) * PIXELS_PER_NODE / area))
    last = max_zoom if max_zoom is not None else max(_zoom(1 / (_NEAR * pixel)), own)
    first = int(np.floor(-np.log2(side))) - 1
    first = min_zoom if min_zoom is not None else min(max(first, 0), last)
    if first > last:
        raise OutputError(
            f"`min_zoom` is {first} and `max_zoom` is {last}: the first must not be larger"
        )
    levels = [LevelPlan(zoom) for zoom in range(last, max(own, first) - 1, -1)]
    if not levels and max_zoom is None:
        levels = [LevelPlan(last)]
    factor = None
    for zoom in range(min(own - 1, last), first - 1, -1):
        if levels and zoom >= levels[-1].zoom:
            continue
        pixels = TILE_PIXELS * 2.0**zoom
        factor = max(round(1 / (pixels * pixel)), 1) if factor is None else 2 * factor
        nodes = max(round(area * pixels**2 / PIXELS_PER_NODE), _FEWEST)
        levels.append(LevelPlan(zoom, factor, nodes))
    return TilePlan(tuple(levels), bounds, view)


def _zoom(pixels: float) -> int:
    """Return the first zoom at which the world has at least so many pixels along its side."""
    zoom = int(np.ceil(np.log2(max(pixels, 1) / TILE_PIXELS) - 1e-9))
    return min(max(zoom, 0), DEEPEST)


def _area(corners: NDArray[np.float64]) -> float:
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, k] - corners[:, 0], 1, 0) for k in (1, 2))
    return float(np.abs(ax * by - ay * bx).sum() / 2)


def _extent(corners: NDArray[np.float64], world: Points) -> tuple[float, Bounds, Bounds]:
    """Return the longer side in the unit square, the bounds, and what a map shows first.

    `corners` (T, 3, 2) of a triangle that crosses the antimeridian go on beyond it.
    """
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if low[0] >= 0 and high[0] <= 1:
        return float((high - low).max()), _degrees(low, high), _degrees(low, high)
    # Seen from the other side of the world, it is in one piece, if it does not go around.
    turned = (world[:, 0] + 0.5) % 1.0 + 0.5
    west, east = float(turned.min()), float(turned.max())
    view = _degrees(np.array([west, low[1]]), np.array([east, high[1]]))
    low[0], high[0] = 0.0, 1.0
    return max(east - west, float(high[1] - low[1])), _degrees(low, high), view


def _degrees(low: Floats, high: Floats) -> Bounds:
    (west, north), (east, south) = to_lonlat(np.array([low, high])).tolist()
    return west, south, east, north
