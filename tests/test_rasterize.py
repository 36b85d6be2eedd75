"""Scan: the owner of each pixel, compared with exact arithmetic, with GDAL, and with itself.

Hypothesis tests have no deadline, because the first call of a kernel may compile it.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.features import rasterize
from scipy.spatial import Delaunay

from geomesh.mesh.topology import FILL
from geomesh.raster.grid import Window
from geomesh.zonal.owners import find_owners
from geomesh.zonal.rasterize import column_range, row_range, sort_corners
from support.geometry import rectangle_mesh

ONE = np.array([[0, 1, 2]], np.int32)


def owned_exactly(corners, window: Window) -> np.ndarray:
    """Return the pixels of one triangle by the half-open rule, in rational arithmetic."""
    points = [(Fraction(x), Fraction(y)) for x, y in corners]
    owned = np.zeros(window.shape, bool)
    for r in range(window.height):
        y = window.row + r + Fraction(1, 2)
        crossings = []
        for k in range(3):
            (xa, ya), (xb, yb) = sorted((points[k], points[(k + 1) % 3]), key=lambda p: p[1])
            if ya <= y < yb:
                crossings.append(xa + (y - ya) * (xb - xa) / (yb - ya))
        if crossings:
            for c in range(window.width):
                x = window.col + c + Fraction(1, 2)
                owned[r, c] = min(crossings) <= x < max(crossings)
    return owned


# With steps of 1/2 pixel, most corners and many sides are on pixel centres.
on_grid = st.sampled_from([1 / 256, 1 / 2, 1 / 4, 1]).flatmap(
    lambda step: st.lists(
        st.tuples(
            st.integers(round(-3 / step), round(12 / step)).map(lambda k: k * step),
            st.integers(round(-3 / step), round(12 / step)).map(lambda k: k * step),
        ),
        min_size=3,
        max_size=3,
    )
)


@settings(deadline=None)
@given(on_grid, st.permutations(range(3)))
def test_ownership_is_that_of_exact_arithmetic(corners, order):
    window = Window(-2, -1, 12, 11)
    nodes = np.array(corners, float)[list(order)]
    found = find_owners(nodes, ONE, window) == 0
    np.testing.assert_array_equal(found, owned_exactly(corners, window))


@settings(deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 2**24)] * 2), min_size=3, max_size=3), st.data())
def test_ownership_is_exact_in_triangles_of_65536_pixels(corners, data):
    nodes = np.array(corners) / 256
    low, high = np.sort(nodes[:, 1])[[0, 2]]
    row = data.draw(st.integers(int(low), max(int(high), int(low))))
    # Check where the sides cross the row, because rounding could matter there.
    for k in range(3):
        (xa, ya), (xb, yb) = nodes[k], nodes[(k + 1) % 3]
        near = xa + (row + 0.5 - ya) * (xb - xa) / (yb - ya) if ya != yb else xa
        window = Window(int(np.clip(near, 0, 65536)) - 3, row, 6, 1)
        found = find_owners(nodes, ONE, window) == 0
        np.testing.assert_array_equal(found, owned_exactly(nodes, window))


@pytest.mark.parametrize("along", [-2, 0.5, 2])
def test_a_side_meets_a_pixel_centre_exactly_wherever_it_runs(along):
    # Near x = 0, the rounding error of the difference of two large numbers is visible.
    # `along` puts the third corner below, between or above the side's ends.
    rng = np.random.default_rng(17)
    for _ in range(2000):
        step = rng.integers(1, 1500, 2) * rng.choice([-1, 1], 2) / 256
        before, after = rng.integers(1, 100, 2)
        first, last = 0.5 - before * step, 0.5 + after * step
        hand = rng.choice([-1, 1])
        apex = first + along * (last - first) + np.array([hand * 600, 0])
        found = find_owners(np.array([first, last, apex]), ONE, Window(0, 0, 1, 1))
        assert (found[0, 0] == 0) == (hand > 0)


def test_a_side_through_pixel_centres_gives_them_to_the_right_hand_triangle():
    # The diagonal of a square passes through the centres of the pixels (k, k).
    nodes = np.array([(0, 0), (3, 0), (3, 3), (0, 3)], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    found = find_owners(nodes, triangles, Window(0, 0, 3, 3))
    assert found.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def test_a_corner_on_a_pixel_centre_belongs_to_the_triangle_right_of_it():
    to_the_right = np.array([(1.5, 1.5), (3.5, 1.0), (3.5, 2.0)])
    to_the_left = np.array([(1.5, 1.5), (0.0, 1.0), (0.0, 2.0)])
    below = np.array([(1.5, 1.5), (2.5, 3.5), (1.5, 3.5)])
    owners = [
        find_owners(nodes, ONE, Window(1, 1, 1, 1))[0, 0]
        for nodes in (to_the_right, to_the_left, below)
    ]
    assert owners == [0, FILL, FILL]


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1 / 256, 1 / 2, 1]), st.integers(0, 60))
def test_every_pixel_of_a_triangulated_rectangle_has_exactly_one_owner(seed, step, count):
    rng = np.random.default_rng(seed)
    width, height = 17, 13
    nodes, triangles = rectangle_mesh(rng, width, height, count, step)
    window = Window(-2, -2, width + 4, height + 4)
    times = np.zeros(window.shape, int)
    for triangle in triangles:
        times += find_owners(nodes, triangle[None], window) == 0
    expected = np.pad(np.ones((height, width), int), 2)
    np.testing.assert_array_equal(times, expected)


def test_pixels_have_one_owner_off_the_grid_too():
    rng = np.random.default_rng(3)
    nodes, _ = rectangle_mesh(rng, 60, 50, 0)
    nodes = np.vstack([nodes, rng.random((800, 2)) * (60, 50)])
    triangles = Delaunay(nodes).simplices.astype(np.int32)
    times = np.zeros((50, 60), int)
    for triangle in triangles:
        times += find_owners(nodes, triangle[None], Window(0, 0, 60, 50)) == 0
    assert (times == 1).all()


@settings(deadline=None)
@given(st.integers(0, 40), st.integers(0, 40), st.integers(1, 30), st.integers(1, 30))
def test_a_window_sees_its_part_of_the_whole(col, row, width, height):
    nodes, triangles = rectangle_mesh(np.random.default_rng(5), 40, 40, 50)
    whole = find_owners(nodes, triangles, Window(0, 0, 80, 80))
    window = Window(col, row, width, height)
    np.testing.assert_array_equal(find_owners(nodes, triangles, window), whole[window.slices()])


def test_ranges_are_clipped_and_empty_outside():
    corners = sort_corners.py_func(0.0, 0.0, 10.0, 0.0, 0.0, 10.0)
    assert row_range.py_func(corners, -5, 50) == (0, 10)
    assert row_range.py_func(corners, 3, 7) == (3, 7)
    first, stop = row_range.py_func(corners, 20, 30)
    assert first >= stop
    assert column_range.py_func(corners, 4, -5, 50) == (0, 5)
    assert column_range.py_func(corners, 4, 1, 3) == (1, 3)
    first, stop = column_range.py_func(corners, 4, 6, 9)
    assert first >= stop


def test_triangles_without_area_own_nothing():
    flat = np.array([(0, 0), (4, 4), (8, 8), (0, 4), (9, 4)], float)
    triangles = np.array([[0, 1, 2], [3, 4, 1], [1, 1, 2], [2, 2, 2]], np.int32)
    assert (find_owners(flat, triangles, Window(0, 0, 10, 10)) == FILL).all()


def test_gdal_agrees_wherever_a_centre_is_clear_of_the_sides():
    rng = np.random.default_rng(11)
    width, height = 200, 150
    nodes, triangles = rectangle_mesh(rng, width, height, 1500)
    found = find_owners(nodes, triangles, Window(0, 0, width, height))
    shapes = [
        ({"type": "Polygon", "coordinates": [nodes[[*t, t[0]]].tolist()]}, k)
        for k, t in enumerate(triangles)
    ]
    theirs = rasterize(shapes, out_shape=(height, width), fill=FILL, dtype="int32")
    differing = np.argwhere(found != theirs)
    for row, col in differing:
        centre = np.array([col + 0.5, row + 0.5])
        corners = nodes[triangles[found[row, col]]]
        sides = np.roll(corners, -1, axis=0) - corners
        offset = centre - corners
        distances = np.abs(sides[:, 0] * offset[:, 1] - sides[:, 1] * offset[:, 0])
        distances /= np.hypot(sides[:, 0], sides[:, 1])
        assert distances.min() < 1e-6
    assert len(differing) < 100


@pytest.mark.parametrize("frozen", [False, True])
def test_read_only_arrays_are_accepted(frozen):
    nodes, triangles = rectangle_mesh(np.random.default_rng(0), 8, 8, 5)
    nodes.flags.writeable = triangles.flags.writeable = not frozen
    assert (find_owners(nodes, triangles, Window(0, 0, 8, 8)) != FILL).all()
