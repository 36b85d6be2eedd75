"""Columns of the layer of edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.table import Table
from geomesh.mesh.topology import FILL, Edges, find_edges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points


def edge_columns(edges: Edges, constraints: NDArray[np.int32], points: Points) -> Table:
    """Return the columns of the layer of edges: ends, triangles beside, length, constrained.

    Parameters
    ----------
    edges : Edges
    constraints : int32 (C, 2)
        Pairs of nodes.
    points : float64 (N, 2)
        The nodes in the plane in which lengths are measured.
    """
    (x, y), (start, stop) = points.T, edges.nodes.T
    constrained = np.zeros(len(edges.nodes), np.bool_)
    found = find_edges(edges, constraints)
    constrained[found[found != FILL]] = True
    return Table(
        {
            "id": np.arange(len(edges.nodes), dtype=np.int32),
            "n0": edges.nodes[:, 0],
            "n1": edges.nodes[:, 1],
            "left": edges.left,
            "right": edges.right,
            "length": np.hypot(x[stop] - x[start], y[stop] - y[start]),
            "constrained": constrained,
        }
    )
