"""The engine of stage 4, CDT (pythoncdt): triangulates one set of points exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pythoncdt

from geomesh.arrays.jit import int32, int64, kernel, reads, uint32, writes
from geomesh.delaunay.inside import keep_inside
from geomesh.delaunay.ties import break_ties
from geomesh.errors import CertificateError, one_line
from geomesh.mesh.topology import FILL, edge_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids, Points, Triangles

# The first three vertices of the engine belong to a super-triangle around all points.
_AUXILIARY = 3

# For each 8-bit number, the same bits with a zero bit between neighbours.
_SPREAD = np.array(
    [sum((value >> bit & 1) << 2 * bit for bit in range(8)) for value in range(256)], np.uint16
)


class Patch(NamedTuple):
    """Triangles with their neighbours.

    Attributes
    ----------
    triangles : int32 (T, 3)
        Indices into the points, counter-clockwise. Each triangle starts with its lowest
        index; the triangles have no particular order.
    neighbours : int32 (T, 3)
        The triangle across the side opposite to corner k, or `FILL`.
    """

    triangles: Triangles
    neighbours: Triangles


def triangulate_points(
    points: Points,
    segments: NDArray[np.integer] | None = None,
    lines: NDArray[np.integer] | None = None,
) -> Patch:
    """Triangulate points (N, 2); with segments (S, 2), only the area inside their loops.

    Segments `lines` (L, 2) become edges too, but they bound nothing.

    `geomesh.delaunay.ties` breaks cocircular ties, so the set of triangles depends only on
    the points and the segments.

    Raises
    ------
    CertificateError
        If segments cross.
    """
    # Any: before Python 3.12 the type of an array does not say that it is a buffer.
    engine: Any = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    points = np.ascontiguousarray(points, np.float64)
    order = _along_curve(points)
    engine.insert_vertices(points[order])
    fixed = loops = np.empty(0, np.int64)
    if lines is not None and not len(lines):
        lines = None
    if segments is not None:
        fixed = loops = _constrain(engine, order, segments)
        if lines is None:
            engine.erase_outer_triangles_and_holes()
        else:
            fixed = np.union1d(fixed, _constrain(engine, order, lines))
    auxiliary = _AUXILIARY if segments is None or lines is not None else 0
    raw = engine.triangles_array(copy=False)
    vertices, across = np.ascontiguousarray(raw["vertices"]), np.ascontiguousarray(raw["neighbors"])
    place = np.empty(len(vertices), np.int32)
    triangles, neighbours = np.empty((2, len(vertices), 3), np.int32)
    count = _take_triangles(vertices, across, auxiliary, order, place, triangles, neighbours)
    triangles, neighbours = triangles[:count], neighbours[:count]
    if lines is not None:
        # The engine would take a closed line for the border of a hole.
        triangles, neighbours = keep_inside(triangles, neighbours, loops)
    break_ties(points, triangles, neighbours, fixed)
    return Patch(triangles, neighbours)


def spans_area(points: Points) -> bool:
    """Return whether three of the points (N, 2) form a triangle with an area."""
    # The first 100 points are usually enough.
    for some in (points[:100], points):
        offsets = some - points[:1]
        if len(some) > 2:
            far = offsets[np.abs(offsets).sum(axis=1).argmax()]
            if (offsets[:, 0] * far[1] != offsets[:, 1] * far[0]).any():
                return True
    return False


def _constrain(engine: Any, order: Ids, segments: NDArray[np.integer]) -> NDArray[np.int64]:
    """Insert segments, and return the keys of the edges that they are."""
    place = np.empty(len(order), np.uintc)
    place[order] = np.arange(len(order), dtype=np.uintc)
    try:
        engine.insert_edges(place[segments])
    except RuntimeError as error:
        raise CertificateError(
            f"the outline of the data, or a breakline, crosses itself ({one_line(error)}). This is "
            "a defect of geomesh: please report it with the source raster"
        ) from error
    # The engine splits a segment that goes through a point. This is rare.
    keys = edge_keys(segments)
    split = [
        each
        for each, originals in engine.piece_to_originals_iter()
        if np.isin(edge_keys(np.array([_ends(o, order) for o in originals])), keys).any()
    ]
    pieces = np.array([_ends(each, order) for each in split], np.int64).reshape(-1, 2)
    return np.unique(np.concatenate([keys, edge_keys(pieces)]))


def _ends(edge: Any, order: Ids) -> tuple[int, int]:
    """Return the points of an edge of the engine, before its super-triangle is erased."""
    return int(order[edge.v1 - _AUXILIARY]), int(order[edge.v2 - _AUXILIARY])


def _along_curve(points: Points) -> Ids:
    """Return the order of the points along a Z-order curve through 256 x 256 cells.

    In this order, neighbours in the plane are also close in memory.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 255.5 / max(float((high - low).max()), 1e-300)
    col, row = ((points - low) * scale).astype(np.uint8).T
    keys = _SPREAD[col] | _SPREAD[row] << np.uint16(1)
    return np.argsort(keys, kind="stable").astype(np.int32)  # 16-bit keys: a fast radix sort


@kernel(
    int64(
        reads(uint32, 2),
        reads(uint32, 2),
        int64,
        reads(int32, 1),
        writes(int32, 1),
        writes(int32, 2),
        writes(int32, 2),
    )
)
def _take_triangles(
    vertices: NDArray[np.uint32],
    across: NDArray[np.uint32],
    auxiliary: int,
    order: Ids,
    place: Ids,
    triangles: Triangles,
    neighbours: Triangles,
) -> int:
    """Convert the triangles and neighbours of the engine, and return their number.

    Triangles with one of the first `auxiliary` vertices are left out. The engine numbers the
    vertices along the curve; its neighbour k is across the side from corner k to k + 1.
    """
    count = 0
    for t in range(len(vertices)):
        place[t] = FILL
        if min(vertices[t, 0], vertices[t, 1], vertices[t, 2]) >= auxiliary:
            place[t] = count
            count += 1
    for t in range(len(vertices)):
        at = place[t]
        if at == FILL:
            continue
        first = 0
        for k in range(1, 3):
            if order[vertices[t, k] - auxiliary] < order[vertices[t, first] - auxiliary]:
                first = k
        for k in range(3):
            corner = (first + k) % 3
            triangles[at, k] = order[vertices[t, corner] - auxiliary]
            other = across[t, (corner + 1) % 3]
            neighbours[at, k] = place[other] if other < len(vertices) else FILL
    return count
