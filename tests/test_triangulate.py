"""Stage 4, compared with scipy, shapely and exact arithmetic."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.mesh.topology import boundary_edges, build_edges
from support.geometry import area, as_sets, assert_delaunay


@pytest.mark.parametrize("count", [3, 10, 500, 5000])
def test_equals_scipy_on_random_points(count):
    points = np.random.default_rng(count).uniform(0, 1000, (count, 2))
    assert as_sets(delaunay(points).triangles) == as_sets(Delaunay(points).simplices)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_is_right_where_qhull_is_not(offset):
    """A rotated lattice far from the origin: rounding makes every square nearly cocircular."""
    y, x = np.mgrid[:60, :60].astype(float)
    points = np.column_stack([0.8 * x.ravel() - 0.6 * y.ravel(), 0.6 * x.ravel() + 0.8 * y.ravel()])
    points = points + offset
    triangles, used = delaunay(points)
    assert len(used) == 3600
    assert_delaunay(points, triangles)
    assert len(triangles) == 2 * 3600 - 2 - len(boundary_edges(triangles))
    hull = shapely.convex_hull(shapely.multipoints(points)).area
    assert np.abs(area(points, triangles) - hull) < 1e-6 * hull


@given(
    points=st.lists(
        st.tuples(st.integers(0, 8), st.integers(0, 8)), min_size=0, max_size=30, unique=True
    )
)
def test_cocircular_and_collinear_points(points):
    """Points of a small integer lattice: most circles contain several of them."""
    points = np.array(points, float).reshape(-1, 2)
    triangles, used = delaunay(points)
    hull = shapely.convex_hull(shapely.multipoints(points)).area if len(points) else 0
    if hull == 0:
        assert len(triangles) == len(used) == 0
        return
    assert len(used) == len(points)
    assert area(points, triangles) == pytest.approx(hull)
    assert_delaunay(points, triangles)


@given(seed=st.integers(0, 10**6), count=st.integers(3, 40), sides=st.integers(3, 12))
def test_constrained_triangulation_fills_the_outline(seed, count, sides):
    """A star-shaped outline with a hole, and random points in and around it."""
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.uniform(0, 2 * np.pi, sides))
    turn[:3] = 0.1, 2.2, 4.3
    turn = np.unique(turn.round(3))
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    outer = np.round(ring * rng.uniform(60, 100, (len(turn), 1)) * 256) / 256
    inner = np.round(ring * rng.uniform(4, 8, (len(turn), 1)) * 256) / 256
    domain = shapely.Polygon(outer, [inner])
    loose = np.round(rng.uniform(-100, 100, (count, 2)) * 256) / 256
    near = shapely.dwithin(domain.boundary, shapely.points(loose), 0.01)
    points = np.vstack([outer, inner, loose[~near]])
    first = np.arange(len(turn))
    loop = np.column_stack([first, np.roll(first, -1)])
    segments = np.vstack([loop, loop + len(turn)])
    if not domain.is_valid or len(np.unique(points, axis=0)) < len(points):
        return
    triangles, used = constrained_delaunay(points, segments)
    assert area(points, triangles) == pytest.approx(domain.area)
    edges = {frozenset(map(int, edge)) for edge in build_edges(triangles).nodes}
    fixed = {frozenset(map(int, segment)) for segment in segments}
    assert fixed <= edges
    assert {frozenset(map(int, edge)) for edge in boundary_edges(triangles)} == fixed
    within = shapely.intersects(domain, shapely.points(points))
    np.testing.assert_array_equal(used, np.flatnonzero(within))
    assert_delaunay(points, triangles, segments)


def test_nested_loops_and_islands_in_holes():
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    points = np.vstack([square * 40.0, square * 20.0, square * 8.0])
    one = np.array([(0, 1), (1, 2), (2, 3), (3, 0)])
    triangles, _ = constrained_delaunay(points, np.vstack([one, one + 4, one + 8]))
    assert area(points, triangles) == 80**2 - 40**2 + 16**2


def test_the_numbering_is_canonical():
    points = np.random.default_rng(3).uniform(0, 100, (200, 2))
    triangles, _ = delaunay(points)
    assert (triangles[:, 0] == triangles.min(axis=1)).all()
    np.testing.assert_array_equal(np.lexsort(triangles.T[::-1]), np.arange(len(triangles)))
