"""Changes of a patch's topology: flip an edge, or merge two nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import inner
from geomesh.refine.patch import Patch, corner_of, relink, side_of

if TYPE_CHECKING:
    from geomesh.refine.star import Star


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
