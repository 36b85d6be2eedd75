"""Merge nodes with neighbours where the surface can stay within the bound.

For a place of the merged node the heights that keep all pixels around it in bounds form an
interval, which is found exactly. Where none is left the nodes are not merged. Wide intervals come
first, as they leave most room for later.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import boolean, float64, inner, int64, kernel, reads, writes
from geomesh.refine.bound import heights_of, take_middle
from geomesh.refine.connect import can_merge, collapse
from geomesh.refine.patch import FREE, PATCH, SHARED, SHARED_TWICE, Patch
from geomesh.refine.shape import lattice_step, on_lattice, straight
from geomesh.refine.star import MOST_AROUND, STAR, Star, around, hard_spokes, star_sharpness

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Points

# Where two nodes can be merged: at the second, or in the middle.
_AT_NEIGHBOUR, _MIDDLE, _PLACES = 0, 1, 2

# A merge whose interval has shrunk below this share since it was chosen is chosen again.
_STILL_WIDE = 0.7


@inner
def join_rings(star: Star, m: int, v: int, other: Star, n: int, u: int, ring: Star) -> int:
    """Fill `ring` with the triangles that are left around the merged `v` and `u`."""
    k = 0
    for j in range(m):
        if star.first[j] != u and star.second[j] != u:
            ring.first[k], ring.second[k] = star.first[j], star.second[j]
            k += 1
    for j in range(n):
        if other.first[j] != v and other.second[j] != v:
            ring.first[k], ring.second[k] = other.first[j], other.second[j]
            k += 1
    return k


@inner
def _middle(
    p: Points, hard: NDArray[np.uint8], v: int, u: int, other: Star, n: int, closed: bool, run: bool
) -> tuple[bool, float, float]:
    """Return whether both nodes can move to the middle between them, and that place.

    `run` says whether `v` lies on a straight run of hard edges; then both must.
    """
    count, one, far = hard_spokes(hard, other, n, closed)
    if not run:
        x, y = on_lattice((p[v, 0] + p[u, 0]) / 2), on_lattice((p[v, 1] + p[u, 1]) / 2)
        return count == 0, x, y
    if count != 2 or not straight(p, u, one, far):
        return False, 0.0, 0.0
    sx, sy, steps = lattice_step(p[u, 0] - p[v, 0], p[u, 1] - p[v, 1])
    half = steps // 2
    return half > 0, p[v, 0] + half * sx, p[v, 1] + half * sy


@inner
def _try_merge(
    p: Points,
    values: Floats,
    image: Floats,
    star: Star,
    m: int,
    other: Star,
    n: int,
    ring: Star,
    size: int,
    v: int,
    u: int,
    x: float,
    y: float,
    keeps_height: bool,
    floor: float,
    interval: Floats,
) -> float:
    """Return half the width of the heights of `v` and `u` merged at (x, y); -1 if none will do."""
    sharp = star_sharpness(p, x, y, ring, size)
    if sharp < 0:
        return -1.0
    if sharp < floor and sharp < min(
        star_sharpness(p, p[v, 0], p[v, 1], star, m), star_sharpness(p, p[u, 0], p[u, 1], other, n)
    ):
        return -1.0
    width = heights_of(p, values, image, ring, size, x, y, interval)
    if width >= 0 and keeps_height:
        for band in range(values.shape[1]):
            if not interval[0, band] <= values[u, band] <= interval[1, band]:
                return -1.0
    return width


@inner
def _widest(
    patch: Patch,
    values: Floats,
    image: Floats,
    star: Star,
    other: Star,
    ring: Star,
    interval: Floats,
    v: int,
    floor: float,
    only: int,
) -> tuple[float, int, float, float]:
    """Return the widest heights of a merge of node `v`, the merge, and its place.

    The merge is the neighbour times `_PLACES` plus where; -1 if there is none. If `only` is not
    negative, just this one is tried. ``interval[2:]`` gets the heights.
    """
    best, target, best_x, best_y = -1.0, -1, 0.0, 0.0
    if patch.held[v] != FREE:
        return best, target, best_x, best_y
    p = patch.points
    m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
    if m < (3 if closed else 2):
        return best, target, best_x, best_y
    hard, one, far = hard_spokes(patch.hard, star, m, closed)
    if hard > 0 and (hard != 2 or not straight(p, v, one, far)):
        return best, target, best_x, best_y
    for i in range(m + (0 if closed else 1)):
        u = star.first[i] if i < m else star.second[m - 1]
        if only >= 0 and only // _PLACES != u:
            continue
        if patch.held[u] == SHARED_TWICE or (hard > 0 and u not in (one, far)):
            continue
        n, other_closed = around(patch.triangles, patch.across, patch.at[u], u, other)
        if n == 0 or m + n > MOST_AROUND:
            continue
        is_border = not closed and (i in (0, m))
        if not can_merge(star, m, closed, other, n, other_closed, is_border):
            continue
        size = join_rings(star, m, v, other, n, u, ring)
        if size == 0:
            continue
        for place in range(_PLACES):
            if only >= 0 and only % _PLACES != place:
                continue
            x, y = p[u, 0], p[u, 1]
            if place == _MIDDLE:
                if patch.held[u] != FREE or u < v:  # each pair has its middle once
                    continue
                fits, x, y = _middle(p, patch.hard, v, u, other, n, other_closed, hard > 0)
                if not fits:
                    continue
            width = _try_merge(
                p,
                values,
                image,
                star,
                m,
                other,
                n,
                ring,
                size,
                v,
                u,
                x,
                y,
                patch.held[u] >= SHARED,
                floor,
                interval,
            )
            if width > best:
                for band in range(values.shape[1]):
                    interval[2, band], interval[3, band] = interval[0, band], interval[1, band]
                best, target, best_x, best_y = width, u * _PLACES + place, x, y
    return best, target, best_x, best_y


@kernel(
    int64(
        *(PATCH, writes(float64, 2), writes(float64, 3), STAR, STAR, STAR, writes(float64, 2)),
        *(float64, reads(int64, 1), writes(float64, 1), writes(int64, 1), boolean),
    )
)
def merge_nodes(
    patch: Patch,
    values: Floats,
    image: Floats,
    star: Star,
    other: Star,
    ring: Star,
    interval: Floats,
    floor: float,
    order: Counts,
    width: Floats,
    target: Counts,
    merging: bool,
) -> int:
    """Find the best merge of each node, or merge the nodes as far as the bound still allows.

    The best merge is the one that leaves the widest interval of heights. Return how many nodes
    were merged. (Two kernels would take twice as long to compile.)

    Parameters
    ----------
    values, image
        See `measure_bound`.
    interval : float64 (4, B)
        Room.
    floor : float
        `sharpness` below which no triangle may fall, unless its neighbours were below already.
    order : int64 (k,)
        Nodes.
    width : float64 (n,)
        Half the width of a node's interval, the least of all bands; -1 if there is no merge.
    target : int64 (n,)
        The merge of a node.
    merging : bool
        False: fill `width` and `target`. True: merge.
    """
    p, merged = patch.points, 0
    for i in range(len(order)):
        v = order[i]
        if patch.at[v] < 0:
            continue
        now, merge, x, y = -1.0, -1, 0.0, 0.0
        for again in range(2):
            only = target[v] if merging and not again else -1
            now, merge, x, y = _widest(
                patch, values, image, star, other, ring, interval, v, floor, only
            )
            if not merging or now >= _STILL_WIDE * width[v]:
                break
        if not merging:
            width[v], target[v] = now, merge
            continue
        if merge < 0:
            continue
        u = merge // _PLACES
        m, _ = around(patch.triangles, patch.across, patch.at[v], v, star)
        collapse(patch, v, u, star, m)
        p[u, 0], p[u, 1] = x, y
        if patch.held[u] < SHARED:
            take_middle(values, u, interval, 2)
        merged += 1
    return merged
