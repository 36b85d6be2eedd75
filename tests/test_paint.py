"""Pictures of meshes compared with matplotlib, and fits with numpy's lstsq, on arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.tri import LinearTriInterpolator, Triangulation
from scipy.spatial import Delaunay

from geomesh.mesh.topology import FILL
from geomesh.raster.grid import Window
from geomesh.surface.fidelity import psnr, sum_errors
from geomesh.surface.least_squares import RIDGE, complete, normal_equations, solve
from geomesh.surface.paint import reconstruct, to_pixels
from geomesh.zonal.owners import find_owners


def random_mesh(rng, width, height, count, *, corners=True):
    """Return a Delaunay mesh of random lattice nodes, in the whole image or a part of it."""
    nodes = rng.integers(0, [width * 256 + 1, height * 256 + 1], (count, 2)) / 256
    if corners:
        nodes = np.vstack([nodes, [(0, 0), (width, 0), (0, height), (width, height)]])
    nodes = np.unique(nodes, axis=0)
    return nodes, Delaunay(nodes).simplices.astype(np.int32)


def centres(window):
    rows, cols = np.mgrid[window.row : window.stop_row, window.col : window.stop_col]
    return cols + 0.5, rows + 0.5


def design(nodes, triangles, window):
    """Return the barycentric coordinates (pixels x nodes), and which pixels have an owner."""
    owners = find_owners(nodes, triangles, window).ravel()
    x, y = (values.ravel() for values in centres(window))
    matrix = np.zeros((len(owners), len(nodes)))
    for pixel in np.flatnonzero(owners != FILL):
        corners = triangles[owners[pixel]]
        system = np.vstack([nodes[corners].T, np.ones(3)])
        matrix[pixel, corners] = np.linalg.solve(system, [x[pixel], y[pixel], 1])
    return matrix, owners != FILL


def fitted(nodes, triangles, start, bands, valid, window):
    equations = normal_equations(nodes, triangles, start, bands, valid, window)
    return start + solve(triangles, equations)


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("corners", [True, False])
def test_linear_pictures_are_those_of_matplotlib(corners):
    rng = np.random.default_rng(3)
    nodes, triangles = random_mesh(rng, 60, 45, 80, corners=corners)
    values = rng.normal(1000, 300, (len(nodes), 2))
    window = Window(0, 0, 60, 45)
    image = reconstruct(nodes, triangles, values, window, "linear")
    owned = find_owners(nodes, triangles, window) != FILL
    assert (np.isnan(image) == ~owned).all()
    assert owned.all() == corners
    for band in range(2):
        plane = LinearTriInterpolator(Triangulation(*nodes.T, triangles), values[:, band])
        expected = plane(*centres(window))
        both = owned & ~np.ma.getmaskarray(expected)
        assert both.sum() > 0.99 * owned.sum()
        np.testing.assert_allclose(image[band][both], expected.data[both], rtol=1e-9)


def test_constant_pictures_have_the_value_of_the_owner():
    rng = np.random.default_rng(4)
    nodes, triangles = random_mesh(rng, 60, 45, 80, corners=False)
    values = rng.normal(size=(len(triangles), 3))
    window = Window(0, 0, 60, 45)
    owners = find_owners(nodes, triangles, window)
    expected = np.where(owners == FILL, np.nan, values.T[:, owners])
    image = reconstruct(nodes, triangles, values, window, "constant")
    np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("model", ["linear", "constant"])
@given(st.integers(0, 40), st.integers(0, 30), st.integers(1, 20), st.integers(1, 20))
def test_windows_are_parts_of_the_whole_picture_to_the_bit(model, col, row, width, height):
    rng = np.random.default_rng(5)
    nodes, triangles = random_mesh(rng, 60, 50, 70)
    values = rng.normal(size=(len(nodes if model == "linear" else triangles), 1))
    whole, part = Window(0, 0, 60, 50), Window(col, row, width, height)
    image = reconstruct(nodes, triangles, values, whole, model)
    window = reconstruct(nodes, triangles, values, part, model)
    assert window.tobytes() == image[:, *part.slices()].tobytes()


def test_orientation_does_not_matter():
    rng = np.random.default_rng(6)
    nodes, triangles = random_mesh(rng, 30, 30, 40)
    values, window = rng.normal(size=(len(nodes), 1)), Window(0, 0, 30, 30)
    one = reconstruct(nodes, triangles, values, window, "linear")
    other = reconstruct(nodes, triangles[:, [0, 2, 1]], values, window, "linear")
    np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.parametrize(
    ("model", "shape", "told"),
    [
        ("linear", (4, 1), r"values \(4, 1\) of a linear model: expected \(3, bands\)"),
        ("constant", (3, 1), r"values \(3, 1\) of a constant model: expected \(1, bands\)"),
        ("linear", (3,), "expected"),
        ("cubic", (3, 1), "model is 'cubic': choose linear or constant"),
    ],
)
def test_values_that_fit_no_model_are_refused(model, shape, told):
    nodes, triangles = np.array([(0, 0), (2, 0), (0, 2.0)]), np.array([(0, 1, 2)], np.int32)
    with pytest.raises(ValueError, match=told):
        reconstruct(nodes, triangles, np.zeros(shape), Window(0, 0, 2, 2), model)


# ---------------------------------------------------------------- least squares


@pytest.mark.parametrize("count", [5, 30, 120])
def test_least_squares_are_those_of_numpy(count):
    """With 120 nodes on 24 x 18 pixels, many triangles own one pixel or none."""
    rng = np.random.default_rng(count)
    window = Window(3, 2, 24, 18)
    nodes, triangles = random_mesh(rng, 30, 22, count)
    bands = rng.integers(0, 255, (2, *window.shape)).astype(np.uint8)
    valid = rng.random(window.shape) > 0.2
    start = rng.normal(120, 40, (len(nodes), 2))
    matrix, owned = design(nodes, triangles, window)
    used = owned & valid.ravel()
    ridge = math.sqrt(RIDGE) * np.eye(len(nodes))
    found = fitted(nodes, triangles, start, bands, valid, window)
    for band in range(2):
        above = bands[band].ravel()[used] - matrix[used] @ start[:, band]
        system = np.vstack([matrix[used], ridge]), np.append(above, np.zeros(len(nodes)))
        expected = start[:, band] + np.linalg.lstsq(*system, rcond=None)[0]
        np.testing.assert_allclose(found[:, band], expected, rtol=1e-6)


def test_the_weight_of_the_first_values_costs_next_to_nothing():
    rng = np.random.default_rng(8)
    window = Window(0, 0, 40, 40)
    nodes, triangles = random_mesh(rng, 40, 40, 60)
    bands, valid = rng.integers(0, 255, (1, 40, 40)).astype(np.uint8), np.ones((40, 40), bool)
    found = fitted(nodes, triangles, np.full((len(nodes), 1), 128.0), bands, valid, window)
    matrix, _ = design(nodes, triangles, window)
    _, (least,), *_ = np.linalg.lstsq(matrix, bands.ravel().astype(float), rcond=None)
    image = reconstruct(nodes, triangles, found, window, "linear")
    assert least <= sum_errors(image, bands, valid).norm[0] ** 2 < least * 1.001


def test_equations_of_windows_add_up():
    rng = np.random.default_rng(9)
    nodes, triangles = random_mesh(rng, 40, 30, 50)
    bands, valid = rng.normal(size=(2, 30, 40)), rng.random((30, 40)) > 0.1
    start = rng.normal(size=(len(nodes), 2))
    whole = normal_equations(nodes, triangles, start, bands, valid, Window(0, 0, 40, 30))
    parts = [
        normal_equations(
            nodes, triangles, start, bands[:, *part.slices()], valid[part.slices()], part
        )
        for part in (Window(0, 0, 13, 30), Window(13, 0, 27, 11), Window(13, 11, 27, 19))
    ]
    np.testing.assert_allclose(sum(part.gram for part in parts), whole.gram, atol=1e-12)
    np.testing.assert_allclose(sum(part.moments for part in parts), whole.moments, atol=1e-12)


def test_nodes_without_a_pixel_keep_their_values_to_the_bit():
    rng = np.random.default_rng(10)
    nodes, triangles = random_mesh(rng, 20, 20, 150)
    valid = np.zeros((20, 20), bool)
    valid[:, :8] = True
    start = rng.normal(size=(len(nodes), 1))
    window = Window(0, 0, 20, 20)
    bands = rng.normal(size=(1, 20, 20))
    found = fitted(nodes, triangles, start, bands, valid, window)
    matrix, _ = design(nodes, triangles, window)
    touched = (matrix[valid.ravel()] != 0).any(axis=0)
    assert 20 < touched.sum() < len(nodes) - 20
    assert (found[~touched] == start[~touched]).all()
    assert (found[touched] != start[touched]).any()


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.floats(0, 1))
def test_least_squares_never_err_more_than_the_values_they_begin_with(seed, width, height, share):
    rng = np.random.default_rng(seed)
    window = Window(0, 0, width, height)
    nodes, triangles = random_mesh(rng, width, height, int(rng.integers(0, 30)))
    bands = rng.normal(0, 10.0 ** rng.integers(-3, 6), (1, height, width))
    valid = rng.random((height, width)) < share
    start = rng.normal(0, 100, (len(nodes), 1))
    errors = [
        sum_errors(reconstruct(nodes, triangles, values, window, "linear"), bands, valid)
        for values in (start, fitted(nodes, triangles, start, bands, valid, window))
    ]
    assert errors[1].pixels == valid.sum()
    assert errors[1].norm[0] <= errors[0].norm[0] * (1 + 1e-9)


def test_nothing_to_correct_is_not_corrected():
    rng = np.random.default_rng(11)
    nodes, triangles = random_mesh(rng, 20, 20, 30)
    start = np.full((len(nodes), 1), 0.1)
    bands, valid = np.full((1, 20, 20), 0.1), np.ones((20, 20), bool)
    found = fitted(nodes, triangles, start, bands, valid, Window(0, 0, 20, 20))
    assert (found == 0.1).all()


def test_a_plane_is_found_whatever_the_values_before():
    rng = np.random.default_rng(12)
    window = Window(0, 0, 50, 50)
    nodes, triangles = random_mesh(rng, 50, 50, 20)
    x, y = centres(window)
    bands = (1e4 + 3 * x - 2 * y)[None]
    valid = np.ones((50, 50), bool)
    found = fitted(nodes, triangles, np.full((len(nodes), 1), 1e4), bands, valid, window)
    image = reconstruct(nodes, triangles, found, window, "linear")
    # Only the weight of the start values, which are 150 off at the corners, causes an error.
    np.testing.assert_allclose(image, bands, atol=0.2)
    again = fitted(nodes, triangles, found, bands, valid, window)
    image = reconstruct(nodes, triangles, again, window, "linear")
    np.testing.assert_allclose(image, bands, atol=2e-3)


# ---------------------------------------------------------------- values where there are none


def test_nodes_in_nodata_get_the_mean_of_the_pixels_of_their_triangles():
    triangles = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 5, 6)], np.int32)
    values = np.array([[1.0], [2.0], [np.nan], [4.0], [np.nan], [np.nan], [6.0]])
    count, mean = np.array([3, 0, 1, 0]), np.array([[10.0], [np.nan], [50.0], [np.nan]])
    found = complete(values, triangles, count, mean)
    # Node 2 has three pixels of 10 and one of 50, node 4 has only the 50, node 5 has none.
    np.testing.assert_array_equal(found[:, 0], [1, 2, 20, 4, 50, np.nan, 6])
    assert np.isnan(values[2, 0])


# ---------------------------------------------------------------- errors, decibels, types


def test_errors_and_decibels_by_hand():
    bands = np.array([[[10, 20], [30, 40]]], np.uint8)
    image = np.array([[[13.0, 20], [26, np.nan]]])
    valid = np.array([[True, True], [True, True]])
    errors = sum_errors(image, bands, valid)
    assert (errors.pixels, errors.norm.tolist()) == (3, [5.0])
    assert (errors.low.tolist(), errors.high.tolist()) == ([10], [30])
    half = sum_errors(image, bands, np.array([[True, False], [True, False]]))
    both = half + sum_errors(image, bands, np.array([[False, True], [False, True]]))
    assert (both.pixels, both.norm, both.low, both.high) == (3, 5, 10, 30)
    # 10 log10(255^2 / (25 / 3)) = 48.1308 - 9.2082
    assert psnr(5 / math.sqrt(3), 255) == pytest.approx(38.9226, abs=1e-4)
    assert psnr([0, 1, 4], [0, 10, 0]).tolist() == [np.inf, 20, -np.inf]


@pytest.mark.parametrize("size", [1e-300, 1, 1e300])
def test_errors_of_any_size_are_told(size):
    bands, image = np.array([[[1.0, 2.0]]]) * size, np.array([[[4.0, 6.0]]]) * size
    errors = sum_errors(image, bands, np.ones((1, 2), bool))
    assert (errors + errors).norm[0] == pytest.approx(math.sqrt(50) * size, rel=1e-12)
    nodes = np.array([(0, 0), (2, 0), (0, 2), (2, 2.0)])
    triangles, window = np.array([(0, 1, 2), (1, 3, 2)], np.int32), Window(0, 0, 2, 1)
    found = fitted(nodes, triangles, np.zeros((4, 1)), bands, np.ones((1, 2), bool), window)
    np.testing.assert_allclose(
        reconstruct(nodes, triangles, found, window, "linear"), bands, rtol=0.05
    )


@pytest.mark.parametrize(
    ("dtype", "nodata", "values", "expected"),
    [
        ("uint8", None, [-3, 0.5, 1.5, 254.6, 300, np.nan], [0, 0, 2, 255, 255, 0]),
        ("uint8", 0, [-3, 0.4, 0.6, np.nan], [1, 1, 1, 0]),
        ("uint8", 255, [254.6, 300, np.nan], [254, 254, 255]),
        ("int16", -9999, [-9999.4, -40_000, np.nan], [-9998, -32_768, -9999]),
        ("int64", None, [1e19, -1e19], [2**63 - 1024, -(2**63)]),
        ("uint64", None, [1e20, -1.0], [2**64 - 2048, 0]),
        ("float32", None, [1e39, 0.1, np.nan], [np.finfo("f4").max, np.float32(0.1), 0]),
        # GDAL takes values within 4 rounding errors for nodata, too.
        ("float32", -9999, [-9999, np.nan], [-9999 * (1 - 4.1 * np.finfo("f4").eps), -9999]),
        ("float64", math.nan, [1.5, np.nan], [1.5, np.nan]),
    ],
)
def test_pixels_are_rounded_cut_off_and_kept_from_nodata(dtype, nodata, values, expected):
    pixels = to_pixels(np.array([[values]], float), np.dtype(dtype), nodata)
    assert pixels.dtype == dtype
    np.testing.assert_array_equal(pixels[0, 0], np.array(expected, dtype))
