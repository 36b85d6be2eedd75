"""The check of a certificate that a triangulation is Delaunay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import float64, int32, int64, kernel, reads, void, writes
from geomesh.mesh.certificate import Check
from geomesh.mesh.topology import FILL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.mesh.topology import Edges

# Bound on the rounding error of the in-circle determinant in float64, relative to the
# sum of the absolute values of its terms (Shewchuk 1997, error bound A).
_EPSILON = 2.0**-53
_INCIRCLE_ERROR = (10 + 96 * _EPSILON) * _EPSILON


def check_delaunay(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    edges: Edges,
    fixed: NDArray[np.intp],
) -> Check:
    """Check that every inner edge that is not a constraint passes the in-circle test.

    If a triangulation is locally Delaunay at each edge, no circumcircle contains a
    visible node (Chew 1989). If the value of a test is within its rounding error, the
    edge counts as a tie: in float64 the four nodes cannot be told from cocircular ones.
    """
    inner = edges.uses == 2
    free = inner.copy()
    free[fixed[fixed != FILL]] = False
    constrained = np.count_nonzero(inner) - np.count_nonzero(free)
    # An edge used twice in one direction has no other side; the manifold check reports it.
    free &= (edges.left != FILL) & (edges.right != FILL)
    counts = np.zeros(2, np.int64)
    _test_circles(points, triangles, *edges[:3], np.flatnonzero(free).astype(np.int64), counts)
    violations, ties = counts.tolist()
    return Check(
        "empty circumcircles (Delaunay; constrained where constraints are)",
        violations == 0,
        f"{np.count_nonzero(free)} edges tested, {violations} violations, {ties} cocircular; "
        f"{constrained} inner edges constrained",
    )


@kernel(
    void(
        reads(float64, 2),
        reads(int32, 2),
        reads(int32, 2),
        reads(int32, 1),
        reads(int32, 1),
        reads(int64, 1),
        writes(int64, 1),
    )
)
def _test_circles(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    ends: NDArray[np.int32],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    free: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Count the right triangles' apexes inside and on the left triangles' circles.

    The determinant of the left corners, relative to the apex, is positive inside the circle
    once it is multiplied by the sign of the left triangle's area.
    """
    for i in range(len(free)):
        edge = free[i]
        one, other = left[edge], right[edge]
        a, b, c = triangles[one, 0], triangles[one, 1], triangles[one, 2]
        apex = triangles[other, 0] + triangles[other, 1] + triangles[other, 2]
        apex -= ends[edge, 0] + ends[edge, 1]
        ax, ay = points[a, 0] - points[apex, 0], points[a, 1] - points[apex, 1]
        bx, by = points[b, 0] - points[apex, 0], points[b, 1] - points[apex, 1]
        cx, cy = points[c, 0] - points[apex, 0], points[c, 1] - points[apex, 1]
        lift_a, lift_b, lift_c = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
        value = lift_a * (bx * cy - by * cx) + lift_b * (cx * ay - cy * ax)
        value += lift_c * (ax * by - ay * bx)
        size = lift_a * (abs(bx * cy) + abs(by * cx)) + lift_b * (abs(cx * ay) + abs(cy * ax))
        size += lift_c * (abs(ax * by) + abs(ay * bx))
        if (bx - ax) * (cy - ay) < (by - ay) * (cx - ax):
            value = -value
        counts[0] += value > _INCIRCLE_ERROR * size
        counts[1] += abs(value) <= _INCIRCLE_ERROR * size
