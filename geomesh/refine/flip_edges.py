"""Flip edges where the other diagonal shows the image better."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import float64, int64, kernel, writes
from geomesh.refine.connect import flip
from geomesh.refine.moments import IMAGE, SURFACE, Image, Surface, error_of, moments_along
from geomesh.refine.node_system import ROOM, Room
from geomesh.refine.patch import PATCH, Patch, side_of
from geomesh.refine.shape import convex, corner_sharpness

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts


@kernel(int64(PATCH, SURFACE, IMAGE, ROOM, writes(int64, 1), float64, float64, int64, int64))
def flip_edges(
    patch: Patch,
    surface: Surface,
    image: Image,
    room: Room,
    changed: Counts,
    floor: float,
    gain: float,
    passes: int,
    model: int,
) -> int:
    """Flip the edges that lower the error by more than `gain`; return how many.

    Parameters
    ----------
    room : Room
    changed : int64 (m,)
        Zeros. Gets the pass in which a triangle last changed.
    floor : float
        `sharpness` below which no triangle may fall, unless its neighbours were below already.
    gain : float
        Squared error that a flip must save.
    passes : int
        Largest number of passes. After the first, only triangles near changes are looked at.
    model : int
        `LINEAR` or `CONSTANT`.
    """
    triangles, across, p = patch.triangles, patch.across, patch.points
    along, moments, errors, values = surface.along, surface.moments, surface.errors, surface.values
    count, width, rows = patch.size[1], moments.shape[1], room.rows
    total = 0
    for turn in range(1, passes + 1):
        flips = 0
        for t in range(count):
            if not patch.alive[t]:
                continue
            for k in range(3):
                u = across[t, k]
                if u < t or patch.hard[t, k] or max(changed[t], changed[u]) < turn - 1:
                    continue
                before = errors[t] + errors[u]
                if before <= gain:
                    continue
                k2 = side_of(across, u, t)
                a, b, d = triangles[t, k], triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
                e = triangles[u, k2]
                if not convex(p, a, b, d, e):
                    continue
                sharp = min(corner_sharpness(p, a, b, e), corner_sharpness(p, a, e, d))
                if sharp < floor and sharp < min(
                    corner_sharpness(p, a, b, d), corner_sharpness(p, e, d, b)
                ):
                    continue
                moments_along(
                    p[a, 0], p[a, 1], p[e, 0], p[e, 1], image.sums, image.crossings, rows, 0
                )
                ab, da = 3 * t + (k + 2) % 3, 3 * t + (k + 1) % 3
                be, ed = 3 * u + (k2 + 1) % 3, 3 * u + (k2 + 2) % 3
                for i in range(width):
                    rows[1, i] = along[ab, i] + along[be, i] - rows[0, i]
                    rows[2, i] = rows[0, i] + along[ed, i] + along[da, i]
                first = error_of(p, values, rows, 1, a, b, e, model)
                if first >= before - gain:
                    continue
                second = error_of(p, values, rows, 2, a, e, d, model)
                if first + second >= before - gain:
                    continue
                flip(patch, t, k)
                for i in range(width):
                    s_ab, s_be, s_ed, s_da = along[ab, i], along[be, i], along[ed, i], along[da, i]
                    along[3 * t, i], along[3 * t + 1, i] = s_be, -rows[0, i]
                    along[3 * t + 2, i] = s_ab
                    along[3 * u, i], along[3 * u + 1, i] = s_ed, s_da
                    along[3 * u + 2, i] = rows[0, i]
                    moments[t, i], moments[u, i] = rows[1, i], rows[2, i]
                errors[t], errors[u] = first, second
                changed[t] = changed[u] = turn
                flips += 1
                break
        total += flips
        if flips == 0:
            break
    return total
