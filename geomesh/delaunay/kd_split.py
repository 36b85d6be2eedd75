"""Points split into tiles of about equal count, as by the upper levels of a k-d tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel

Split = tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.float64]]


@kernel
def split(points: NDArray[np.float64], most: int) -> Split:
    """Halve the points (N, 2) by count, across the longer side, until no more than `most` are left.

    Returns
    -------
    order : int32 (N,)
        The points of one tile after the other.
    stops : int64 (K,)
        Where each tile ends in `order`.
    boxes : float64 (K, 4)
        Low x, low y, high x, high y: no point of another tile is inside. Infinite on
        the outer sides; on the others they reach to the next tile's first point.
    """
    count = len(points)
    order = np.arange(count).astype(np.int32)
    tiles = 1
    while tiles * most < count:
        tiles *= 2
    stops, boxes = np.empty(tiles, np.int64), np.empty((tiles, 4))
    # A stack of what is still to be halved, the last part first.
    todo, bounds = np.empty((64, 2), np.int64), np.empty((64, 4))
    todo[0, 0], todo[0, 1] = 0, count
    bounds[0, 0] = bounds[0, 1] = -np.inf
    bounds[0, 2] = bounds[0, 3] = np.inf
    depth, done = 1, 0
    while depth > 0:
        depth -= 1
        start, stop = todo[depth]
        if stop - start <= most:
            stops[done], boxes[done] = stop, bounds[depth]
            done += 1
            continue
        low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
        for i in range(start, stop):
            x, y = points[order[i], 0], points[order[i], 1]
            low_x, high_x, low_y, high_y = (
                min(low_x, x),
                max(high_x, x),
                min(low_y, y),
                max(high_y, y),
            )
        axis = 0 if high_x - low_x >= high_y - low_y else 1
        middle = (start + stop) // 2
        _part(points, axis, order, start, stop - 1, middle)
        last = -np.inf
        for i in range(start, middle):
            last = max(last, points[order[i], axis])
        bounds[depth + 1] = bounds[depth]
        todo[depth, 0], todo[depth, 1], bounds[depth, axis] = middle, stop, last
        depth += 1
        todo[depth, 0], todo[depth, 1] = start, middle
        bounds[depth, axis + 2] = points[order[middle], axis]
        depth += 1
    return order, stops[:done], boxes[:done]


@kernel
def _part(
    points: NDArray[np.float64],
    axis: int,
    order: NDArray[np.int32],
    low: int,
    high: int,
    middle: int,
) -> None:
    """Reorder order[low : high + 1] until none before `middle` is above, none after it below it."""
    while low < high:
        a, b, c = (
            points[order[low], axis],
            points[order[(low + high) // 2], axis],
            points[order[high], axis],
        )
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return
