"""Where the marks of the worst triangles, and the scale bar, are on the picture of the map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.raster.metres import metres_per_unit
from geomesh.view.report.content import Map, Marker
from geomesh.view.report.pictures import MAP_SIDE
from geomesh.view.thumbnail import on_page

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.view.report.content import Picture, WorstList

# Radius of a mark, in pixels of the picture, and how far it is from its triangle.
RADIUS = 17.0
_DISTANCE = 34.0

# Directions in which a mark is tried, and by how much farther away if all are taken.
_DIRECTIONS = 8
_FARTHER = (1.0, 2.0, 3.0, 4.0)

# Distance of the scale bar from the corner, and the share of the width that it has at most.
BAR_PLACE = 18.0
_SHARE = 0.25


def marked(mesh: TriangleMesh, picture: Picture, worst: Sequence[WorstList]) -> Map:
    """Return the picture of the map with the marks of the worst triangles."""
    scale = _scale(mesh, picture.width)
    page, window = on_page(mesh, MAP_SIDE)
    stretch = np.array([picture.width / window.width, picture.height / window.height])
    markers: list[Marker] = []
    for each in worst:
        for triangle in each.triangles:
            x, y = (page[mesh.triangles[triangle.id]].mean(axis=0) * stretch).tolist()
            label = _free_place((x, y), picture, markers, 0.0 if scale is None else scale[0])
            markers.append(Marker(each.by, triangle.mark, (x, y), label))
    return Map(picture, tuple(markers), scale)


def _free_place(
    place: tuple[float, float], picture: Picture, taken: Sequence[Marker], bar: float
) -> tuple[float, float]:
    """Return a place near a triangle where a mark covers no other and is inside the picture.

    It does not cover the scale bar either, which is `bar` long, in the lower left corner.
    """
    for x, y in _around(place):
        if x < BAR_PLACE + bar + 2 * RADIUS and y > picture.height - BAR_PLACE - 4 * RADIUS:
            continue
        inside = RADIUS <= x <= picture.width - RADIUS and RADIUS <= y <= picture.height - RADIUS
        others = [spot for other in taken for spot in (other.label, other.place)]
        if inside and all(math.dist((x, y), other) > 2 * RADIUS for other in others):
            return x, y
    # All places are taken, as on a tiny picture.
    x = min(max(place[0], RADIUS), max(picture.width - RADIUS, RADIUS))
    return x, min(max(place[1], RADIUS), max(picture.height - RADIUS, RADIUS))


def _around(place: tuple[float, float]) -> Iterator[tuple[float, float]]:
    for farther in _FARTHER:
        for k in range(_DIRECTIONS):
            angle = 2 * math.pi * k / _DIRECTIONS - math.pi / 4
            distance = _DISTANCE * farther
            yield place[0] + distance * math.cos(angle), place[1] + distance * math.sin(angle)


def _scale(mesh: TriangleMesh, width: int) -> tuple[float, str] | None:
    """Return the length of a scale bar in pixels of the picture, and its text."""
    west, south, east, north = mesh.grid.bounds()
    middle = np.array([((west + east) / 2, (south + north) / 2)])
    metres = float(metres_per_unit(mesh.grid.crs, middle)[0, 0]) * (east - west)
    if not 0 < metres < math.inf:
        return None
    wanted = metres * _SHARE
    step = 10.0 ** math.floor(math.log10(wanted))
    length = next(step * k for k in (5, 2, 1) if step * k <= wanted)
    if mesh.grid.crs is None:
        text = f"{length:g} pixels"
    else:
        text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    return width * length / metres, text
