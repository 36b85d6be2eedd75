"""The compiled loops of `geomesh.zonal`: over the pixels of triangles, over partial results."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
from geomesh.zonal.rasterize import Corners, column_range, row_range, sort_corners


@kernel
def near_box(nodes: Points, triangles: Triangles, box: tuple[int, int, int, int]) -> Ids:
    """Return the triangles whose bounding box meets the box (left, right, top, bottom)."""
    left, right, top, bottom = box
    found = np.empty(len(triangles), np.int32)
    count = 0
    for t in range(len(triangles)):
        ax, ay = nodes[triangles[t, 0], 0], nodes[triangles[t, 0], 1]
        bx, by = nodes[triangles[t, 1], 0], nodes[triangles[t, 1], 1]
        cx, cy = nodes[triangles[t, 2], 0], nodes[triangles[t, 2], 1]
        beside = min(ax, bx, cx) > right or max(ax, bx, cx) < left
        if not (beside or min(ay, by, cy) > bottom or max(ay, by, cy) < top):
            found[count] = t
            count += 1
    return found[:count].copy()


@kernel
def bin_triangles(
    nodes: Points, triangles: Triangles, cols: Floats, rows: Floats
) -> tuple[NDArray[np.int64], Ids]:
    """Return which triangles' bounding boxes meet each tile, in compressed sparse rows.

    Tiles begin at `cols` and `rows`, the last ones end nowhere. A border is met from
    both sides, so that what `near_box` finds is always among them.
    """
    count = len(cols) * len(rows)
    starts = np.zeros(count + 1, np.int64)
    met = np.empty(0, np.int32)
    for fill in (False, True):
        if fill:
            for k in range(count):
                starts[k + 1] += starts[k]
            met = np.empty(starts[count], np.int32)
            stops = starts[:-1].copy()
        for t in range(len(triangles)):
            a, b, c = nodes[triangles[t, 0]], nodes[triangles[t, 1]], nodes[triangles[t, 2]]
            left = max(np.searchsorted(cols, min(a[0], b[0], c[0]), side="left") - 1, 0)
            right = max(np.searchsorted(cols, max(a[0], b[0], c[0]), side="right"), 1)
            top = max(np.searchsorted(rows, min(a[1], b[1], c[1]), side="left") - 1, 0)
            bottom = max(np.searchsorted(rows, max(a[1], b[1], c[1]), side="right"), 1)
            for row in range(top, bottom):
                for col in range(left, right):
                    k = row * len(cols) + col
                    if fill:
                        met[stops[k]] = t
                        stops[k] += 1
                    else:
                        starts[k + 1] += 1
    return starts, met


@kernel
def scan_triangles(
    nodes: Points,
    triangles: Triangles,
    chosen: Ids,
    values: NDArray[Any],
    valid: NDArray[np.bool_],
    origin: tuple[int, int],
    box: tuple[int, int, int, int],
    pixels: Counts,
    count: Counts,
    moments: Floats,
) -> None:
    """Fill `pixels`, `count` (K,) and `moments` (4, B, K): mean, m2, low, high.

    `values` (B, h * w) and `valid` (h, w) begin at the pixel `origin` (row, col);
    only those in `box` (first and stop row, first and stop column) are counted.
    """
    members = np.empty((box[1] - box[0]) * (box[3] - box[2]), np.int32)
    for k in range(len(chosen)):
        a, b, c = triangles[chosen[k]]
        corners = sort_corners(
            nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        )
        pixels[k], count[k] = _collect(corners, valid, origin, box, members)
        if count[k] > 0:
            for band in range(len(values)):
                mean, m2, low, high = _moments(values[band], members[: count[k]])
                moments[0, band, k], moments[1, band, k] = mean, m2
                moments[2, band, k], moments[3, band, k] = low, high


@kernel
def _collect(
    corners: Corners,
    valid: NDArray[np.bool_],
    origin: tuple[int, int],
    box: tuple[int, int, int, int],
    members: NDArray[np.int32],
) -> tuple[int, int]:
    """List the flat positions of a triangle's valid pixels; return (owned, valid) pixels."""
    owned, found = 0, 0
    top, bottom = row_range(corners, box[0], box[1])
    for row in range(top, bottom):
        first, last = column_range(corners, row, box[2], box[3])
        owned += max(last - first, 0)
        r, shift = row - origin[0], (row - origin[0]) * valid.shape[1] - origin[1]
        for col in range(first, last):
            # Written in any case, kept if valid: a branch would cost more.
            members[found] = shift + col
            found += valid[r, col - origin[1]]
    return owned, found


@kernel
def _moments(values: NDArray[Any], members: NDArray[np.int32]) -> tuple[float, float, float, float]:
    """Mean, sum of squared deviations, least and greatest of ``values[members]``.

    Sums are taken relative to the first value: it is one of those measured, so the
    correction subtracted at the end is of the order of the sum itself. For whole
    numbers of up to 16 bits every sum is exact.
    """
    start = np.float64(values[members[0]])
    total, squares, low, high = 0.0, 0.0, start, start
    for member in members:
        value = np.float64(values[member])
        difference = value - start
        total += difference
        squares += difference * difference
        low, high = min(low, value), max(high, value)
    shift = total / len(members)
    return start + shift, max(squares - total * shift, 0.0), low, high


@kernel
def add(
    index: Ids,
    part_pixels: Counts,
    part_count: Counts,
    part_moments: Floats,
    pixels: Counts,
    count: Counts,
    moments: Floats,
) -> None:
    """Add what one tile found, (K,) and (4, B, K), to the whole, (T,) and (4, B, T)."""
    for k in range(len(index)):
        t = index[k]
        pixels[t] += part_pixels[k]
        before = count[t]
        count[t] += part_count[k]
        if part_count[k] == 0:
            continue
        share = part_count[k] / count[t]
        for band in range(moments.shape[1]):
            mean, m2, low, high = part_moments[:, band, k]
            delta = mean - moments[0, band, t]
            moments[0, band, t] += delta * share
            moments[1, band, t] += m2 + delta * (before * share) * delta
            moments[2, band, t] = min(moments[2, band, t], low)
            moments[3, band, t] = max(moments[3, band, t], high)


@kernel
def blend(
    points: Points,
    bands: NDArray[Any],
    valid: NDArray[np.bool_],
    origin: tuple[int, int],
    values: Floats,
) -> None:
    """Fill `values` (B, P): bilinear between the four pixel centres around each point.

    The weights of pixels that are not valid, or beyond the image, go to the others. Taken
    relative to one of them, so that among equal pixels the value is theirs to the last bit.
    """
    height, width = valid.shape
    for p in range(len(points)):
        x, y = points[p, 0] - 0.5 - origin[1], points[p, 1] - 0.5 - origin[0]
        left, top = math.floor(x), math.floor(y)
        total, r, c = 0.0, 0, 0
        values[:, p] = 0.0
        for row in (top, top + 1):
            for col in (left, left + 1):
                if 0 <= row < height and 0 <= col < width and valid[row, col]:
                    weight = (1 - abs(x - col)) * (1 - abs(y - row))
                    if total == 0:
                        r, c = row, col
                    total += weight
                    for band in range(len(bands)):
                        start = np.float64(bands[band, r, c])
                        values[band, p] += weight * (np.float64(bands[band, row, col]) - start)
        for band in range(len(bands)):
            # 0 / 0, and so NaN, without a valid pixel.
            values[band, p] = np.float64(bands[band, r, c]) + values[band, p] / total
