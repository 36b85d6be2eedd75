"""Patch: a part of a mesh that compiled loops change in place, and the changes of its topology.

Coordinates are those of pixel centres: the centre of the pixel (row, col) of the patch's image
is (col, row). All nodes lie on the lattice of 1/256 pixel, where scan lines are exact (see
`geomesh.zonal.rasterize`), so every pixel has one owner whatever is changed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, inner, int64, named, uint8, writes
from geomesh.arrays.jit import float64 as f8

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Points

# In `Patch.across`: nothing lies behind a side, or a triangle that belongs to another patch.
BORDER = -1
OTHER_PATCH = -2

# In `Patch.held`: nodes that may not move, and nodes that may not change at all: those of sides
# that the patch shares with another one. The last two belong to two separate fans of triangles,
# of which `around` finds only one: fans of the patch, and of the mesh where its outline touches
# itself.
FREE, STAYS, SHARED, SHARED_TWICE, TWO_FANS = 0, 1, 2, 3, 4

# Triangles around a node. Nodes with more are left as they are.
MOST_AROUND = 64

LATTICE = 256.0

# Doubled area in square pixels below which no triangle is made.
LEAST_AREA = 0.1

# The farthest that a node moves in one step, in pixels.
FARTHEST = 1.5


class Patch(NamedTuple):
    """Triangles that compiled loops change in place. Arrays have room for more.

    Attributes
    ----------
    points : float64 (n, 2)
        Positions of the nodes; those without a triangle are unused.
    triangles : int64 (m, 3)
        Corners, ordered so that ``(b - a) x (c - a)`` is positive in (x, y) with y down.
    across : int64 (m, 3)
        Number of the triangle across the side opposite to corner k, `BORDER` or `OTHER_PATCH`.
    hard : uint8 (m, 3)
        1 where the side opposite to corner k must stay an edge: the outline and breaklines.
    at : int64 (n,)
        One triangle of each node; -1 if the node is not used.
    alive : bool (m,)
        Whether a triangle exists.
    held : uint8 (n,)
        What a node may do: `FREE`, `STAYS`, `SHARED`, `SHARED_TWICE` or `TWO_FANS`.
    size : int64 (2,)
        Rows in use: of the nodes, and of the triangles.
    """

    points: Points
    triangles: Counts
    across: Counts
    hard: NDArray[np.uint8]
    at: Counts
    alive: NDArray[np.bool_]
    held: NDArray[np.uint8]
    size: NDArray[np.int64]


PATCH = named(
    *(Patch, writes(f8, 2), writes(int64, 2), writes(int64, 2), writes(uint8, 2)),
    *(writes(int64, 1), writes(boolean, 1), writes(uint8, 1), writes(int64, 1)),
)


class Star(NamedTuple):
    """Room for the triangles around a node, in order, and the sides opposite to the node.

    Attributes
    ----------
    triangles, corner, first, second : int64 (MOST_AROUND,)
        Triangle j has the corners node, first[j], second[j], in this order; the node is its
        corner number corner[j].
    """

    triangles: Counts
    corner: Counts
    first: Counts
    second: Counts


STAR = named(Star, *[writes(int64, 1)] * 4)


def new_star() -> Star:
    """Return room for the triangles around a node."""
    return Star(*np.empty((4, MOST_AROUND), np.int64))


@inner
def corner_of(triangles: Counts, t: int, v: int) -> int:
    """Return which corner of triangle `t` the node `v` is."""
    if triangles[t, 0] == v:
        return 0
    return 1 if triangles[t, 1] == v else 2


@inner
def side_of(across: Counts, t: int, u: int) -> int:
    """Return which side of triangle `t` it shares with triangle `u`."""
    if across[t, 0] == u:
        return 0
    return 1 if across[t, 1] == u else 2


@inner
def relink(across: Counts, t: int, old: int, new: int) -> None:
    """Make `new` the neighbour of `t` where it was `old`. `t` may be `BORDER` or the like."""
    if t >= 0:
        for k in range(3):
            if across[t, k] == old:
                across[t, k] = new
                return


@inner
def around(triangles: Counts, across: Counts, start: int, v: int, star: Star) -> tuple[int, bool]:
    """Fill `star` with the triangles around `v`; return their number and whether they close.

    `start` is one of them. The number is 0 if there are too many. An open star begins and
    ends at a side without a neighbour in this patch.
    """
    t = start
    closed = False
    for _ in range(MOST_AROUND):  # back to the first triangle
        before = across[t, (corner_of(triangles, t, v) + 2) % 3]
        if before < 0:
            break
        t = before
        if t == start:
            closed = True
            break
    first = t
    for m in range(MOST_AROUND):
        k = corner_of(triangles, t, v)
        star.triangles[m] = t
        star.corner[m] = k
        star.first[m] = triangles[t, (k + 1) % 3]
        star.second[m] = triangles[t, (k + 2) % 3]
        t = across[t, (k + 1) % 3]
        if t < 0 or t == first:
            return m + 1, closed
    return 0, closed


@inner
def doubled_area(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inner
def sharpness(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return the squared sine of the smallest angle; -1 if the triangle is not positive."""
    d = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if d < LEAST_AREA:
        return -1.0
    a = (bx - cx) * (bx - cx) + (by - cy) * (by - cy)
    b = (cx - ax) * (cx - ax) + (cy - ay) * (cy - ay)
    c = (ax - bx) * (ax - bx) + (ay - by) * (ay - by)
    return d * d / max(a * b, b * c, c * a)


@inner
def corner_sharpness(p: Points, a: int, b: int, c: int) -> float:
    """Return `sharpness` of the triangle of three of the points."""
    return sharpness(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[c, 0], p[c, 1])


@inner
def star_sharpness(p: Points, x: float, y: float, star: Star, m: int) -> float:
    """Return the least `sharpness` of the star's triangles with the node at (x, y)."""
    least = 2.0
    for j in range(m):
        b, c = star.first[j], star.second[j]
        q = sharpness(x, y, p[b, 0], p[b, 1], p[c, 0], p[c, 1])
        least = min(least, q)
        if q < 0:
            return -1.0
    return least


@inner
def on_lattice(value: float) -> float:
    """Return the coordinate rounded to the lattice of 1/256 pixel."""
    return float(np.rint(value * LATTICE) / LATTICE)


@inner
def lattice_step(dx: float, dy: float) -> tuple[float, float, int]:
    """Return the smallest step along (dx, dy) between points of the lattice, and their number."""
    i, j = int(abs(dx) * LATTICE), int(abs(dy) * LATTICE)
    while j:
        i, j = j, i % j
    if i == 0:
        return 0.0, 0.0, 0
    return dx / i, dy / i, i


@inner
def hard_spokes(hard: NDArray[np.uint8], star: Star, m: int, closed: bool) -> tuple[int, int, int]:
    """Return the number of hard edges at a star's node, and the far ends of the first two."""
    count, one, other = 0, -1, -1
    for j in range(m + (0 if closed else 1)):
        i = min(j, m - 1)
        t = star.triangles[i]
        if hard[t, (star.corner[i] + (2 if j < m else 1)) % 3]:
            end = star.first[i] if j < m else star.second[i]
            if count == 0:
                one = end
            elif count == 1:
                other = end
            count += 1
    return count, one, other


@inner
def straight(p: Points, v: int, one: int, other: int) -> bool:
    """Return whether `v` lies exactly on the line between two other nodes."""
    ux, uy = p[one, 0] - p[v, 0], p[one, 1] - p[v, 1]
    wx, wy = p[other, 0] - p[v, 0], p[other, 1] - p[v, 1]
    return bool(ux * wy == uy * wx and ux * wx + uy * wy < 0)


@inner
def freedom(
    p: Points, hard: NDArray[np.uint8], v: int, star: Star, m: int, closed: bool
) -> tuple[int, float, float]:
    """Return how a node may move: 0 anywhere, 1 along the step (x, y) that follows, 2 not at all.

    A node between two hard edges may move along them, on the lattice, if they are straight.
    """
    count, one, far = hard_spokes(hard, star, m, closed)
    if count == 0:
        return 0, 0.0, 0.0
    if count == 2 and straight(p, v, one, far):
        sx, sy, _ = lattice_step(p[far, 0] - p[one, 0], p[far, 1] - p[one, 1])
        return 1, sx, sy
    return 2, 0.0, 0.0


@inner
def flip(patch: Patch, t: int, k: int) -> int:
    """Replace the side k of triangle `t` by the other diagonal; return the other triangle.

    With t = (a, b, d) from corner k, and e the far corner of the neighbour u, the triangles
    become t = (a, b, e) and u = (a, e, d).
    """
    triangles, across, hard, at = patch.triangles, patch.across, patch.hard, patch.at
    u = across[t, k]
    k2 = side_of(across, u, t)
    a, b, d, e = (
        triangles[t, k],
        triangles[t, (k + 1) % 3],
        triangles[t, (k + 2) % 3],
        triangles[u, k2],
    )
    da, ab = across[t, (k + 1) % 3], across[t, (k + 2) % 3]
    be, ed = across[u, (k2 + 1) % 3], across[u, (k2 + 2) % 3]
    h_da, h_ab = hard[t, (k + 1) % 3], hard[t, (k + 2) % 3]
    h_be, h_ed = hard[u, (k2 + 1) % 3], hard[u, (k2 + 2) % 3]
    triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, b, e
    triangles[u, 0], triangles[u, 1], triangles[u, 2] = a, e, d
    across[t, 0], across[t, 1], across[t, 2] = be, u, ab
    across[u, 0], across[u, 1], across[u, 2] = ed, da, t
    hard[t, 0], hard[t, 1], hard[t, 2] = h_be, 0, h_ab
    hard[u, 0], hard[u, 1], hard[u, 2] = h_ed, h_da, 0
    relink(across, be, u, t)
    relink(across, da, t, u)
    at[a], at[b], at[e], at[d] = t, t, t, u
    return int(u)


@inner
def convex(p: Points, a: int, b: int, d: int, e: int) -> bool:
    """Return whether triangles (a, b, d) and (e, d, b) can become (a, b, e) and (a, e, d)."""
    return (
        doubled_area(p[a, 0], p[a, 1], p[b, 0], p[b, 1], p[e, 0], p[e, 1]) >= LEAST_AREA
        and doubled_area(p[a, 0], p[a, 1], p[e, 0], p[e, 1], p[d, 0], p[d, 1]) >= LEAST_AREA
    )


@inner
def collapse(patch: Patch, v: int, u: int, star: Star, m: int) -> None:
    """Merge node `v` into its neighbour `u`. `star` holds the triangles around `v`."""
    triangles, across, hard, at, alive = (
        patch.triangles,
        patch.across,
        patch.hard,
        patch.at,
        patch.alive,
    )
    for j in range(m):
        t = star.triangles[j]
        k, b, c = star.corner[j], star.first[j], star.second[j]
        if u not in (b, c):
            continue
        # The two sides of t that do not join v and u become one edge.
        alive[t] = False
        at_u = corner_of(triangles, t, u)
        one, other = across[t, k], across[t, at_u]
        is_hard = hard[t, k] | hard[t, at_u]
        if one >= 0:
            q = side_of(across, one, t)
            across[one, q], hard[one, q] = other, is_hard
        if other >= 0:
            q = side_of(across, other, t)
            across[other, q], hard[other, q] = one, is_hard
        w = c if b == u else b
        near = one if one >= 0 else other
        if near >= 0:
            at[w] = near
    for j in range(m):
        t = star.triangles[j]
        if alive[t]:
            triangles[t, star.corner[j]] = u
    for j in range(m):
        t = star.triangles[j]
        if alive[t]:
            for q in range(3):
                at[triangles[t, q]] = t
    at[v] = -1


@inner
def can_merge(
    star: Star, m: int, closed: bool, other: Star, n: int, other_closed: bool, along_hard: bool
) -> bool:
    """Return whether two neighbours share only the triangles at their edge (link condition).

    Parameters
    ----------
    star, other : Star
        Around the two nodes.
    along_hard : bool
        Whether the edge between them has a triangle on one side only.
    """
    common = 0
    for j in range(m + (0 if closed else 1)):
        w = star.first[j] if j < m else star.second[m - 1]
        for i in range(n + (0 if other_closed else 1)):
            if (other.first[i] if i < n else other.second[n - 1]) == w:
                common += 1
                break
    return common == (1 if along_hard else 2)


def room_for(patch: Patch, nodes: int) -> bool:
    """Return whether `nodes` more nodes fit into the arrays of a patch."""
    used, rows = patch.size.tolist()
    return bool(used + nodes <= len(patch.points) and rows + 4 * nodes <= len(patch.triangles))
