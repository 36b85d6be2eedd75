"""Make, compare and check triangulations of points."""

from fractions import Fraction

import numpy as np
import shapely
from scipy.spatial import Delaunay

from geomesh.mesh.topology import neighbours


def as_sets(triangles):
    return {frozenset(map(int, triangle)) for triangle in triangles}


def exact(value):
    """Return a coordinate as an int if possible, because that is faster, or else as a Fraction."""
    value = float(value)
    return int(value) if value.is_integer() else Fraction(value)


def exact_incircle(points, triangle, other):
    """Return the in-circle determinant in rational numbers; positive if `other` is inside."""
    rows = []
    ox, oy = map(exact, points[other])
    for i in triangle:
        x, y = map(exact, points[i])
        rows.append((x - ox, y - oy, (x - ox) ** 2 + (y - oy) ** 2))
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def exact_area(points, triangle):
    """Return twice the signed area of a triangle in rational numbers."""
    (ax, ay), (bx, by), (cx, cy) = (map(exact, points[i]) for i in triangle)
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def assert_delaunay(points, triangles, segments=()):
    """Check that triangles are counter-clockwise and circles across free edges are empty.

    `segments` are fixed edges: there the circles may contain the opposite node.
    """
    fixed = {frozenset(map(int, segment)) for segment in segments}
    corners = points[triangles]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubtful = ~(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0] > 1e-6)
    assert all(exact_area(points, triangle) > 0 for triangle in triangles[doubtful])
    across = neighbours(triangles)
    for t, k in np.argwhere(across >= 0):
        edge = frozenset(int(v) for v in np.delete(triangles[t], k))
        if edge not in fixed:
            other = set(map(int, triangles[across[t, k]])) - edge
            assert exact_incircle(points, triangles[t], other.pop()) <= 0


def area(points, triangles):
    return shapely.area(shapely.polygons((points - points[0])[triangles])).sum()


def rectangle_mesh(rng, width, height, count, step=1 / 256):
    """Return a Delaunay mesh of [0, width] x [0, height]; nodes are random multiples of `step`."""
    inner = rng.integers(0, [width / step + 1, height / step + 1], (count, 2)) * step
    corners = [(0, 0), (width, 0), (0, height), (width, height)]
    nodes = np.unique(np.vstack([inner, corners]), axis=0)
    return nodes, Delaunay(nodes).simplices.astype(np.int32)
