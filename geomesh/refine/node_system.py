"""The system of one node: how its values and its position change the error of its triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import float64, inner, named, writes
from geomesh.refine.moments import OF_BAND, OF_PIXELS, product
from geomesh.refine.star import MOST_AROUND

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Points

# The system of one node: what a small change of its values and of its position does.
# 0 sum of weights squared, 1 to 3 xx, xy, yy of the position, 4 and 5 its right side, 6 the
# error now; then for each band the right side of its value, and its products with x and y.
OF_NODE, OF_VALUE = 7, 3

# Weight of a node's present value, as a number of pixels: the same as `surface.least_squares`.
RIDGE = 0.01


class Room(NamedTuple):
    """Room for results in between, so that loops need not allocate any.

    Attributes
    ----------
    systems : float64 (2, S)
        Systems of a node, at its place and at another one.
    rows : float64 (2 MOST_AROUND + 1, K)
        Moments: of the triangles around a node, then along the edges at it.
    """

    systems: Floats
    rows: Floats


ROOM = named(Room, writes(float64, 2), writes(float64, 2))

# In `Room.rows`: where moments along edges begin.
SPOKES = MOST_AROUND


def new_room(bands: int) -> Room:
    """Return room for the work on a patch with this number of bands."""
    return Room(
        np.zeros((2, OF_NODE + OF_VALUE * bands)),
        np.zeros((2 * MOST_AROUND + 1, OF_PIXELS + OF_BAND * bands)),
    )


@inner
def add_to_system(
    p: Points,
    values: Floats,
    m: Floats,
    i: int,
    x: float,
    y: float,
    v: int,
    b: int,
    c: int,
    systems: Floats,
    s: int,
) -> None:
    """Add a triangle (v, b, c) to the system `s` of the node `v` at (x, y).

    The surface changes by ``weight`` when the value of the node does, and by ``-weight *
    gradient`` when its position does.
    """
    if m[i, 0] <= 0:
        return
    bx, by = p[b, 0] - x, p[b, 1] - y
    cx, cy = p[c, 0] - x, p[c, 1] - y
    d = bx * cy - by * cx
    wx, wy = (by - cy) / d, (cx - bx) / d
    w = 1 - wx * x - wy * y
    ww = product(m, i, w, wx, wy, w, wx, wy)
    systems[s, 0] += ww
    for band in range(values.shape[1]):
        start = values[v, band]
        fb, fc = values[b, band] - start, values[c, band] - start
        gx, gy = (fb * cy - fc * by) / d, (fc * bx - fb * cx) / d
        g = start - gx * x - gy * y
        at = OF_PIXELS + OF_BAND * band
        right = (
            w * m[i, at]
            + wx * m[i, at + 1]
            + wy * m[i, at + 2]
            - product(m, i, w, wx, wy, g, gx, gy)
        )
        error = m[i, at + 3] - 2 * (g * m[i, at] + gx * m[i, at + 1] + gy * m[i, at + 2])
        systems[s, 6] += error + product(m, i, g, gx, gy, g, gx, gy)
        systems[s, 1] += ww * gx * gx
        systems[s, 2] += ww * gx * gy
        systems[s, 3] += ww * gy * gy
        systems[s, 4] -= right * gx
        systems[s, 5] -= right * gy
        at = OF_NODE + OF_VALUE * band
        systems[s, at] += right
        systems[s, at + 1] -= ww * gx
        systems[s, at + 2] -= ww * gy


@inner
def best_error(systems: Floats, s: int, bands: int) -> float:
    """Return the error of a node's triangles once its values are the best ones."""
    weight = systems[s, 0] + RIDGE
    total = systems[s, 6]
    for band in range(bands):
        right = systems[s, OF_NODE + OF_VALUE * band]
        step = right / weight
        total += step * (step * systems[s, 0] - 2 * right)
    return float(total)


@inner
def take_best_values(values: Floats, v: int, systems: Floats, s: int) -> None:
    """Change the values of node `v` to the best ones."""
    for band in range(values.shape[1]):
        values[v, band] += systems[s, OF_NODE + OF_VALUE * band] / (systems[s, 0] + RIDGE)
