"""The nodes of a mesh and its edges as a graph, in the types of other libraries."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomesh.errors import MissingExtraError
from geomesh.mesh.topology import Edges
from geomesh.raster.grid import Points

LIBRARIES = ("scipy", "networkx", "libpysal")


def build_graph(places: Points, edges: Edges, library: str) -> Any:
    """Return the graph of nodes at `places` (N, 2) on the map: see `geomesh.Mesh.to_graph`."""
    from scipy import sparse

    if library not in LIBRARIES:
        raise ValueError(f"library is {library!r}: choose scipy, networkx or libpysal")
    ends = edges.nodes
    lengths = np.hypot(*(places[ends[:, 1]] - places[ends[:, 0]]).T)
    row, col = np.concatenate([ends, ends[:, ::-1]]).T
    matrix = sparse.csr_array((np.tile(lengths, 2), (row, col)), shape=(len(places), len(places)))
    try:
        if library == "networkx":
            import networkx

            return networkx.from_scipy_sparse_array(matrix)
        if library == "libpysal":
            from libpysal.graph import Graph

            return Graph.from_sparse(matrix)
    except ImportError as error:
        raise MissingExtraError(
            f"{library} is not installed: pip install 'geomesh-toolkit[graph]'"
        ) from error
    return matrix
