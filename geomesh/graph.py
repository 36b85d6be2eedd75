"""A mesh as a graph, for the libraries that know graphs."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from scipy import sparse

from geomesh.errors import MissingExtraError
from geomesh.mesh import Mesh


def build_graph(mesh: Mesh, library: Literal["scipy", "networkx", "libpysal"] = "scipy") -> Any:
    """Return the nodes of a mesh, joined by its edges; see `geomesh.Mesh.to_graph`."""
    if library not in ("scipy", "networkx", "libpysal"):
        raise ValueError(f"library is {library!r}: choose scipy, networkx or libpysal")
    ends = mesh.edges.nodes
    lengths = np.hypot(*(mesh.map_nodes[ends[:, 1]] - mesh.map_nodes[ends[:, 0]]).T)
    row, col = np.concatenate([ends, ends[:, ::-1]]).T
    count = len(mesh.nodes)
    matrix = sparse.csr_array((np.tile(lengths, 2), (row, col)), shape=(count, count))
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
