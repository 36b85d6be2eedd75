"""Keep the triangles inside closed loops, when other edges of the triangulation are fixed too."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.mesh.topology import FILL, edge_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Triangles


def keep_inside(
    triangles: Triangles, neighbours: Triangles, loops: NDArray[np.int64]
) -> tuple[Triangles, Triangles]:
    """Return the triangles inside loops, and their neighbours.

    A triangle is inside if the number of loops between it and infinity is odd.

    Parameters
    ----------
    triangles, neighbours : int32 (T, 3)
        Of a convex hull. Neighbour k is across the side opposite to corner k.
    loops : int64 (S,)
        Keys of the edges of the loops, in order: see `geomesh.mesh.topology.edge_keys`.
    """
    from scipy.sparse import coo_array  # slow to import, like csgraph
    from scipy.sparse.csgraph import connected_components, shortest_path

    count = len(triangles)
    ends = np.stack([triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]], axis=-1)
    keys = edge_keys(ends.reshape(-1, 2))
    place = np.minimum(np.searchsorted(loops, keys), len(loops) - 1)
    is_loop = loops[place] == keys
    here = np.repeat(np.arange(count), 3)
    there = neighbours.ravel().astype(np.int64)
    there[there == FILL] = count  # all that is outside of the hull

    def links(chosen: NDArray[np.bool_], names: NDArray[np.integer], size: int) -> coo_array:
        ones = np.ones(np.count_nonzero(chosen))
        return coo_array((ones, (names[here[chosen]], names[there[chosen]])), shape=(size, size))

    numbers = np.arange(count + 1)
    areas, area = connected_components(links(~is_loop, numbers, count + 1), directed=False)
    crossed = links(is_loop, area, areas).tocsr()
    distance = shortest_path(crossed, directed=False, unweighted=True, indices=int(area[count]))
    inside = distance[area[:count]] % 2 == 1
    renamed = np.full(count + 1, FILL, np.int32)
    renamed[:count][inside] = np.arange(np.count_nonzero(inside), dtype=np.int32)
    found = np.where(neighbours == FILL, count, neighbours)[inside]
    return np.ascontiguousarray(triangles[inside]), np.ascontiguousarray(renamed[found])
