"""Counting sort: for small whole numbers it is faster than a sort by comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import int32, int64, kernel, reads, void, writes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids


def stable_order(keys: NDArray[np.integer], count: int) -> Ids:
    """Return the order, int32 (n,), that sorts the keys. Equal keys keep their order.

    Parameters
    ----------
    keys : int (n,)
        From 0 to `count` - 1.
    count : int
    """
    order: NDArray[np.int32] = np.empty(len(keys), np.int32)
    _count_and_place(np.ascontiguousarray(keys, np.int32), np.zeros(count + 1, np.int64), order)
    return order


@kernel(void(reads(int32, 1), writes(int64, 1), writes(int32, 1)))
def _count_and_place(keys: Ids, starts: NDArray[np.int64], order: Ids) -> None:
    for i in range(len(keys)):
        starts[keys[i] + 1] += 1
    for key in range(1, len(starts)):
        starts[key] += starts[key - 1]
    for i in range(len(keys)):
        order[starts[keys[i]]] = i
        starts[keys[i]] += 1
