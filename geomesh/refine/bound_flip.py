"""Flip edges where the other diagonal keeps the errors lower, without leaving the bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import float64, int64, kernel, writes
from geomesh.refine.bound import BOUND, triangle_error
from geomesh.refine.connect import flip
from geomesh.refine.patch import PATCH, Patch, side_of
from geomesh.refine.shape import convex, corner_sharpness

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats

# Share of the sum that a flip must save, so that equal diagonals are not flipped back and forth.
_GAIN = 1e-6


@kernel(
    int64(
        *(PATCH, writes(float64, 2), writes(float64, 3)),
        *(writes(float64, 1), writes(float64, 1), writes(int64, 2), writes(int64, 1)),
        *(float64, int64),
    )
)
def flip_in_bound(
    patch: Patch,
    values: Floats,
    image: Floats,
    worst: Floats,
    total: Floats,
    pixel: Counts,
    changed: Counts,
    floor: float,
    passes: int,
) -> int:
    """Flip the edges that lower the sum of error^8; return how many.

    The greatest error of two triangles may grow up to the bound, or stay above it.

    Parameters
    ----------
    values, image, worst, total, pixel
        See `measure_bound`.
    changed : int64 (m,)
        0; -1 where no edge is to be flipped. Gets the pass in which a triangle last changed.
    floor : float
        `sharpness` below which no triangle may fall, unless its neighbours were below already.
    passes : int
        Largest number of passes. After the first, only triangles near changes are looked at.
    """
    triangles, across, p = patch.triangles, patch.across, patch.points
    count, flipped = patch.size[1], 0
    for turn in range(1, passes + 1):
        flips = 0
        for t in range(count):
            if not patch.alive[t]:
                continue
            for k in range(3):
                u = across[t, k]
                if u < t or patch.hard[t, k] or max(changed[t], changed[u]) < turn - 1:
                    continue
                before = (total[t] + total[u]) * (1 - _GAIN)
                if before <= 0:
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
                limit = max(BOUND, worst[t], worst[u])
                ax, ay, ex, ey = p[a, 0], p[a, 1], p[e, 0], p[e, 1]
                worst_1, col_1, row_1, total_1 = triangle_error(
                    values, image, ax, ay, p[b, 0], p[b, 1], ex, ey, values, a, b, e
                )
                if total_1 >= before or worst_1 > limit:
                    continue
                worst_2, col_2, row_2, total_2 = triangle_error(
                    values, image, ax, ay, ex, ey, p[d, 0], p[d, 1], values, a, e, d
                )
                if total_1 + total_2 >= before or worst_2 > limit:
                    continue
                flip(patch, t, k)
                worst[t], pixel[t, 0], pixel[t, 1], total[t] = worst_1, col_1, row_1, total_1
                worst[u], pixel[u, 0], pixel[u, 1], total[u] = worst_2, col_2, row_2, total_2
                changed[t] = changed[u] = turn
                flips += 1
                break
        flipped += flips
        if flips == 0:
            break
    return flipped
