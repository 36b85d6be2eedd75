"""The triangles around a node, in order, and how the node may move."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import inner, int64, named, writes
from geomesh.refine.patch import corner_of
from geomesh.refine.shape import lattice_step, sharpness, straight

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Points

# Triangles around a node. Nodes with more are left as they are.
MOST_AROUND = 64

# The farthest that a node moves in one step, in pixels.
FARTHEST = 1.5


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
