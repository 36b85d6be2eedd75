"""Move the nodes of a mesh with one value for each triangle, so that the error falls.

The error is not smooth there: it changes whenever a pixel changes its triangle. So positions
around a node are tried, at shorter and shorter distances.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel
from geomesh.refine.moments import IMAGE, SURFACE, Image, Surface, spread
from geomesh.refine.move import TRIES, moved_moments, take_moments
from geomesh.refine.node_system import ROOM, Room
from geomesh.refine.patch import FREE, PATCH, Patch
from geomesh.refine.shape import on_lattice
from geomesh.refine.star import FARTHEST, STAR, Star, around, freedom, star_sharpness

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats

# Directions in which a free node is moved.
_WAYS = 8


@kernel(int64(PATCH, SURFACE, IMAGE, STAR, ROOM, float64, boolean))
def shift_nodes(
    patch: Patch,
    surface: Surface,
    image: Image,
    star: Star,
    room: Room,
    floor: float,
    backwards: bool,
) -> int:
    """Move each node in turn to the best of a few positions; return how many moved.

    Parameters
    ----------
    star, room : Star, Room
    floor : float
        `sharpness` below which no triangle may fall, unless it was below already.
    backwards : bool
        Start with the last node.
    """
    p, errors, rows = patch.points, surface.errors, room.rows
    count, bands, moved = patch.size[0], surface.values.shape[1], 0
    for i in range(count):
        v = count - 1 - i if backwards else i
        if patch.at[v] < 0 or patch.held[v] != FREE:
            continue
        m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
        if m == 0:
            continue
        hard, sx, sy = freedom(p, patch.hard, v, star, m, closed)
        if hard > 1:
            continue
        x, y = p[v, 0], p[v, 1]
        sharp = star_sharpness(p, x, y, star, m)
        before = 0.0
        for j in range(m):
            before += errors[star.triangles[j]]
        # A tie keeps the node where it is, whatever the rounding.
        best, best_x, best_y = before * (1 - 1e-9), x, y
        reach = FARTHEST
        for _ in range(TRIES):
            for way in range(2 if hard else _WAYS):
                if hard:
                    steps = np.rint(reach / math.sqrt(sx * sx + sy * sy)) * (1 - 2 * way)
                    nx, ny = x + steps * sx, y + steps * sy
                else:
                    turn = way * (2 * math.pi / _WAYS)
                    nx = x + on_lattice(reach * math.cos(turn))
                    ny = y + on_lattice(reach * math.sin(turn))
                q = star_sharpness(p, nx, ny, star, m)
                if q <= 0 or q < min(floor, sharp):
                    continue
                moved_moments(p, surface.along, image, star, m, closed, nx, ny, rows)
                error = _total(rows, m, bands)
                if error < best:
                    best, best_x, best_y = error, nx, ny
            if best_x != x or best_y != y:
                break
            reach /= 2
        if best_x != x or best_y != y:
            moved_moments(p, surface.along, image, star, m, closed, best_x, best_y, rows)
            p[v, 0], p[v, 1] = best_x, best_y
            take_moments(surface.moments, surface.along, star, m, closed, rows)
            for j in range(m):
                errors[star.triangles[j]] = spread(rows, j, bands)
            moved += 1
    return moved


@inner
def _total(rows: Floats, m: int, bands: int) -> float:
    """Return the error of the first `m` rows of moments."""
    total = 0.0
    for j in range(m):
        total += spread(rows, j, bands)
    return total
