"""The engine of stage 4, CDT (pythoncdt): one exact triangulation of one set of points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pythoncdt
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.arrays.types import Triangles
from geomesh.delaunay.ties import break_ties
from geomesh.errors import CertificateError, one_line
from geomesh.mesh.topology import FILL, edge_keys

# What hangs on the vertices of the engine's super-triangle, its first three, goes.
_AUXILIARY = 3


class Patch(NamedTuple):
    """Triangles that know their neighbours.

    Attributes
    ----------
    triangles : int32 (T, 3)
        Indices into the points, counter-clockwise, in no particular order.
    across : int32 (T, 3)
        The triangle over the edge from corner k to corner k + 1, or `FILL`.
    """

    triangles: Triangles
    across: Triangles


def triangulate(points: NDArray[np.float64], segments: NDArray[np.integer] | None = None) -> Patch:
    """Triangulate points (N, 2); with segments (S, 2), only the area inside their loops.

    Cocircular ties are broken by `geomesh.ties`: the triangles, as a set, depend on
    points and segments alone.

    Raises
    ------
    CertificateError
        If segments cross.
    """
    # Typed Any: that arrays are buffers is known to their type from Python 3.12 on only.
    engine: Any = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    order = _along_curve(points)
    engine.insert_vertices(points[order])
    fixed = np.empty(0, np.int64)
    if segments is not None:
        fixed = _constrain(engine, order, segments)
    auxiliary = _AUXILIARY if segments is None else 0
    # Views of the engine's memory: they must not outlive it, nor this function.
    raw = engine.triangles_array(copy=False)
    ordered = engine.vertices_array(copy=False).view(np.float64).reshape(-1, 2)[auxiliary:]
    triangles, across = _strip(raw["vertices"], raw["neighbors"], auxiliary)
    break_ties(ordered, triangles, across, fixed)
    _renumber(triangles, order)
    return Patch(triangles, across)


def spans_area(points: NDArray[np.float64]) -> bool:
    """Tell whether three of the points (N, 2) make a triangle; a few of them mostly do."""
    for some in (points[:100], points):
        offsets = some - points[:1]
        if len(some) > 2:
            far = offsets[np.abs(offsets).sum(axis=1).argmax()]
            if (offsets[:, 0] * far[1] != offsets[:, 1] * far[0]).any():
                return True
    return False


def _constrain(
    engine: Any, order: NDArray[np.int32], segments: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Insert segments, erase what lies outside their loops; return the keys of fixed edges.

    The keys are of places in `order`.
    """
    place = np.empty(len(order), np.uintc)
    place[order] = np.arange(len(order), dtype=np.uintc)
    placed = place[segments]
    try:
        engine.insert_edges(placed)
    except RuntimeError as error:
        raise CertificateError(
            f"the outline of the data crosses itself ({one_line(error)}). This is a defect of "
            "geomesh: please report it with the source raster"
        ) from error
    engine.erase_outer_triangles_and_holes()
    # A segment that runs through a point was split there: few do, or none.
    pieces = [(edge.v1, edge.v2) for edge, _ in engine.piece_to_originals_iter()]
    pairs = np.concatenate([placed, np.array(pieces, np.uintc).reshape(-1, 2)])
    return np.unique(edge_keys(pairs))


@kernel
def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Order of the points along a Z-order curve through 256 x 256 cells.

    Neighbours on the plane then lie close in memory.
    """
    count = len(points)
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for p in range(count):
        low_x, high_x = min(low_x, points[p, 0]), max(high_x, points[p, 0])
        low_y, high_y = min(low_y, points[p, 1]), max(high_y, points[p, 1])
    scale = 255.5 / max(high_x - low_x, high_y - low_y, 1e-300)
    keys = np.empty(count, np.uint16)
    starts = np.zeros(65_537, np.int64)
    for p in range(count):
        col, row = int((points[p, 0] - low_x) * scale), int((points[p, 1] - low_y) * scale)
        key = 0
        for bit in range(8):
            key |= ((col >> bit) & 1) << (2 * bit) | ((row >> bit) & 1) << (2 * bit + 1)
        keys[p] = key
        starts[key + 1] += 1
    for key in range(65_536):
        starts[key + 1] += starts[key]
    order = np.empty(count, np.int32)
    for p in range(count):
        order[starts[keys[p]]] = p
        starts[keys[p]] += 1
    return order


@kernel
def _strip(
    vertices: NDArray[np.uint32], neighbours: NDArray[np.uint32], auxiliary: int
) -> tuple[Triangles, Triangles]:
    """Return triangles and neighbours without those on the first `auxiliary` vertices."""
    place = np.full(len(vertices), FILL, np.int32)
    count = 0
    for t in range(len(vertices)):
        if min(vertices[t, 0], vertices[t, 1], vertices[t, 2]) >= auxiliary:
            place[t] = count
            count += 1
    triangles = np.empty((count, 3), np.int32)
    across = np.empty((count, 3), np.int32)
    for t in range(len(vertices)):
        if place[t] != FILL:
            for k in range(3):
                triangles[place[t], k] = vertices[t, k] - auxiliary
                other = neighbours[t, k]
                across[place[t], k] = place[other] if other < len(vertices) else FILL
    return triangles, across


@kernel
def _renumber(triangles: Triangles, order: NDArray[np.int32]) -> None:
    """Replace places in `order` by what stands there."""
    for t in range(len(triangles)):
        for k in range(3):
            triangles[t, k] = order[triangles[t, k]]
