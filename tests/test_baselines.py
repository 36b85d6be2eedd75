"""Baselines: the requested number of distinct nodes, on valid pixels, at the right places."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import LinearNDInterpolator

from geomesh.evaluate.baselines import (
    baselines,
    canny_pixels,
    greedy_insertion,
    random_pixels,
    regular_grid,
    shi_tomasi,
    yang_error_diffusion,
)
from geomesh.features.canny import automatic_thresholds
from geomesh.raster.open import open_scene
from support.samples import SAMPLES

NAMES = list(baselines())
ONES = np.ones((64, 64), np.bool_)


@pytest.fixture(
    scope="module", params=["olinda_landsat7_rgb_uint8", "parana_landsat8_rgb_uint16_nodata_edge"]
)
def image(request):
    """A gray image, complete or with much nodata, and its valid pixels."""
    scene = open_scene(SAMPLES / f"{request.param}.tif", bidx=[1])
    bands, valid = scene.read(scene.grid.extent)
    levels = bands[0] * (255 / np.percentile(bands[0], 99.5))
    return np.clip(levels, 0, 255).astype(np.uint8), valid


def pixels_of(points):
    return tuple(np.floor(points[:, ::-1]).astype(int).T)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [3, 50, 553, 4000])
def test_there_are_as_many_distinct_nodes_as_asked_for_all_on_valid_pixels(image, name, n):
    gray, valid = image
    points = baselines()[name](gray, valid, n)
    assert points.shape == (n, 2)
    assert points.dtype == np.float64
    assert len(np.unique(points, axis=0)) == n
    assert valid[pixels_of(points)].all()


@pytest.mark.parametrize("name", NAMES)
def test_nodes_are_the_same_every_time_and_the_image_stays_as_it_is(image, name):
    gray, valid = image
    before = gray.copy(), valid.copy()
    first, second = (baselines()[name](gray, valid, 200) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(gray, before[0])
    np.testing.assert_array_equal(valid, before[1])


shapes = st.tuples(st.integers(1, 20), st.integers(1, 20))


@pytest.mark.parametrize("name", NAMES)
@given(
    shapes.flatmap(lambda s: st.tuples(arrays(np.uint8, s), arrays(np.bool_, s))),
    st.integers(3, 60),
)
def test_on_any_small_image_nodes_are_distinct_valid_and_not_too_many(name, image, n):
    gray, valid = image
    points = baselines()[name](gray, valid, n)
    assert len(points) <= n
    assert len(np.unique(points, axis=0)) == len(points)
    assert valid[pixels_of(points)].all()
    if name == "random":
        assert len(points) == min(n, np.count_nonzero(valid))


@pytest.mark.parametrize("place", [canny_pixels, shi_tomasi, yang_error_diffusion])
def test_an_image_without_content_gives_no_nodes(place):
    assert len(place(np.full((64, 64), 7, np.uint8), ONES, 100)) == 0


def test_a_square_number_on_a_square_image_is_a_lattice():
    points = regular_grid(np.zeros((64, 64), np.uint8), ONES, 16)
    x, y = np.meshgrid(np.linspace(0.5, 63.5, 4), np.linspace(0.5, 63.5, 4))
    expected = np.column_stack([x.ravel(), y.ravel()])
    np.testing.assert_allclose(points, expected[np.lexsort(expected.T[::-1])])


def test_a_regular_grid_is_equally_spaced_in_both_directions_where_there_are_data():
    valid = np.zeros((120, 200), np.bool_)
    valid[20:100, 30:90] = valid[20:60, 120:190] = True
    points = regular_grid(np.zeros(valid.shape, np.uint8), valid, 400)
    rows = np.unique(points[:, 1])
    spacing = np.sqrt(valid.sum() / 400)
    np.testing.assert_allclose(np.diff(rows), spacing, rtol=0.1)
    for row in rows:
        steps = np.diff(np.sort(points[points[:, 1] == row, 0]))
        np.testing.assert_allclose(steps[steps < 20], spacing, rtol=0.15)


def test_random_nodes_are_spread_over_all_valid_pixels(image):
    _, valid = image
    points = random_pixels(np.zeros(valid.shape, np.uint8), valid, 4000)
    middle = valid.shape[0] // 2
    share = np.count_nonzero(points[:, 1] < middle) / 4000
    assert share == pytest.approx(valid[:middle].sum() / valid.sum(), abs=0.03)


def test_sampled_edges_are_those_of_opencv(image):
    gray, _ = image
    every = np.ones(gray.shape, np.bool_)
    found = automatic_thresholds([(gray, every)], True)
    edges = cv2.Canny(gray, found.low, found.high, L2gradient=True) > 0
    points = canny_pixels(gray, every, 300)
    assert edges[pixels_of(points)].all()
    assert len(canny_pixels(gray, every, gray.size)) == np.count_nonzero(edges)


def test_corners_are_the_corners_of_a_square():
    gray = np.zeros((64, 64), np.uint8)
    gray[20:40, 10:30] = 200
    points = shi_tomasi(gray, ONES, 4)
    expected = [(10, 20), (30, 20), (10, 40), (30, 40)]
    gaps = np.linalg.norm(points[:, None] - np.array(expected), axis=2)
    assert (gaps.min(axis=0) < 1.5).all()


def test_error_diffusion_is_as_dense_as_the_second_derivative_is_high():
    """For waves of equal height, the second derivative is proportional to the frequency squared."""
    x = np.arange(256) + 0.5
    slow, fast = (np.sin(2 * np.pi * x / length) for length in (64, 32))
    gray = np.rint(127 + 120 * np.concatenate([slow, fast]))[None].repeat(128, axis=0)
    gray = gray.astype(np.uint8)
    points = yang_error_diffusion(gray, np.ones(gray.shape, np.bool_), 2000)
    on_fast = np.count_nonzero(points[:, 0] > 256)
    assert on_fast / (2000 - on_fast) == pytest.approx(4, rel=0.1)
    assert np.count_nonzero(points[:, 1] > 64) == pytest.approx(1000, rel=0.1)


def test_error_diffusion_keeps_nodes_apart():
    """This is the purpose of error diffusion: random nodes would often be neighbours."""
    x, y = np.meshgrid(np.arange(64), np.arange(64))
    gray = (127 + 120 * np.sin(x / 3) * np.sin(y / 3)).astype(np.uint8)
    points, lots = (place(gray, ONES, 200) for place in (yang_error_diffusion, random_pixels))
    assert nearest(points).mean() > 1.25 * nearest(lots).mean()


def nearest(points):
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    return gaps.min(axis=1)


def test_greedy_insertion_puts_the_next_node_where_the_mesh_errs_most():
    """The image has no ties, so there is exactly one such place."""
    x, y = np.meshgrid(np.arange(40), np.arange(30))
    gray = np.zeros((30, 40), np.uint8)
    for col, row, height in ((7, 4, 250), (31, 22, 200), (22, 9, 140)):
        gray = np.maximum(gray, height * np.exp(-((x - col) ** 2 + (y - row) ** 2) / 4)).astype(
            np.uint8
        )
    points = greedy_insertion(gray, np.ones(gray.shape, np.bool_), 5)
    corners = points[:4]
    error = np.abs(gray - LinearNDInterpolator(corners, gray[pixels_of(corners)])(x + 0.5, y + 0.5))
    row, col = np.unravel_index(np.nanargmax(error), gray.shape)
    assert tuple(points[4]) == (col + 0.5, row + 0.5) == (7.5, 4.5)


def test_more_nodes_of_greedy_insertion_begin_with_the_same_ones(image):
    gray, valid = image
    few, more = (greedy_insertion(gray, valid, n) for n in (100, 300))
    np.testing.assert_array_equal(more[:100], few)
