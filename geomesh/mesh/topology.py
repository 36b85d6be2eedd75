"""Who touches whom: pure functions on the integer arrays of a triangulation.

`FILL` (-1) marks "none", as in UGRID: the triangle beyond a boundary edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Triangles

FILL = -1


class Edges(NamedTuple):
    """The undirected edges of a triangulation, in read-only arrays.

    Attributes
    ----------
    nodes : int32 (E, 2)
        End nodes, the lower id first; rows in lexicographic order.
    left, right : int32 (E,)
        The triangle that runs along the edge from the lower to the higher node
        id, and the one that runs against it; `FILL` where there is none.
    uses : int32 (E,)
        In how many triangles the edge occurs: 2 inside, 1 on the boundary;
        anything else is a defect.
    """

    nodes: NDArray[np.int32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    uses: NDArray[np.int32]


def build_edges(triangles: Triangles) -> Edges:
    """Return the undirected edges of `triangles` (int32, (T, 3)).

    For counter-clockwise triangles `left` is the triangle on the left hand of
    someone walking from the edge's first node to its second.

    Raises
    ------
    ValueError
        If a node id is negative.
    """
    if triangles.min(initial=0) < 0:
        raise ValueError(f"node {triangles.min()} in a triangle: ids begin with 0")
    edges = Edges(*_unite(*_half_edges_in_order(triangles, int(triangles.max(initial=-1)) + 1)))
    for array in edges:
        array.flags.writeable = False
    return edges


@kernel
def _half_edges_in_order(
    triangles: Triangles, count: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return lower node, higher node and owner of each half-edge, in order of the two nodes.

    The owner is the triangle t, or ~t if it runs from the higher node to the lower.
    Two stable counting sorts of the half-edges of fewer than `count` nodes; they
    come as all 0-1, then 1-2, then 2-0.
    """
    low_stops, high_stops = np.zeros(count + 1, np.int64), np.zeros(count + 1, np.int64)
    for t in range(len(triangles)):
        for corner in range(3):
            a, b = triangles[t, corner], triangles[t, (corner + 1) % 3]
            low_stops[min(a, b) + 1] += 1
            high_stops[max(a, b) + 1] += 1
    low_stops, high_stops = np.cumsum(low_stops), np.cumsum(high_stops)
    size = 3 * len(triangles)
    by_high = np.empty((3, size), np.int32)
    for corner in range(3):
        for t in range(len(triangles)):
            a, b = triangles[t, corner], triangles[t, (corner + 1) % 3]
            place = high_stops[max(a, b)]
            high_stops[max(a, b)] += 1
            by_high[0, place], by_high[1, place] = min(a, b), max(a, b)
            by_high[2, place] = t if a < b else ~t
    low, high, owner = np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32)
    for k in range(size):
        place = low_stops[by_high[0, k]]
        low_stops[by_high[0, k]] += 1
        low[place], high[place], owner[place] = by_high[0, k], by_high[1, k], by_high[2, k]
    return low, high, owner


@kernel
def _unite(
    low: NDArray[np.int32], high: NDArray[np.int32], owner: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return nodes, left, right and uses of the edges; of several owners the last one stays."""
    count = 0
    for k in range(len(low)):
        if k == 0 or low[k] != low[k - 1] or high[k] != high[k - 1]:
            count += 1
    nodes, uses = np.empty((count, 2), np.int32), np.zeros(count, np.int32)
    left, right = np.empty(count, np.int32), np.empty(count, np.int32)
    edge = -1
    for k in range(len(low)):
        if k == 0 or low[k] != low[k - 1] or high[k] != high[k - 1]:
            edge += 1
            nodes[edge, 0], nodes[edge, 1] = low[k], high[k]
            left[edge] = right[edge] = FILL
        uses[edge] += 1
        if owner[k] >= 0:
            left[edge] = owner[k]
        else:
            right[edge] = ~owner[k]
    return nodes, left, right, uses


def edge_keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return one int64 a node pair (K, 2), the same for both directions."""
    one, other = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    keys: NDArray[np.int64] = (np.minimum(one, other) << 32) | np.maximum(one, other)
    return keys


def find_edges(edges: Edges, pairs: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the edge of each node pair (K, 2), in either direction, or `FILL` if there is none."""
    return _search(edges.nodes, np.asarray(pairs, np.int32))


@kernel
def _search(nodes: NDArray[np.int32], pairs: NDArray[np.int32]) -> NDArray[np.intp]:
    """Rows of `nodes`, each with the lower id first and all in order, that are the pairs."""
    found = np.empty(len(pairs), np.intp)
    for k in range(len(pairs)):
        low, high = min(pairs[k, 0], pairs[k, 1]), max(pairs[k, 0], pairs[k, 1])
        first, stop = 0, len(nodes)
        while first < stop:
            middle = (first + stop) // 2
            if nodes[middle, 0] < low or (nodes[middle, 0] == low and nodes[middle, 1] < high):
                first = middle + 1
            else:
                stop = middle
        known = first < len(nodes) and nodes[first, 0] == low and nodes[first, 1] == high
        found[k] = first if known else FILL
    return found


def neighbours(triangles: Triangles) -> NDArray[np.int32]:
    """Return, for each triangle, the triangle across the edge opposite to each corner.

    Returns
    -------
    int32 (T, 3)
        Column k is the neighbour that shares the edge opposite to node k, or `FILL`.
    """
    count = len(triangles)
    result = np.full((3, count), FILL, np.int32)
    # The half-edges: first all 0-1, then 1-2, then 2-0.
    keys = edge_keys(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]))
    order = np.argsort(keys, kind="stable")
    paired = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, other = order[paired], order[paired + 1]
    opposite = np.array([2, 0, 1])  # half-edge 0-1 lies opposite to corner 2, and so on
    result[opposite[one // count], one % count] = other % count
    result[opposite[other // count], other % count] = one % count
    return np.ascontiguousarray(result.T)


def boundary_edges(triangles: Triangles) -> NDArray[np.int32]:
    """Return the edges used by one triangle only, (B, 2), directed as in that triangle."""
    edges = build_edges(triangles)
    once = edges.uses == 1
    upward = (edges.left[once] != FILL)[:, None]
    pairs: NDArray[np.int32] = np.where(upward, edges.nodes[once], edges.nodes[once, ::-1])
    return pairs


def euler_number(triangles: Triangles) -> int:
    """Return nodes - edges + triangles, counting only the nodes that are used.

    1 for a disc, 0 for a disc with one hole; components add up.
    """
    nodes = len(np.unique(triangles))
    return nodes - len(build_edges(triangles).nodes) + len(triangles)
