"""Topology of a triangulation: edges, neighbours and boundary, from integer arrays.

`FILL` (-1) means "no triangle", for example on the outer side of a boundary edge. UGRID
uses the same value.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.order import stable_order

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids, Triangles

FILL = -1


class Edges(NamedTuple):
    """The undirected edges of a triangulation, in read-only arrays.

    Attributes
    ----------
    nodes : int32 (E, 2)
        End nodes, the lower id first; rows in lexicographic order.
    left, right : int32 (E,)
        The triangle whose corners follow the edge from the lower to the higher node id,
        and the triangle with the opposite direction; `FILL` if there is none.
    uses : int32 (E,)
        Number of triangles that have the edge: 2 inside, 1 on the boundary; any other
        number is a defect.
    """

    nodes: NDArray[np.int32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    uses: NDArray[np.int32]


def build_edges(triangles: Triangles) -> Edges:
    """Return the undirected edges of `triangles` (int32, (T, 3)).

    For counter-clockwise triangles, `left` is the triangle on the left side when you go
    from the first node of the edge to the second.

    Raises
    ------
    ValueError
        If a node id is negative.
    """
    if triangles.min(initial=0) < 0:
        raise ValueError(f"a triangle has the node id {triangles.min()}: ids start at 0")
    low, high, triangle, corner = _half_edges_in_order(triangles)
    first = np.ones(len(low), np.bool_)
    first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    edge = np.cumsum(first, dtype=np.int32) - np.int32(1)
    starts = np.flatnonzero(first)
    left, right = np.full((2, len(starts)), FILL, np.int32)
    upward = (triangles[triangle, corner] == low) & (low < high)
    left[edge[upward]] = triangle[upward]
    right[edge[~upward]] = triangle[~upward]
    uses = np.diff(starts, append=len(low)).astype(np.int32)
    edges = Edges(np.column_stack([low[first], high[first]]), left, right, uses)
    for array in edges:
        array.flags.writeable = False
    return edges


def _half_edges_in_order(triangles: Triangles) -> tuple[Ids, Ids, Ids, Ids]:
    """Return the lower node, higher node, triangle and first corner of each half-edge.

    Each array has the shape (3 T,). Half-edges are sorted by lower, then higher node; those
    of one edge are sorted by corners: first 0-1, then 1-2, then 2-0.
    """
    count = int(triangles.max(initial=-1)) + 1
    one = triangles.T.ravel()
    other = triangles[:, [1, 2, 0]].T.ravel()
    low, high = np.minimum(one, other), np.maximum(one, other)
    del one, other
    by_high = stable_order(high, count)
    order = by_high[stable_order(low[by_high], count)]
    corner, triangle = np.divmod(order, np.int32(max(len(triangles), 1)))
    return low[order], high[order], triangle, corner


def edge_keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return one int64 key for each node pair (K, 2), the same for both directions."""
    one, other = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    keys: NDArray[np.int64] = (np.minimum(one, other) << 32) | np.maximum(one, other)
    return keys


def find_edges(edges: Edges, pairs: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the edge number of each node pair (K, 2), or `FILL` if there is no such edge.

    The direction of a pair does not matter.
    """
    known, wanted = edge_keys(edges.nodes), edge_keys(np.asarray(pairs).reshape(-1, 2))
    if not len(known):
        return np.full(len(wanted), FILL, np.intp)
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    return np.where(known[place] == wanted, place, FILL)


def neighbours(triangles: Triangles) -> NDArray[np.int32]:
    """Return the three neighbours of each triangle.

    Returns
    -------
    int32 (T, 3)
        Column k is the neighbour across the side opposite to corner k, or `FILL`. The
        whole package uses this convention, as does `scipy.spatial.Delaunay`.
    """
    low, high, triangle, corner = _half_edges_in_order(triangles)
    result = np.full((len(triangles), 3), FILL, np.int32)
    paired = np.flatnonzero((low[1:] == low[:-1]) & (high[1:] == high[:-1]))
    # The side from corner k to corner k + 1 is opposite to corner k + 2.
    opposite = (corner + np.int32(2)) % np.int32(3)
    one, other = paired, paired + 1
    result[triangle[one], opposite[one]] = triangle[other]
    result[triangle[other], opposite[other]] = triangle[one]
    return result


def boundary_edges(triangles: Triangles) -> NDArray[np.int32]:
    """Return the edges of only one triangle, (B, 2), with the direction of that triangle."""
    edges = build_edges(triangles)
    once = edges.uses == 1
    upward = (edges.left[once] != FILL)[:, None]
    pairs: NDArray[np.int32] = np.where(upward, edges.nodes[once], edges.nodes[once, ::-1])
    return pairs


def euler_number(triangles: Triangles) -> int:
    """Return nodes - edges + triangles, counting only nodes that are in a triangle.

    It is 1 for a disc and 0 for a disc with one hole; the numbers of components add up.
    """
    nodes = len(np.unique(triangles))
    return nodes - len(build_edges(triangles).nodes) + len(triangles)
