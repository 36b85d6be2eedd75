"""Remove the nodes that a patch needs least."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel, reads, writes
from geomesh.refine.connect import can_merge, collapse
from geomesh.refine.moments import (
    CONSTANT,
    IMAGE,
    SURFACE,
    Image,
    Surface,
    measure_triangle,
    moments_along,
    spread,
    squared_error,
)
from geomesh.refine.node_system import ROOM, Room, add_to_system, best_error, take_best_values
from geomesh.refine.patch import FREE, PATCH, SHARED, SHARED_TWICE, Patch
from geomesh.refine.shape import sharpness, straight
from geomesh.refine.star import MOST_AROUND, STAR, Star, around, hard_spokes

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Mask, Points

# Cost of a node that cannot be removed.
NEVER = 1e300


@inner
def _cheapest(
    patch: Patch,
    surface: Surface,
    image: Image,
    star: Star,
    other: Star,
    room: Room,
    v: int,
    floor: float,
    model: int,
) -> tuple[float, int]:
    """Return how much the error grows at least if `v` is merged into a neighbour, and which."""
    best, target = NEVER, -1
    if patch.held[v] != FREE:
        return best, target
    p = patch.points
    m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
    if m == 0:
        return best, target
    hard, one, far = hard_spokes(patch.hard, star, m, closed)
    if hard > 0 and (hard != 2 or not straight(p, v, one, far)):
        return best, target
    old = 0.0
    for j in range(m):
        old += surface.errors[star.triangles[j]]
    for i in range(m + (0 if closed else 1)):
        u = star.first[i] if i < m else star.second[m - 1]
        if patch.held[u] >= SHARED_TWICE or (hard > 0 and u not in (one, far)):
            continue
        if _sharpness_after(p, star, m, u) < floor:
            continue
        n, other_closed = around(patch.triangles, patch.across, patch.at[u], u, other)
        is_border = not closed and (i in (0, m))
        if n == 0 or n + m > MOST_AROUND:
            continue
        if not can_merge(star, m, closed, other, n, other_closed, is_border):
            continue
        growth = _growth(patch, surface, image, star, other, room, v, u, m, n, i, model) - old
        if growth < best:
            best, target = growth, u
    return best, target


@inner
def _sharpness_after(p: Points, star: Star, m: int, u: int) -> float:
    """Return the least `sharpness` of a star's triangles once its node is merged into `u`."""
    least = 2.0
    x, y = p[u, 0], p[u, 1]
    for j in range(m):
        b, c = star.first[j], star.second[j]
        if u not in (b, c):
            least = min(least, sharpness(x, y, p[b, 0], p[b, 1], p[c, 0], p[c, 1]))
    return least


@inner
def _growth(
    patch: Patch,
    surface: Surface,
    image: Image,
    star: Star,
    other: Star,
    room: Room,
    v: int,
    u: int,
    m: int,
    n: int,
    i: int,
    model: int,
) -> float:
    """Return the error around `u` after `v` was merged into it, minus its own error before.

    `star` is around `v`, with `u` at the start of its triangle `i`; `other` is around `u`.
    """
    p, values, systems, rows = patch.points, surface.values, room.systems, room.rows
    x, y = p[u, 0], p[u, 1]
    for k in range(systems.shape[1]):
        systems[0, k] = 0.0
    error, before = 0.0, 0.0
    for j in range(n):
        if other.first[j] == v or other.second[j] == v:
            continue
        t = other.triangles[j]
        before += surface.errors[t]
        if model == CONSTANT:
            error += surface.errors[t]
        else:
            add_to_system(
                p, values, surface.moments, t, x, y, u, other.first[j], other.second[j], systems, 0
            )
    known = -1
    for turn in range(m):
        j = (i + turn) % m
        b, c = star.first[j], star.second[j]
        if u in (b, c):
            continue
        if known != b:
            moments_along(x, y, p[b, 0], p[b, 1], image.sums, image.crossings, rows, 1)
        moments_along(x, y, p[c, 0], p[c, 1], image.sums, image.crossings, rows, 2)
        link = 3 * star.triangles[j] + star.corner[j]
        for k in range(rows.shape[1]):
            rows[0, k] = rows[1, k] + surface.along[link, k] - rows[2, k]
            rows[1, k] = rows[2, k]
        known = c
        if model == CONSTANT:
            error += spread(rows, 0, values.shape[1])
        else:
            add_to_system(p, values, rows, 0, x, y, u, b, c, systems, 0)
    if model != CONSTANT:
        free = patch.held[u] < SHARED
        error = best_error(systems, 0, values.shape[1]) if free else systems[0, 6]
    return error - before


@kernel(
    int64(
        *(PATCH, SURFACE, IMAGE, STAR, STAR, ROOM, reads(int64, 1), writes(boolean, 1)),
        *(writes(float64, 1), float64, int64, int64),
    )
)
def remove_nodes(
    patch: Patch,
    surface: Surface,
    image: Image,
    star: Star,
    other: Star,
    room: Room,
    order: Counts,
    locked: Mask,
    costs: Floats,
    floor: float,
    wanted: int,
    model: int,
) -> int:
    """Remove nodes in the given order until there are enough; return how many.

    The neighbours of a removed node stay until the next batch. With ``wanted`` 0, only find what
    it would cost to remove each node. (One kernel does both, because it compiles faster.)

    Parameters
    ----------
    order : int64 (k,)
        Nodes, the cheapest first.
    locked : bool (n,)
        Room, all False.
    costs : float64 (n,)
        Gets how much the error grows at least if the node is removed; `NEVER` if it must stay.
    floor : float
        `sharpness` below which no new triangle may fall.
    wanted : int
        Number of nodes to remove.
    model : int
        `LINEAR` or `CONSTANT`.
    """
    p, values, systems = patch.points, surface.values, room.systems
    removed = 0
    for i in range(len(order)):
        v = order[i]
        if locked[v] or patch.at[v] < 0:
            continue
        costs[v], u = _cheapest(patch, surface, image, star, other, room, v, floor, model)
        if wanted == 0 or costs[v] >= NEVER:
            continue
        m, _ = around(patch.triangles, patch.across, patch.at[v], v, star)
        for j in range(m):
            locked[star.first[j]] = True
            locked[star.second[j]] = True
        collapse(patch, v, u, star, m)
        for j in range(m):
            if not patch.alive[star.triangles[j]]:
                surface.errors[star.triangles[j]] = -1.0
        m, _ = around(patch.triangles, patch.across, patch.at[u], u, star)
        for k in range(systems.shape[1]):
            systems[0, k] = 0.0
        x, y = p[u, 0], p[u, 1]
        for j in range(m):
            t, b, c = star.triangles[j], star.first[j], star.second[j]
            measure_triangle(patch, surface, image, t, model)
            add_to_system(p, values, surface.moments, t, x, y, u, b, c, systems, 0)
        if model != CONSTANT and patch.held[u] < SHARED:
            take_best_values(values, u, systems, 0)
            for j in range(m):
                t, b, c = star.triangles[j], star.first[j], star.second[j]
                surface.errors[t] = squared_error(p, values, surface.moments, t, u, b, c)
        removed += 1
        if removed == wanted:
            break
    return removed
