"""Split points into tiles of about equal count, like the upper levels of a k-d tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.types import Floats, Ids, Points

Split = tuple[Ids, NDArray[np.int64], Floats]


def split(points: Points, most: int) -> Split:
    """Split points (N, 2) in half, again and again, until no tile has more than `most` points.

    Each split is across the longer side and gives two halves of equal count.

    Returns
    -------
    order : int32 (N,)
        Point numbers, tile after tile.
    stops : int64 (K,)
        Where each tile ends in `order`.
    boxes : float64 (K, 4)
        Low x, low y, high x, high y of each tile. No point of another tile is inside.
        Outer sides are infinite; other sides reach to the first point of the next tile.
    """
    order = np.arange(len(points), dtype=np.int32)
    stops, boxes = [], []
    # Parts that still have to be split: a stack.
    todo = [(0, len(points), np.array([-np.inf, -np.inf, np.inf, np.inf]))]
    while todo:
        start, stop, box = todo.pop()
        if stop - start <= most:
            stops.append(stop)
            boxes.append(box)
            continue
        part = points[order[start:stop]]
        axis = int(np.ptp(part, axis=0).argmax())
        half = (stop - start) // 2
        order[start:stop] = order[start:stop][np.argpartition(part[:, axis], half)]
        lower, upper = box.copy(), box.copy()
        lower[axis + 2] = points[order[start + half], axis]
        upper[axis] = points[order[start : start + half], axis].max()
        todo += [(start + half, stop, upper), (start, start + half, lower)]
    return order, np.array(stops, np.int64), np.array(boxes)
