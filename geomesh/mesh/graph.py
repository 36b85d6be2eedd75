"""A mesh as a graph of nodes and edges, for scipy, networkx or libpysal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import extra_required

if TYPE_CHECKING:
    from geomesh.arrays.types import Points
    from geomesh.mesh.topology import Edges

LIBRARIES = ("scipy", "networkx", "libpysal")


def build_graph(places: Points, edges: Edges, library: str) -> Any:
    """Return the graph of the nodes at map coordinates `places`: see `TriangleMesh.to_graph`.

    Parameters
    ----------
    places : float64 (N, 2)
    edges : Edges
    library : {"scipy", "networkx", "libpysal"}
    """
    from scipy import sparse

    if library not in LIBRARIES:
        raise ValueError(f"library is {library!r}: choose scipy, networkx or libpysal")
    ends = edges.nodes
    lengths = np.hypot(*(places[ends[:, 1]] - places[ends[:, 0]]).T)
    row, col = np.concatenate([ends, ends[:, ::-1]]).T
    matrix = sparse.csr_array((np.tile(lengths, 2), (row, col)), shape=(len(places), len(places)))
    if library == "scipy":
        return matrix
    with extra_required(library, "graph"):
        if library == "networkx":
            import networkx

            return networkx.from_scipy_sparse_array(matrix)
        from libpysal.graph import Graph

        return Graph.from_sparse(matrix)
