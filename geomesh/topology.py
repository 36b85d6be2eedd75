"""Who touches whom: pure functions on the integer arrays of a triangulation.

`FILL` (-1) marks "none", as in UGRID: the triangle beyond a boundary edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FILL = -1

Triangles = NDArray[np.int32]


class Edges(NamedTuple):
    """The undirected edges of a triangulation.

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
    """
    keys, forward = _half_edges(triangles)
    order = np.argsort(keys, kind="stable")
    keys, forward = keys[order], forward[order]
    owner = (order % max(len(triangles), 1)).astype(np.int32)
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    uses = np.diff(np.append(first, len(keys))).astype(np.int32)
    edge_of = np.repeat(np.arange(len(first)), uses)
    left = np.full(len(first), FILL, np.int32)
    right = np.full(len(first), FILL, np.int32)
    left[edge_of[forward]] = owner[forward]
    right[edge_of[~forward]] = owner[~forward]
    nodes = np.column_stack([keys[first] >> 32, keys[first] & 0xFFFFFFFF]).astype(np.int32)
    return Edges(nodes, left, right, uses)


def edge_keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return one int64 a node pair (K, 2), the same for both directions."""
    one, other = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    keys: NDArray[np.int64] = (np.minimum(one, other) << 32) | np.maximum(one, other)
    return keys


def find_edges(edges: Edges, pairs: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the edge of each node pair (K, 2), in either direction, or `FILL` if there is none."""
    known, wanted = edge_keys(edges.nodes), edge_keys(pairs)
    place = np.searchsorted(known, wanted)
    found = place < len(known)
    found[found] = known[place[found]] == wanted[found]
    return np.where(found, place, FILL)


def _half_edges(triangles: Triangles) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Keys of the 3T half-edges (first all 0-1, then 1-2, then 2-0) and whether each runs up."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return edge_keys(pairs), pairs[:, 0] < pairs[:, 1]


def neighbours(triangles: Triangles) -> NDArray[np.int32]:
    """Return, for each triangle, the triangle across the edge opposite to each corner.

    Returns
    -------
    int32 (T, 3)
        Column k is the neighbour that shares the edge opposite to node k, or `FILL`.
    """
    count = len(triangles)
    result = np.full((3, count), FILL, np.int32)
    keys, _ = _half_edges(triangles)
    order = np.argsort(keys, kind="stable")
    paired = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, other = order[paired], order[paired + 1]
    opposite = np.array([2, 0, 1])  # half-edge 0-1 lies opposite to corner 2, and so on
    result[opposite[one // count], one % count] = other % count
    result[opposite[other // count], other % count] = one % count
    return np.ascontiguousarray(result.T)


def boundary_edges(triangles: Triangles) -> NDArray[np.int32]:
    """Return the edges used by one triangle only, (B, 2), directed as in that triangle."""
    keys, forward = _half_edges(triangles)
    _, index, uses = np.unique(keys, return_index=True, return_counts=True)
    index = index[uses == 1]
    low, high = keys[index] >> 32, keys[index] & 0xFFFFFFFF
    up = forward[index]
    return np.column_stack([np.where(up, low, high), np.where(up, high, low)]).astype(np.int32)


def euler_number(triangles: Triangles) -> int:
    """Return nodes - edges + triangles, counting only the nodes that are used.

    1 for a disc, 0 for a disc with one hole; components add up.
    """
    nodes = len(np.unique(triangles))
    return nodes - len(build_edges(triangles).nodes) + len(triangles)
