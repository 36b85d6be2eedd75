"""The kernels of `geomesh.tiled`: which triangles of a tile are settled, and what they border."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Triangles
from geomesh.mesh.topology import FILL

# Far above what a few operations in float64 err by, relative to the sum of magnitudes.
_ERROR = 1e-14

Groups = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]


@kernel
def settle(
    points: NDArray[np.float64], triangles: Triangles, box: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Tell which triangles' circumcircles lie strictly inside the box, beyond rounding."""
    settled = np.empty(len(triangles), np.bool_)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by, cx, cy = points[b, 0] - ax, points[b, 1] - ay, points[c, 0] - ax, points[c, 1] - ay
        bb, cc = bx * bx + by * by, cx * cx + cy * cy
        area, size = 2 * (bx * cy - by * cx), 2 * (abs(bx * cy) + abs(by * cx))
        x, y = (cy * bb - by * cc) / area, (bx * cc - cx * bb) / area
        radius = np.sqrt(x * x + y * y)
        # With an area known to one half at least, twice the errors of numerator and divisor.
        slack = (abs(cy) + abs(cx)) * bb + (abs(by) + abs(bx)) * cc + (abs(x) + abs(y)) * size
        slack = _ERROR * (4 * slack / abs(area) + radius + abs(ax) + abs(ay))
        reach = radius + slack
        # Written so that no comparison with what is no number settles.
        settled[t] = (
            abs(area) > 2 * _ERROR * size
            and ax + x - reach > box[0]
            and ay + y - reach > box[1]
            and ax + x + reach < box[2]
            and ay + y + reach < box[3]
        )
    return settled


@kernel
def mark_touched(
    points: NDArray[np.float64],
    triangles: Triangles,
    across: Triangles,
    lines: NDArray[np.float64],
    inside: NDArray[np.int32],
    settled: NDArray[np.bool_],
) -> None:
    """Clear `settled` for each triangle that a segment touches, if only in a corner.

    What a segment touches hangs together by edges that it touches, so it is found by
    a flood from an end of the segment, or from where it enters the hull. In doubt,
    an edge is touched.

    Parameters
    ----------
    lines : float64 (S, 4)
        From (x, y) to (x, y).
    inside : int32 (S,)
        One of the points that is an end of the segment, or `FILL`.
    """
    at = np.full(len(points), FILL, np.int32)
    hull = 0
    for t in range(len(triangles)):
        for k in range(3):
            at[triangles[t, k]] = t
            hull += across[t, k] == FILL
    rim = np.empty((hull, 2), np.int32)
    hull = 0
    for t in range(len(triangles)):
        for k in range(3):
            if across[t, k] == FILL:
                rim[hull, 0], rim[hull, 1] = t, k
                hull += 1
    seen = np.full(len(triangles), FILL, np.int32)
    stack = np.empty(len(triangles), np.int32)
    for s in range(len(lines)):
        ax, ay, bx, by = lines[s, 0], lines[s, 1], lines[s, 2], lines[s, 3]
        depth = 0
        if inside[s] != FILL:
            if at[inside[s]] != FILL:
                seen[at[inside[s]]] = s
                stack[0] = at[inside[s]]
                depth = 1
        else:
            for h in range(hull):
                t, k = rim[h, 0], rim[h, 1]
                p, q = triangles[t, k], triangles[t, (k + 1) % 3]
                px, py, qx, qy = points[p, 0], points[p, 1], points[q, 0], points[q, 1]
                if seen[t] != s and _touch(ax, ay, bx, by, px, py, qx, qy):
                    seen[t] = s
                    stack[depth] = t
                    depth += 1
        while depth > 0:
            depth -= 1
            t = stack[depth]
            settled[t] = False
            for k in range(3):
                other = across[t, k]
                if other != FILL and seen[other] != s:
                    p, q = triangles[t, k], triangles[t, (k + 1) % 3]
                    px, py, qx, qy = points[p, 0], points[p, 1], points[q, 0], points[q, 1]
                    if _touch(ax, ay, bx, by, px, py, qx, qy):
                        seen[other] = s
                        stack[depth] = other
                        depth += 1


@kernel
def _touch(
    ax: float, ay: float, bx: float, by: float, px: float, py: float, qx: float, qy: float
) -> bool:
    """Tell whether segments ab and pq may have a point in common; False is certain."""
    if max(ax, bx) < min(px, qx) or max(px, qx) < min(ax, bx):
        return False
    if max(ay, by) < min(py, qy) or max(py, qy) < min(ay, by):
        return False
    if _side(ax, ay, bx, by, px, py) * _side(ax, ay, bx, by, qx, qy) > 0:
        return False
    return _side(px, py, qx, qy, ax, ay) * _side(px, py, qx, qy, bx, by) <= 0


@kernel
def _side(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> int:
    """On which side of the line ab the point p lies: 1, -1, or 0 if that is not certain."""
    left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
    value = left - right
    if abs(value) <= _ERROR * (abs(left) + abs(right)):
        return 0
    return 1 if value > 0 else -1


@kernel
def gather_groups(triangles: Triangles, across: Triangles, settled: NDArray[np.bool_]) -> Groups:
    """Return the settled triangles by connected groups, and the half-edges around these.

    Returns
    -------
    triangles : int32 (C, 3)
    starts : int32 (G + 1,)
    border : int32 (B, 2)
    groups : int32 (B,)
    """
    count = edges = 0
    for t in range(len(triangles)):
        if settled[t]:
            count += 1
            for k in range(3):
                edges += across[t, k] == FILL or not settled[across[t, k]]
    chosen = np.empty((count, 3), np.int32)
    starts = np.zeros(count + 1, np.int32)
    border, groups = np.empty((edges, 2), np.int32), np.empty(edges, np.int32)
    seen = np.zeros(len(triangles), np.bool_)
    stack = np.empty(count, np.int32)
    count = edges = group = 0
    for first in range(len(triangles)):
        if not settled[first] or seen[first]:
            continue
        seen[first] = True
        stack[0], depth = first, 1
        while depth > 0:
            depth -= 1
            t = stack[depth]
            for k in range(3):
                chosen[count, k] = triangles[t, k]
                other = across[t, k]
                if other == FILL or not settled[other]:
                    border[edges, 0] = triangles[t, k]
                    border[edges, 1] = triangles[t, (k + 1) % 3]
                    groups[edges] = group
                    edges += 1
                elif not seen[other]:
                    seen[other] = True
                    stack[depth] = other
                    depth += 1
            count += 1
        group += 1
        starts[group] = count
    return chosen, starts[: group + 1].copy(), border, groups


@kernel
def unsettled_points(
    triangles: Triangles, across: Triangles, settled: NDArray[np.bool_], count: int
) -> NDArray[np.bool_]:
    """Tell which of `count` points are not all around in settled triangles."""
    unsettled = np.ones(count, np.bool_)
    for t in range(len(triangles)):
        for k in range(3):
            unsettled[triangles[t, k]] = False
    for t in range(len(triangles)):
        for k in range(3):
            if not settled[t] or across[t, k] == FILL:
                unsettled[triangles[t, k]] = unsettled[triangles[t, (k + 1) % 3]] = True
    return unsettled
