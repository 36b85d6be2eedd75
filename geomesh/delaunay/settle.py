"""Find the settled triangles of a tile, and the edges around them: kernels of `tiled`.

A triangle of a tile is settled if it is certainly a triangle of the whole triangulation.
"""

from __future__ import annotations

import numpy as np

from geomesh.arrays.jit import boolean, float64, inner, int32, int64, kernel, reads, void, writes
from geomesh.arrays.types import Floats, Ids, Mask, Points, Triangles
from geomesh.mesh.topology import FILL

# Far above the rounding error of a few float64 operations, relative to the sum of magnitudes.
_ERROR = 1e-14

Groups = tuple[Ids, Ids, Ids, Ids]


def settle(points: Points, triangles: Triangles, box: Floats) -> Mask:
    """Return which triangles have a circumcircle strictly inside the box.

    True is certain: the test allows for rounding errors.
    """
    settled = np.empty(len(triangles), np.bool_)
    _settle(points, triangles, box, settled)
    return settled


@kernel(void(reads(float64, 2), reads(int32, 2), reads(float64, 1), writes(boolean, 1)))
def _settle(points: Points, triangles: Triangles, box: Floats, settled: Mask) -> None:
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by, cx, cy = points[b, 0] - ax, points[b, 1] - ay, points[c, 0] - ax, points[c, 1] - ay
        bb, cc = bx * bx + by * by, cx * cx + cy * cy
        area, size = 2 * (bx * cy - by * cx), 2 * (abs(bx * cy) + abs(by * cx))
        x, y = (cy * bb - by * cc) / area, (bx * cc - cx * bb) / area
        radius = np.sqrt(x * x + y * y)
        # The area's relative error is at most 1/2: allow twice the numerator's and divisor's.
        slack = (abs(cy) + abs(cx)) * bb + (abs(by) + abs(bx)) * cc + (abs(x) + abs(y)) * size
        slack = _ERROR * (4 * slack / abs(area) + radius + abs(ax) + abs(ay))
        reach = radius + slack
        # Comparisons with NaN are false, so a triangle with NaN is never settled.
        settled[t] = (
            abs(area) > 2 * _ERROR * size
            and ax + x - reach > box[0]
            and ay + y - reach > box[1]
            and ax + x + reach < box[2]
            and ay + y + reach < box[3]
        )


def mark_touched(
    points: Points,
    triangles: Triangles,
    neighbours: Triangles,
    lines: Floats,
    inside: Ids,
    settled: Mask,
) -> None:
    """Clear `settled` for each triangle that a segment touches, even if only in a corner.

    The triangles that a segment touches are connected across edges that it also touches.
    So a flood finds them; it starts at an end of the segment, or where the segment enters
    the hull. If it is uncertain whether an edge is touched, it counts as touched.

    Parameters
    ----------
    lines : float64 (S, 4)
        Start x, start y, end x and end y of each segment.
    inside : int32 (S,)
        A point of the tile that is an end of the segment, or `FILL`.
    """
    at = np.full(len(points), FILL, np.int32)
    at[triangles] = np.arange(len(triangles), dtype=np.int32)[:, None]
    first = np.where(inside != FILL, at[inside], FILL)
    rim = np.column_stack(np.nonzero(neighbours == FILL)).astype(np.int32)
    seen, stack = np.full(len(triangles), FILL, np.int32), np.empty(len(triangles), np.int32)
    _mark_touched(points, triangles, neighbours, lines, inside, first, rim, seen, stack, settled)


@kernel(
    void(
        reads(float64, 2),
        reads(int32, 2),
        reads(int32, 2),
        reads(float64, 2),
        reads(int32, 1),
        reads(int32, 1),
        reads(int32, 2),
        writes(int32, 1),
        writes(int32, 1),
        writes(boolean, 1),
    )
)
def _mark_touched(
    points: Points,
    triangles: Triangles,
    neighbours: Triangles,
    lines: Floats,
    inside: Ids,
    first: Ids,
    rim: Ids,
    seen: Ids,
    stack: Ids,
    settled: Mask,
) -> None:
    for s in range(len(lines)):
        depth = 0
        if inside[s] == FILL:
            for h in range(len(rim)):
                t = rim[h, 0]
                if seen[t] != s and _touches(points, triangles, t, rim[h, 1], lines, s):
                    seen[t] = s
                    stack[depth] = t
                    depth += 1
        elif first[s] != FILL:
            seen[first[s]] = s
            stack[0] = first[s]
            depth = 1
        while depth > 0:
            depth -= 1
            t = stack[depth]
            settled[t] = False
            for k in range(3):
                other = neighbours[t, k]
                if other == FILL or seen[other] == s:
                    continue
                if _touches(points, triangles, t, k, lines, s):
                    seen[other] = s
                    stack[depth] = other
                    depth += 1


@inner
def _touches(points: Points, triangles: Triangles, t: int, k: int, lines: Floats, s: int) -> bool:
    """Return whether segment s may touch the side opposite to corner k of triangle t.

    False is certain; True is not.
    """
    p, q = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
    px, py, qx, qy = points[p, 0], points[p, 1], points[q, 0], points[q, 1]
    ax, ay, bx, by = lines[s, 0], lines[s, 1], lines[s, 2], lines[s, 3]
    if max(ax, bx) < min(px, qx) or max(px, qx) < min(ax, bx):
        return False
    if max(ay, by) < min(py, qy) or max(py, qy) < min(ay, by):
        return False
    if _side(ax, ay, bx, by, px, py) * _side(ax, ay, bx, by, qx, qy) > 0:
        return False
    return _side(px, py, qx, qy, ax, ay) * _side(px, py, qx, qy, bx, by) <= 0


@inner
def _side(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> int:
    """Return the side of the line ab on which p lies: 1 (left), -1 (right) or 0 (uncertain)."""
    left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
    value = left - right
    if abs(value) <= _ERROR * (abs(left) + abs(right)):
        return 0
    return 1 if value > 0 else -1


def gather_groups(triangles: Triangles, neighbours: Triangles, settled: Mask) -> Groups:
    """Return the settled triangles in connected groups, and the half-edges around the groups.

    Returns
    -------
    triangles : int32 (C, 3)
        The settled triangles, group after group.
    starts : int32 (G + 1,)
        Where each group starts in `triangles`, and the end of the last group.
    border : int32 (B, 2)
        Half-edges of settled triangles without a settled triangle on the other side.
    groups : int32 (B,)
        The group of each half-edge.
    """
    order = np.empty(int(np.count_nonzero(settled)), np.int32)
    group = np.full(len(triangles), FILL, np.int32)
    starts = np.zeros(len(order) + 1, np.int32)
    count = _gather_groups(neighbours, settled, order, group, starts)
    open_ = (neighbours[order] == FILL) | ~settled[neighbours[order]]
    at, k = np.nonzero(open_)
    t = order[at]
    border = np.column_stack([triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]])
    return triangles[order], starts[: count + 1].copy(), border, group[t]


@kernel(
    int64(reads(int32, 2), reads(boolean, 1), writes(int32, 1), writes(int32, 1), writes(int32, 1))
)
def _gather_groups(
    neighbours: Triangles, settled: Mask, order: Ids, group: Ids, starts: Ids
) -> int:
    """Fill `order` with the settled triangles, `group` and `starts`; return the group count."""
    count = groups = 0
    for seed in range(len(neighbours)):
        if not settled[seed] or group[seed] != FILL:
            continue
        group[seed] = groups
        order[count] = seed
        stop = count + 1
        # From `count` to `stop`, `order` lists triangles whose neighbours are not visited yet.
        while count < stop:
            t = order[count]
            count += 1
            for k in range(3):
                other = neighbours[t, k]
                if other != FILL and settled[other] and group[other] == FILL:
                    group[other] = groups
                    order[stop] = other
                    stop += 1
        groups += 1
        starts[groups] = count
    return groups


def unsettled_points(
    triangles: Triangles, neighbours: Triangles, settled: Mask, count: int
) -> Mask:
    """Return which of `count` points are not completely surrounded by settled triangles."""
    unsettled = np.ones(count, np.bool_)
    unsettled[triangles] = False
    unsettled[triangles[~settled]] = True
    t, k = np.nonzero(neighbours == FILL)
    unsettled[triangles[t, (k + 1) % 3]] = unsettled[triangles[t, (k + 2) % 3]] = True
    return unsettled
