"""Volumes between a triangle and what is below or above it, exactly for linear surfaces.

The difference of two linear surfaces is linear on each common part of their triangles. Where it
changes its sign, the part is cut along the line on which it is zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import float64, inner, int64, kernel, reads, void, writes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats

# Columns of the results: volume above and below, and the areas where it is so. Where the
# difference is zero counts as above.
ABOVE, BELOW, AREA_ABOVE, AREA_BELOW = range(4)

# Scratch for the kernels: four polygons. A triangle that is cut by five lines has at most eight
# corners.
SCRATCH = (4, 8)


def prisms(differences: Floats, areas: Floats) -> Floats:
    """Return volumes and areas (T, 4) of triangles above and below zero.

    Parameters
    ----------
    differences : float64 (T, 3)
        Of two linear surfaces, at the corners. NaN gives NaN.
    areas : float64 (T,)
    """
    h = np.sort(differences, axis=1)
    low, middle, high = h.T
    # The corner that is alone on its side of zero, and the part of the triangle that it cuts off.
    alone = np.where(middle >= 0, low, high)
    others = np.where(middle >= 0, middle, low), np.where(middle >= 0, high, middle)
    is_cut = (low < 0) & (high >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = alone / (alone - others[0]) * (alone / (alone - others[1]))
    share = np.where(is_cut, share, np.where(high < 0, 1.0, 0.0))
    tip = np.where(is_cut, share * alone / 3, 0.0)
    mean = h.mean(axis=1)
    below = np.where(is_cut, np.where(middle >= 0, -tip, tip - mean), np.where(high < 0, -mean, 0))
    below_share = np.where(is_cut & (middle < 0), 1 - share, share)
    unknown = np.isnan(mean)
    above = mean + below
    result = np.column_stack([above, below, 1 - below_share, below_share]) * areas[:, None]
    result[unknown] = np.nan
    return result


@inner
def _clip(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    source: int,
    target: int,
    count: int,
    a: float,
    b: float,
    c: float,
) -> int:
    """Copy the part of a convex polygon where a x + b y + c >= 0 from one row to another."""
    kept = 0
    px, py = x[source, count - 1], y[source, count - 1]
    before = a * px + b * py + c
    for k in range(count):
        qx, qy = x[source, k], y[source, k]
        after = a * qx + b * qy + c
        if (before >= 0.0) != (after >= 0.0):
            share = before / (before - after)
            x[target, kept] = px + share * (qx - px)
            y[target, kept] = py + share * (qy - py)
            kept += 1
        if after >= 0.0:
            x[target, kept] = qx
            y[target, kept] = qy
            kept += 1
        px, py, before = qx, qy, after
    return kept


@inner
def _integrate(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    row: int,
    count: int,
    a: float,
    b: float,
    c: float,
    sign: float,
    found: NDArray[np.float64],
) -> None:
    """Add the volume of sign (a x + b y + c) over a convex polygon, and its area, to `found`."""
    for k in range(1, count - 1):
        ux, uy = x[row, k] - x[row, 0], y[row, k] - y[row, 0]
        vx, vy = x[row, k + 1] - x[row, 0], y[row, k + 1] - y[row, 0]
        area = abs(ux * vy - uy * vx) / 2
        middle_x = x[row, 0] + (ux + vx) / 3
        middle_y = y[row, 0] + (uy + vy) / 3
        found[0] += sign * area * (a * middle_x + b * middle_y + c)
        found[1] += area


@inner
def _add_parts(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    count: int,
    a: float,
    b: float,
    c: float,
    part: NDArray[np.float64],
    found: NDArray[np.float64],
) -> None:
    """Add what is above and below a x + b y + c = 0 in the polygon of row 0 to `found` (4,)."""
    part[0], part[1] = 0.0, 0.0
    _integrate(x, y, 2, _clip(x, y, 0, 2, count, a, b, c), a, b, c, 1.0, part)
    found[0] += part[0]
    found[2] += part[1]
    part[0], part[1] = 0.0, 0.0
    _integrate(x, y, 2, _clip(x, y, 0, 2, count, -a, -b, -c), a, b, c, -1.0, part)
    found[1] += part[0]
    found[3] += part[1]


@kernel(
    void(
        reads(float64, 3), reads(float64, 3), reads(int64, 2),
        writes(float64, 2), writes(float64, 2), writes(float64, 1), writes(float64, 2),
    )
)  # fmt: skip
def overlay(
    triangles: NDArray[np.float64],
    others: NDArray[np.float64],
    pairs: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    part: NDArray[np.float64],
    found: NDArray[np.float64],
) -> None:
    """Add the volumes between the common parts of triangles to `found` (T, 4).

    Parameters
    ----------
    triangles : float64 (T, 3, 3)
        x, y and height of the corners, in any order of turning.
    others : float64 (U, 3, 3)
        What to compare with; counter-clockwise.
    pairs : int64 (P, 2)
        A triangle of each, that may touch.
    x, y : float64 SCRATCH
        Scratch.
    part : float64 (2,)
        Scratch.
    found : float64 (T, 4)
        Above, below, area above, area below: in the units of the coordinates.
    """
    for pair in range(len(pairs)):
        t, u = pairs[pair]
        one, other = triangles[t], others[u]
        # Near the origin, differences of coordinates lose no digits.
        ox, oy = one[0, 0], one[0, 1]
        for k in range(3):
            x[0, k], y[0, k] = one[k, 0] - ox, one[k, 1] - oy
        count, row = 3, 0
        for k in range(3):
            sx, sy = other[k, 0] - ox, other[k, 1] - oy
            dx, dy = other[(k + 1) % 3, 0] - ox - sx, other[(k + 1) % 3, 1] - oy - sy
            count = _clip(x, y, row, 1 - row, count, -dy, dx, dy * sx - dx * sy)
            row = 1 - row
            if count < 3:
                break
        if count < 3:
            continue
        for k in range(count):
            x[0, k], y[0, k] = x[row, k], y[row, k]
        a, b, c = 0.0, 0.0, 0.0
        for sign, each in ((1.0, one), (-1.0, other)):
            ux, uy, uz = each[1, 0] - each[0, 0], each[1, 1] - each[0, 1], each[1, 2] - each[0, 2]
            vx, vy, vz = each[2, 0] - each[0, 0], each[2, 1] - each[0, 1], each[2, 2] - each[0, 2]
            doubled = ux * vy - uy * vx
            east, north = (uz * vy - vz * uy) / doubled, (vz * ux - uz * vx) / doubled
            a += sign * east
            b += sign * north
            c += sign * (each[0, 2] - east * (each[0, 0] - ox) - north * (each[0, 1] - oy))
        _add_parts(x, y, count, a, b, c, part, found[t])


@kernel(
    void(
        reads(float64, 3), reads(int64, 1), reads(float64, 2), float64, float64,
        writes(float64, 2), writes(float64, 2), writes(float64, 1), writes(float64, 2),
    )
)  # fmt: skip
def overlay_pixels(
    triangles: NDArray[np.float64],
    chosen: NDArray[np.int64],
    values: NDArray[np.float64],
    first_column: float,
    first_row: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    part: NDArray[np.float64],
    found: NDArray[np.float64],
) -> None:
    """Add the volumes between triangles and the pixels of a window to `found` (T, 4).

    Parameters
    ----------
    triangles : float64 (T, 3, 3)
        Column, row and height of the corners.
    chosen : int64 (C,)
        The triangles to look at.
    values : float64 (h, w)
        Heights of the pixels of a window; NaN where there is none.
    first_column, first_row : float
        Of the window.
    x, y, part, found
        As in `overlay`.
    """
    height, width = values.shape
    for number in range(len(chosen)):
        t = chosen[number]
        one = triangles[t]
        ox, oy, oz = one[0, 0], one[0, 1], one[0, 2]
        ux, uy, uz = one[1, 0] - ox, one[1, 1] - oy, one[1, 2] - oz
        vx, vy, vz = one[2, 0] - ox, one[2, 1] - oy, one[2, 2] - oz
        doubled = ux * vy - uy * vx
        a, b = (uz * vy - vz * uy) / doubled, (vz * ux - uz * vx) / doubled
        low = max(int(np.floor(min(one[0, 1], one[1, 1], one[2, 1]) - first_row)), 0)
        high = min(int(np.ceil(max(one[0, 1], one[1, 1], one[2, 1]) - first_row)), height)
        for i in range(low, high):
            for k in range(3):
                x[0, k], y[0, k] = one[k, 0] - ox, one[k, 1] - oy
            top = first_row + i - oy
            count = _clip(x, y, 0, 1, 3, 0.0, 1.0, -top)
            if count < 3:
                continue
            count = _clip(x, y, 1, 3, count, 0.0, -1.0, top + 1.0)
            if count < 3:
                continue
            west, east = x[3, 0], x[3, 0]
            for k in range(1, count):
                west, east = min(west, x[3, k]), max(east, x[3, k])
            begin = max(int(np.floor(west + ox - first_column)), 0)
            end = min(int(np.ceil(east + ox - first_column)), width)
            for j in range(begin, end):
                if np.isnan(values[i, j]):
                    continue
                left = first_column + j - ox
                inside = _clip(x, y, 3, 1, count, 1.0, 0.0, -left)
                if inside < 3:
                    continue
                inside = _clip(x, y, 1, 0, inside, -1.0, 0.0, left + 1.0)
                if inside < 3:
                    continue
                _add_parts(x, y, inside, a, b, oz - values[i, j], part, found[t])
