"""Put triangles along a Hilbert curve, so that neighbours are near each other in a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.hilbert import along_hilbert

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points

_BITS = 16


@dataclass(frozen=True, eq=False)
class CurveOrder:
    """A mesh along a curve.

    Parameters
    ----------
    rows : int64 (T,)
        Ids of the triangles, in the order of the curve.
    nodes : int64 (N,)
        Ids of the nodes, in the order in which these triangles first use them. Nodes of no
        triangle are left out.
    triangles : int64 (T, 3)
        The corners as positions in `nodes`.
    """

    rows: NDArray[np.int64]
    nodes: NDArray[np.int64]
    triangles: NDArray[np.int64]


def order_along_curve(nodes: Points, triangles: NDArray[np.int32]) -> CurveOrder:
    """Return the triangles in the order of their middles along a Hilbert curve."""
    middles = nodes[triangles].mean(axis=1)
    low = middles.min(axis=0)
    span = float((middles.max(axis=0) - low).max()) or 1.0
    cells = ((middles - low) / span * (2**_BITS - 1)).astype(np.int64)
    rows = np.argsort(along_hilbert(cells[:, 0], cells[:, 1], _BITS), kind="stable").astype(
        np.int64
    )
    used, first, place = np.unique(triangles[rows], return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    rank = np.empty(len(used), np.int64)
    rank[by_use] = np.arange(len(used))
    return CurveOrder(rows, used[by_use].astype(np.int64), rank[place].reshape(-1, 3))


def ranks_of_rows(keys: tuple[NDArray[Any], ...]) -> NDArray[np.int64]:
    """Return the rank (n,) of each row when rows are sorted by `keys`, the last one first."""
    order = np.lexsort(keys)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank
