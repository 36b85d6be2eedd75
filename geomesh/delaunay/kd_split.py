"""Points split into tiles of about equal count, as by the upper levels of a k-d tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.types import Floats, Ids, Points

Split = tuple[Ids, NDArray[np.int64], Floats]


def split(points: Points, most: int) -> Split:
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
    order = np.arange(len(points), dtype=np.int32)
    stops, boxes = [], []
    # What is still to be halved, the last part first.
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
