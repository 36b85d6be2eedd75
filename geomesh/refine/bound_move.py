"""Move nodes and change their heights so that errors near the bound become smaller.

Each node takes a damped Newton step that lowers the sum of error^8 over its pixels, which is
nearly the greatest error. That makes room: more nodes can be merged afterwards.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import float64, inner, int64, kernel, reads, writes
from geomesh.refine.bound import BOUND, triangle_error
from geomesh.refine.patch import FREE, PATCH, SHARED, Patch
from geomesh.refine.scan import columns_of
from geomesh.refine.shape import on_lattice
from geomesh.refine.star import FARTHEST, STAR, Star, around, freedom, star_sharpness
from geomesh.zonal.rasterize import sort_corners

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Points

# Columns of the system of a node: of the position, and of the height in each band.
OF_PLACE, OF_HEIGHT = 5, 4

# Newton's step for the sum of error^8 is a seventh of the one for a sum of squares. Lengths tried
# begin with the double, and become shorter.
FIRST_SHARE, SHORTER, LENGTHS = 2 / 7, 0.4, 4


def new_system(bands: int) -> Floats:
    """Return room for the system of a node, and for its heights."""
    return np.zeros((3, OF_PLACE + OF_HEIGHT * bands))


@kernel(
    int64(
        *(PATCH, writes(float64, 2), writes(float64, 3), STAR, writes(float64, 2)),
        *(reads(int64, 1), float64),
    )
)
def relax_in_bound(
    patch: Patch,
    values: Floats,
    image: Floats,
    star: Star,
    room: Floats,
    order: Counts,
    floor: float,
) -> int:
    """Lower the errors around each node in `order`; return how many nodes changed.

    Parameters
    ----------
    values, image
        See `measure_bound`.
    room : float64 (3, K)
        See `new_system`.
    order : int64 (k,)
        Nodes.
    floor : float
        `sharpness` below which no triangle may fall, unless it was below already.
    """
    p, changed = patch.points, 0
    for i in range(len(order)):
        v = order[i]
        if patch.at[v] < 0 or patch.held[v] >= SHARED:
            continue
        m, closed = around(patch.triangles, patch.across, patch.at[v], v, star)
        if m == 0:
            continue
        x, y = p[v, 0], p[v, 1]
        before, worst = gather(p, values, image, star, m, x, y, values, v, room)
        if before <= 0:
            continue
        limit = max(BOUND, worst)
        hard, sx, sy = 2, 0.0, 0.0
        if patch.held[v] == FREE:
            hard, sx, sy = freedom(p, patch.hard, v, star, m, closed)
        dx, dy = direction(room, image.shape[0], hard, sx, sy)
        length = math.sqrt(dx * dx + dy * dy)
        if not length < math.inf:
            length = 0.0
        sharp = -1.0
        if length > 0:
            sharp = star_sharpness(p, x, y, star, m)
        done = False
        for moving in range(1 if length > 0 else 0, -1, -1):
            share = FIRST_SHARE
            for _ in range(LENGTHS):
                mx, my = 0.0, 0.0
                if moving:
                    mx, my = on_track(
                        dx, dy, min(share, FARTHEST / max(length, 1e-9)), hard, sx, sy
                    )
                    if mx == 0 and my == 0:
                        break
                    q = star_sharpness(p, x + mx, y + my, star, m)
                    if q <= 0 or q < min(floor, sharp):
                        share *= SHORTER
                        continue
                new_heights(values, v, image.shape[0], room, share, mx, my)
                if sum_within(p, values, image, star, m, x + mx, y + my, room, before, limit) >= 0:
                    p[v, 0], p[v, 1] = x + mx, y + my
                    for band in range(image.shape[0]):
                        values[v, band] = room[1, band]
                    changed += 1
                    done = True
                    break
                share *= SHORTER
            if done:
                break
    return changed


@inner
def gather(
    p: Points,
    values: Floats,
    image: Floats,
    star: Star,
    m: int,
    x: float,
    y: float,
    heights: Floats,
    a: int,
    room: Floats,
) -> tuple[float, float]:
    """Fill ``room[0]`` with the Gauss-Newton system of a node; return the sum and the worst.

    The node is at (x, y) with the heights ``heights[a]``.

    The surface changes by ``weight`` when the height of the node does, and by ``-weight *
    gradient`` when its position does.
    """
    for k in range(room.shape[1]):
        room[0, k] = 0.0
    total, worst = 0.0, 0.0
    for j in range(m):
        b, c = star.first[j], star.second[j]
        bx, by, cx, cy = p[b, 0], p[b, 1], p[c, 0], p[c, 1]
        ux, uy, wx, wy = bx - x, by - y, cx - x, cy - y
        d = ux * wy - uy * wx
        weight_x, weight_y = (uy - wy) / d, (wx - ux) / d
        weight_0 = 1 - weight_x * x - weight_y * y
        corners = sort_corners(x, y, bx, by, cx, cy)
        for band in range(image.shape[0]):
            start = heights[a, band]
            fb, fc = values[b, band] - start, values[c, band] - start
            gx, gy = (fb * wy - fc * uy) / d, (fc * ux - fb * wx) / d
            base = start - gx * x - gy * y
            ww, right = 0.0, 0.0
            for row in range(math.ceil(corners[1]), math.ceil(corners[5])):
                first, stop = columns_of(corners, row)
                height, weight_row = base + gy * row, weight_0 + weight_y * row
                for col in range(first, stop):
                    error = image[band, row, col] - height - gx * col
                    square = error * error
                    if square == square:  # noqa: PLR0124  not NaN
                        weight = weight_row + weight_x * col
                        factor = square * square * square
                        worst = max(worst, square)
                        total += factor * square
                        ww += factor * weight * weight
                        right += factor * weight * error
            room[0, 0] += ww * gx * gx
            room[0, 1] += ww * gx * gy
            room[0, 2] += ww * gy * gy
            room[0, 3] -= right * gx
            room[0, 4] -= right * gy
            at = OF_PLACE + OF_HEIGHT * band
            room[0, at] += ww
            room[0, at + 1] -= ww * gx
            room[0, at + 2] -= ww * gy
            room[0, at + 3] += right
    return total, math.sqrt(worst)


@inner
def direction(room: Floats, bands: int, hard: int, sx: float, sy: float) -> tuple[float, float]:
    """Return the step of the position that the system gives, the heights eliminated."""
    xx, xy, yy = room[0, 0] * 1.02, room[0, 1], room[0, 2] * 1.02
    rx, ry = room[0, 3], room[0, 4]
    for band in range(bands):
        at = OF_PLACE + OF_HEIGHT * band
        weight = room[0, at]
        if weight <= 0:
            continue
        stiff = weight * 1e-3 + 1e-9
        xx += stiff
        yy += stiff
        weight = weight * 1.001 + 1e-9
        cx, cy, right = room[0, at + 1], room[0, at + 2], room[0, at + 3]
        xx -= cx * cx / weight
        xy -= cx * cy / weight
        yy -= cy * cy / weight
        rx -= cx * right / weight
        ry -= cy * right / weight
    if hard == 0:
        det = xx * yy - xy * xy
        if det > 0:
            return (rx * yy - ry * xy) / det, (ry * xx - rx * xy) / det
    elif hard == 1:
        curvature = xx * sx * sx + 2 * xy * sx * sy + yy * sy * sy
        if curvature > 0:
            along = (rx * sx + ry * sy) / curvature
            return along * sx, along * sy
    return 0.0, 0.0


@inner
def on_track(
    dx: float, dy: float, share: float, hard: int, sx: float, sy: float
) -> tuple[float, float]:
    """Return a share of a step, on the lattice, along the step (sx, sy) if `hard`."""
    if hard == 0:
        return on_lattice(dx * share), on_lattice(dy * share)
    along = np.rint((dx * sx + dy * sy) / (sx * sx + sy * sy) * share)
    return along * sx, along * sy


@inner
def new_heights(
    heights: Floats, a: int, bands: int, room: Floats, share: float, mx: float, my: float
) -> None:
    """Fill ``room[1]`` with the heights ``heights[a]`` after a step (mx, my) of the position."""
    for band in range(bands):
        at = OF_PLACE + OF_HEIGHT * band
        right = share * room[0, at + 3] - room[0, at + 1] * mx - room[0, at + 2] * my
        room[1, band] = heights[a, band] + right / (room[0, at] * 1.001 + 1e-9)


@inner
def sum_within(
    p: Points,
    values: Floats,
    image: Floats,
    star: Star,
    m: int,
    x: float,
    y: float,
    room: Floats,
    before: float,
    limit: float,
) -> float:
    """Return the sum of error^8 with a node at (x, y) that has the heights ``room[1]``.

    -1 if the sum is not below `before`, or an error is above `limit`.
    """
    total = 0.0
    for j in range(m):
        b, c = star.first[j], star.second[j]
        worst, _, _, part = triangle_error(
            values, image, x, y, p[b, 0], p[b, 1], p[c, 0], p[c, 1], room, 1, b, c
        )
        total += part
        if worst > limit or total >= before:
            return -1.0
    return total
