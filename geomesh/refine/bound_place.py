"""Merge nodes at places found by Newton steps, where neither node nor their middle will do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.arrays.jit import float64, inner, int64, kernel, reads, writes
from geomesh.refine.bound import BOUND, heights_of, take_middle
from geomesh.refine.bound_merge import join_rings
from geomesh.refine.bound_move import (
    FIRST_SHARE,
    LENGTHS,
    SHORTER,
    direction,
    gather,
    new_heights,
    on_track,
    sum_within,
)
from geomesh.refine.connect import can_merge, collapse
from geomesh.refine.patch import FREE, PATCH, Patch
from geomesh.refine.shape import on_lattice
from geomesh.refine.star import (
    FARTHEST,
    MOST_AROUND,
    STAR,
    Star,
    around,
    hard_spokes,
    star_sharpness,
)

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Points

# The greatest error with which a place is worth Newton steps, and how many there are.
_GATE, _STEPS = 1.5, 4


@kernel(
    int64(
        *(PATCH, writes(float64, 2), writes(float64, 3), STAR, STAR, STAR, writes(float64, 2)),
        *(writes(float64, 2), float64, reads(int64, 1)),
    )
)
def place_merged(
    patch: Patch,
    values: Floats,
    image: Floats,
    star: Star,
    other: Star,
    ring: Star,
    interval: Floats,
    room: Floats,
    floor: float,
    order: Counts,
) -> int:
    """Merge nodes with neighbours at the best place that Newton steps find; return how many.

    Only nodes that may move freely are merged so.

    Parameters
    ----------
    values, image
        See `measure_bound`.
    interval : float64 (4, B)
        Room.
    room : float64 (3, K)
        See `new_system`.
    floor : float
        `sharpness` below which no new triangle may fall.
    order : int64 (k,)
        Nodes.
    """
    p, merged, bands = patch.points, 0, image.shape[0]
    for i in range(len(order)):
        v = order[i]
        if patch.at[v] < 0 or patch.held[v] != FREE:
            continue
        m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
        if m < 3 or not closed or hard_spokes(patch.hard, star, m, closed)[0]:
            continue
        best, target, x, y = math.inf, -1, 0.0, 0.0
        for j in range(2 * m):
            u, middle = star.first[j // 2], j % 2 == 1
            if patch.held[u] != FREE or (middle and u < v):
                continue
            n, other_closed = around(patch.triangles, patch.across, patch.at[u], u, other)
            if n == 0 or m + n > MOST_AROUND or not other_closed:
                continue
            if hard_spokes(patch.hard, other, n, True)[0]:
                continue
            if not can_merge(star, m, True, other, n, True, False):
                continue
            size = join_rings(star, m, v, other, n, u, ring)
            share = 0.5 if middle else 0.0
            new_x = on_lattice(p[u, 0] + share * (p[v, 0] - p[u, 0]))
            new_y = on_lattice(p[u, 1] + share * (p[v, 1] - p[u, 1]))
            if star_sharpness(p, new_x, new_y, ring, size) < floor:
                continue
            for band in range(bands):
                room[1, band] = values[u, band] + share * (values[v, band] - values[u, band])
            total = sum_within(p, values, image, ring, size, new_x, new_y, room, best, _GATE)
            if total >= 0:
                best, target, x, y = total, u, new_x, new_y
                for band in range(bands):
                    room[2, band] = room[1, band]
        if target < 0:
            continue
        n, _ = around(patch.triangles, patch.across, patch.at[target], target, other)
        size = join_rings(star, m, v, other, n, target, ring)
        fits, x, y = _improve(p, values, image, ring, size, x, y, room, interval, floor)
        if fits:
            collapse(patch, v, target, star, m)
            p[target, 0], p[target, 1] = x, y
            take_middle(values, target, interval, 0)
            merged += 1
    return merged


@inner
def _improve(
    p: Points,
    values: Floats,
    image: Floats,
    ring: Star,
    size: int,
    x: float,
    y: float,
    room: Floats,
    interval: Floats,
    floor: float,
) -> tuple[bool, float, float]:
    """Move a node at (x, y) with the heights ``room[2]`` until it can keep the bound.

    Return whether it can, and where; `interval` gets the heights.
    """
    bands = image.shape[0]
    for step in range(_STEPS):
        before, worst = gather(p, values, image, ring, size, x, y, room, 2, room)
        if worst > _GATE + 0.1 - 0.1 * step:
            break
        dx, dy = direction(room, bands, 0, 0.0, 0.0)
        length = math.sqrt(dx * dx + dy * dy)
        share, lower = FIRST_SHARE, False
        for _ in range(LENGTHS):
            mx, my = on_track(dx, dy, min(share, FARTHEST / max(length, 1e-9)), 0, 0.0, 0.0)
            if star_sharpness(p, x + mx, y + my, ring, size) >= floor:
                new_heights(room, 2, bands, room, share, mx, my)
                limit = max(BOUND, worst)
                total = sum_within(
                    p, values, image, ring, size, x + mx, y + my, room, before, limit
                )
                if total >= 0:
                    lower = True
                    x, y = x + mx, y + my
                    for band in range(bands):
                        room[2, band] = room[1, band]
                    break
            share *= SHORTER
        if not lower:
            break
        if heights_of(p, values, image, ring, size, x, y, interval) >= 0:
            return True, x, y
    return False, x, y
