"""Move nodes and change their values, one node after another, so that the error falls.

For each node the best values are known in closed form for any position. So a step is a
Gauss-Newton step of the position with the values eliminated ("variable projection"), halved
until the exact error with the best values is lower. The error never grows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel
from geomesh.refine.moments import IMAGE, SURFACE, Image, Surface, moments_along, squared_error
from geomesh.refine.node_system import (
    OF_NODE,
    OF_VALUE,
    RIDGE,
    ROOM,
    SPOKES,
    Room,
    add_to_system,
    best_error,
    take_best_values,
)
from geomesh.refine.patch import FREE, PATCH, SHARED, Patch
from geomesh.refine.shape import on_lattice
from geomesh.refine.star import FARTHEST, STAR, Star, around, freedom, star_sharpness

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Points

# How often a step is halved.
TRIES = 3

# Added to the curvature of the error, so that nodes in flat areas stay where they are.
_DAMPING = 0.02
_STIFFNESS = 1.0


@kernel(int64(PATCH, SURFACE, IMAGE, STAR, ROOM, boolean, float64, boolean))
def move_nodes(
    patch: Patch,
    surface: Surface,
    image: Image,
    star: Star,
    room: Room,
    moving: bool,
    floor: float,
    backwards: bool,
) -> int:
    """Improve the linear surface at each node in turn; return how many nodes moved.

    Parameters
    ----------
    star, room : Star, Room
    moving : bool
        False: change only the values.
    floor : float
        `sharpness` below which no triangle may fall, unless it was below already.
    backwards : bool
        Start with the last node.
    """
    p, values, systems = patch.points, surface.values, room.systems
    count, bands, moved = patch.size[0], values.shape[1], 0
    for i in range(count):
        v = count - 1 - i if backwards else i
        if patch.at[v] < 0 or patch.held[v] >= SHARED:
            continue
        m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
        if m == 0:
            continue
        x, y = p[v, 0], p[v, 1]
        _gather(p, values, surface.moments, star, True, m, v, x, y, systems, 0)
        chosen = 0
        if moving and patch.held[v] == FREE:
            hard, sx, sy = freedom(p, patch.hard, v, star, m, closed)
            dx, dy = _step(systems, bands, hard, sx, sy)
            before, sharp = best_error(systems, 0, bands), -1.0
            if dx != 0 or dy != 0:
                sharp = star_sharpness(p, x, y, star, m)
            for _ in range(TRIES):
                if dx == 0 and dy == 0:
                    break
                q = star_sharpness(p, x + dx, y + dy, star, m)
                if q > 0 and q >= min(floor, sharp):
                    moved_moments(
                        p, surface.along, image, star, m, closed, x + dx, y + dy, room.rows
                    )
                    _gather(p, values, room.rows, star, False, m, v, x + dx, y + dy, systems, 1)
                    if best_error(systems, 1, bands) < before:
                        p[v, 0], p[v, 1] = x + dx, y + dy
                        take_moments(surface.moments, surface.along, star, m, closed, room.rows)
                        chosen = 1
                        moved += 1
                        break
                dx, dy = shorter(dx, dy, hard, sx, sy)
        take_best_values(values, v, systems, chosen)
        for j in range(m):
            t = star.triangles[j]
            surface.errors[t] = squared_error(
                p, values, surface.moments, t, v, star.first[j], star.second[j]
            )
    return moved


@inner
def _gather(
    p: Points,
    values: Floats,
    moments: Floats,
    star: Star,
    by_triangle: bool,
    m: int,
    v: int,
    x: float,
    y: float,
    systems: Floats,
    s: int,
) -> None:
    """Fill the system `s` of node `v` at (x, y).

    The moments are in rows numbered by triangle, or by position in the star.
    """
    for i in range(systems.shape[1]):
        systems[s, i] = 0.0
    for j in range(m):
        row = star.triangles[j] if by_triangle else j
        add_to_system(p, values, moments, row, x, y, v, star.first[j], star.second[j], systems, s)


@inner
def _step(systems: Floats, bands: int, hard: int, sx: float, sy: float) -> tuple[float, float]:
    """Return the step of the position that the system 0 gives, on the lattice."""
    weight = systems[0, 0] + RIDGE
    xx, xy, yy = systems[0, 1], systems[0, 2], systems[0, 3]
    rx, ry = systems[0, 4], systems[0, 5]
    for band in range(bands):
        at = OF_NODE + OF_VALUE * band
        r, cx, cy = systems[0, at], systems[0, at + 1], systems[0, at + 2]
        xx -= cx * cx / weight
        xy -= cx * cy / weight
        yy -= cy * cy / weight
        rx -= cx * r / weight
        ry -= cy * r / weight
    xx += _DAMPING * systems[0, 1] + _STIFFNESS * bands
    yy += _DAMPING * systems[0, 3] + _STIFFNESS * bands
    if hard == 0:
        det = xx * yy - xy * xy
        if not det > 0:
            return 0.0, 0.0
        dx, dy = (rx * yy - ry * xy) / det, (ry * xx - rx * xy) / det
        length = math.sqrt(dx * dx + dy * dy)
        scale = FARTHEST / length if length > FARTHEST else 1.0
        return on_lattice(dx * scale), on_lattice(dy * scale)
    if hard == 1:
        most = FARTHEST / math.sqrt(sx * sx + sy * sy)
        along = (rx * sx + ry * sy) / (xx * sx * sx + 2 * xy * sx * sy + yy * sy * sy)
        along = np.rint(min(max(along, -most), most))
        return along * sx, along * sy
    return 0.0, 0.0


@inner
def shorter(dx: float, dy: float, hard: int, sx: float, sy: float) -> tuple[float, float]:
    """Return half of a step, on the lattice, along the step (sx, sy) if `hard`."""
    if hard == 0:
        return on_lattice(dx / 2), on_lattice(dy / 2)
    along = np.rint((dx * sx + dy * sy) / (sx * sx + sy * sy) / 2)
    return along * sx, along * sy


@inner
def moved_moments(
    p: Points,
    along: Floats,
    image: Image,
    star: Star,
    m: int,
    closed: bool,
    x: float,
    y: float,
    rows: Floats,
) -> None:
    """Fill `rows` with the moments of a star's triangles, its node at (x, y)."""
    for j in range(m if closed else m + 1):
        b = star.first[j] if j < m else star.second[m - 1]
        moments_along(x, y, p[b, 0], p[b, 1], image.sums, image.crossings, rows, SPOKES + j)
    for j in range(m):
        link = 3 * star.triangles[j] + star.corner[j]
        one, other = SPOKES + j, SPOKES + j + 1
        if closed and j == m - 1:
            other = SPOKES
        for i in range(rows.shape[1]):
            rows[j, i] = rows[one, i] + along[link, i] - rows[other, i]


@inner
def take_moments(
    moments: Floats, along: Floats, star: Star, m: int, closed: bool, rows: Floats
) -> None:
    """Store the moments that `moved_moments` found."""
    for j in range(m):
        t, k = star.triangles[j], star.corner[j]
        first, second = 3 * t + (k + 2) % 3, 3 * t + (k + 1) % 3
        following = SPOKES if closed and j == m - 1 else SPOKES + j + 1
        for i in range(rows.shape[1]):
            moments[t, i] = rows[j, i]
            along[first, i] = rows[SPOKES + j, i]
            along[second, i] = -rows[following, i]
