"""Stages 2 and 3: the tiles find the same features as the whole image."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree

from geomesh.features import detect as stage
from geomesh.features.canny import Thresholds, canny_edges, canny_thresholds, tile_edges, unite
from geomesh.features.filters import fill_invalid
from geomesh.features.gray_image import ArrayGray
from geomesh.features.sift import Keypoints, detect_sift, labels_around, spread_evenly, thin
from geomesh.parallel.tiles import plan_tiles
from geomesh.parallel.workers import open_workers
from geomesh.raster.grid import Window
from geomesh.recipe import Recipe
from support.samples import OLINDA, SAMPLES, mirrored


def detect(image, recipe):
    """Detect with two workers."""
    with open_workers(2) as workers:
        return stage.detect_keypoints(image, recipe, workers, lambda _fraction, _message: None)


@pytest.fixture(scope="module")
def large():
    """A real image of 2000 x 1500 pixels: two by two tiles."""
    bands = mirrored(OLINDA, 2000, 1500)
    gray = cv2.cvtColor(np.moveaxis(bands, 0, -1).copy(), cv2.COLOR_RGB2GRAY)
    return cv2.equalizeHist(gray)


def in_one_tile(monkeypatch, image, recipe):
    def one_tile(extent, **_):
        return plan_tiles(extent, core=max(extent.shape), halo=0)

    with monkeypatch.context() as patch:
        patch.setattr(stage, "plan_tiles", one_tile)
        return detect(image, recipe)


def test_tiled_nodes_are_those_of_the_whole_image(monkeypatch, large):
    image, recipe = ArrayGray.whole(large, np.ones(large.shape, bool)), Recipe()
    assert len(plan_tiles(image.extent)) == 4
    tiled = thin(detect(image, recipe).keypoints, stage.SEAM)
    whole = thin(in_one_tile(monkeypatch, image, recipe).keypoints, stage.SEAM)
    assert len(whole) > 20_000
    assert len(tiled) == len(whole)
    distance, index = cKDTree(whole.xy).query(tiled.xy)
    # A halo of 64 pixels is slightly too small for the largest blurs of octave 2.
    assert distance.max() < 0.01
    assert len(np.unique(index)) == len(whole)
    np.testing.assert_array_equal(whole.octave[index], tiled.octave)


def test_keypoints_lie_on_edges_of_the_whole_image(large):
    image, recipe = ArrayGray.whole(large, np.ones(large.shape, bool)), Recipe()
    found = detect(image, recipe)
    edges = cv2.Canny(
        cv2.Sobel(large, cv2.CV_16S, 1, 0, borderType=cv2.BORDER_REPLICATE),
        cv2.Sobel(large, cv2.CV_16S, 0, 1, borderType=cv2.BORDER_REPLICATE),
        found.thresholds.low,
        found.thresholds.high,
        L2gradient=True,
    )
    row, col = np.nonzero(edges)
    pixel = np.floor(found.keypoints.xy) + 0.5
    distance, _ = cKDTree(np.column_stack([col + 0.5, row + 0.5])).query(pixel)
    assert distance.max() <= recipe.edge_distance


def edges_by_tiles(gray, thresholds, core, halo):
    extent = Window(0, 0, gray.shape[1], gray.shape[0])
    tiles = plan_tiles(extent, core=core, halo=halo)
    found = [
        tile_edges(
            gray[tile.read.slices()],
            np.ones(tile.read.shape, bool),
            tile,
            thresholds,
            image_width=extent.width,
            seam=min(halo, 2),
        )
        for tile in tiles
    ]
    result = np.zeros(gray.shape, bool)
    flags = unite([partial for _, partial in found])
    for tile, (weak, _), is_edge in zip(tiles, found, flags, strict=True):
        result[tile.core.slices()] = is_edge[weak.labels][tile.core.slices(weak.window)]
    return result


@pytest.mark.parametrize("l2", [True, False])
@pytest.mark.parametrize(("low", "high"), [(20, 60), (100, 200), (300, 301), (0, 900)])
def test_hysteresis_is_exact_across_tiles(large, l2, low, high):
    gray = large[:500, :700]
    whole = cv2.Canny(gray, low, high, L2gradient=l2) > 0
    assert whole.any()
    np.testing.assert_array_equal(canny_edges(gray, Thresholds(low, high, l2)), whole)
    tiled = edges_by_tiles(gray, Thresholds(low, high, l2), core=128, halo=4)
    np.testing.assert_array_equal(tiled, whole)


@given(
    gray=arrays(np.uint8, st.tuples(st.integers(1, 40), st.integers(1, 40))),
    low=st.integers(1, 400),
    extra=st.integers(0, 800),
    core=st.integers(3, 20),
    l2=st.booleans(),
)
def test_hysteresis_is_exact_on_noise(gray, low, extra, core, l2):
    whole = cv2.Canny(gray, low, low + extra, L2gradient=l2) > 0
    tiled = edges_by_tiles(gray, Thresholds(low, low + extra, l2), core=core, halo=4)
    np.testing.assert_array_equal(tiled, whole)


def test_an_edge_that_winds_through_many_tiles_is_followed_to_its_end():
    """A faint spiral with one strong pixel at its inner end. One tile cannot decide alone."""
    turn = np.linspace(2, 9 * 2 * np.pi, 4000)
    path = np.column_stack([100 + 1.6 * turn * np.cos(turn), 100 + 1.6 * turn * np.sin(turn)])
    gray = np.zeros((200, 200), np.uint8)
    fading = np.linspace(110, 30, len(path)).astype(int)
    for start, stop, level in zip(path[:-1], path[1:], fading, strict=False):
        cv2.line(gray, start.astype(int).tolist(), stop.astype(int).tolist(), int(level), 4)
    whole = cv2.Canny(gray, 50, 400) > 0
    strong = cv2.Canny(gray, 400, 400) > 0
    assert whole.sum() > 4 * strong.sum() > 0
    np.testing.assert_array_equal(
        edges_by_tiles(gray, Thresholds(50, 400, False), core=16, halo=4), whole
    )


def test_sift_is_opencv_half_a_pixel_on_and_without_doubles(large):
    gray, recipe = large[:300, :300], Recipe(sift_max_octave=None)
    raw = cv2.SIFT_create(
        contrastThreshold=recipe.sift_contrast_threshold, enable_precise_upscale=True
    ).detect(gray, None)
    places = np.unique([k.pt for k in raw], axis=0)
    found = detect_sift(gray, recipe)
    assert len(places) < len(raw)
    order = np.lexsort((found.xy[:, 1], found.xy[:, 0]))
    np.testing.assert_allclose(found.xy[order] - 0.5, places, atol=1e-9)


def test_sift_places_a_blob_where_it_is():
    """The blob's centre is the corner of four pixels, so its pixel-edge coordinates are whole."""
    y, x = np.mgrid[:64, :64] + 0.5
    blob = (255 * np.exp(-((x - 30) ** 2 + (y - 34) ** 2) / 18)).astype(np.uint8)
    found = detect_sift(blob, Recipe())
    strongest = found.xy[found.response.argmax()]
    np.testing.assert_allclose(strongest, (30, 34), atol=0.05)


def test_octaves_above_the_cap_are_left_out(large):
    free = detect_sift(large[:512, :512], Recipe(sift_max_octave=None))
    capped = detect_sift(large[:512, :512], Recipe(sift_max_octave=1))
    assert set(free.octave) > {-1, 0, 1, 2}
    assert set(capped.octave) == {-1, 0, 1}


def test_no_keypoint_on_nodata_nor_caused_by_it(large):
    gray = large[:400, :400].copy()
    valid = np.ones(gray.shape, bool)
    y, x = np.mgrid[:400, :400]
    valid[(x - 200) ** 2 + (y - 200) ** 2 < 80**2] = False
    recipe = Recipe()
    full = detect(ArrayGray.whole(gray, np.ones_like(valid)), recipe).keypoints
    holed = detect(ArrayGray.whole(np.where(valid, gray, 0), valid), recipe).keypoints
    pixel = np.floor(holed.xy).astype(int)
    assert valid[pixel[:, 1], pixel[:, 0]].all()
    far = np.hypot(*(full.xy - 200).T) > 130
    distance, _ = cKDTree(holed.xy).query(full.xy[far])
    assert np.quantile(distance, 0.98) < 0.1


def median_gradient(gray):
    border = cv2.BORDER_REPLICATE
    dx = cv2.Sobel(gray, cv2.CV_64F, 1, 0, borderType=border)
    dy = cv2.Sobel(gray, cv2.CV_64F, 0, 1, borderType=border)
    magnitude = np.hypot(dx, dy)
    return np.median(magnitude[magnitude > 0])


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1025, 1025), (2048, 2048), (4096, 4096), (6000, 1500)])
def test_automatic_thresholds_of_a_large_image_are_about_those_of_all_its_pixels(shape):
    """This also holds for an image with repetitions, such as fields and mosaics."""
    gray = mirrored(SAMPLES / "iguacu_landsat8_rgb_uint16.tif", *shape[::-1])[0]
    gray = np.clip((gray - 6500) / 15, 0, 255).astype(np.uint8)
    found = canny_thresholds(ArrayGray.whole(gray, np.ones(shape, bool)), Recipe())
    assert found.low == pytest.approx(median_gradient(gray), rel=0.06)


def test_automatic_thresholds_are_the_median_gradient_and_twice_that(large):
    gray = large[:600, :600]
    median = median_gradient(gray)
    found = canny_thresholds(ArrayGray.whole(gray, np.ones(gray.shape, bool)), Recipe())
    assert (found.low, found.high) == pytest.approx((median, 2 * median))
    given_one = canny_thresholds(
        ArrayGray.whole(gray, np.ones(gray.shape, bool)), Recipe(canny_low=7.0)
    )
    assert (given_one.low, given_one.high) == pytest.approx((7, 2 * median))


def keypoints(xy, response):
    zeros = np.zeros(len(xy), np.float32)
    return Keypoints(
        np.asarray(xy, float), zeros, zeros, np.asarray(response, np.float32), zeros.astype(np.int8)
    )


@given(
    seed=st.integers(0, 10**6),
    count=st.integers(0, 200),
    spacing=st.floats(0.1, 30),
)
def test_thinning_keeps_the_strongest_and_the_distance(seed, count, spacing):
    rng = np.random.default_rng(seed)
    points = keypoints(rng.uniform(-50, 50, (count, 2)), rng.integers(0, 5, count))
    kept = thin(points, spacing)
    if count:
        assert kept.response[0] == points.response.max()
    if len(kept) > 1:
        assert cKDTree(kept.xy).query(kept.xy, k=2)[0][:, 1].min() >= spacing
    dropped = [i for i in range(count) if not (kept.xy == points.xy[i]).all(axis=1).any()]
    for i in dropped:
        near = np.hypot(*(kept.xy - points.xy[i]).T) < spacing
        assert kept.response[near].max() >= points.response[i]


@given(seed=st.integers(0, 10**6), count=st.integers(1, 200))
def test_the_choice_does_not_depend_on_the_order_of_keypoints(seed, count):
    rng = np.random.default_rng(seed)
    points = keypoints(rng.integers(0, 40, (count, 2)), rng.integers(0, 3, count))
    shuffled = points.take(rng.permutation(count))
    np.testing.assert_array_equal(thin(points, 3).xy, thin(shuffled, 3).xy)


def test_a_budget_is_spread_evenly_over_the_image():
    """Half of the keypoints, with all strong ones, are in one corner."""
    rng = np.random.default_rng(1)
    crowd, rest = rng.uniform(0, 100, (5000, 2)), rng.uniform(0, 1000, (5000, 2))
    points = keypoints(np.vstack([crowd, rest]), np.r_[np.full(5000, 9), np.ones(5000)])
    ranked = thin(points, 0)
    chosen = ranked.xy[spread_evenly(ranked, 1000, 1e6)[:1000]]
    cells, _ = np.histogramdd(chosen, bins=5, range=[(0, 1000)] * 2)
    assert cells.min() > 25
    assert cells.max() < 60
    by_response_alone, _ = np.histogramdd(ranked.xy[:1000], bins=5, range=[(0, 1000)] * 2)
    assert by_response_alone.min() == 0


@given(seed=st.integers(0, 10**6), distance=st.sampled_from([0.0, 1.0, 1.5, 2.0, 3.7]))
def test_labels_around_a_point_are_those_within_the_distance(seed, distance):
    rng = np.random.default_rng(seed)
    labels = np.where(rng.random((12, 15)) < 0.2, rng.integers(1, 9, (12, 15)), 0).astype(np.int32)
    window = Window(100, 50, 15, 12)
    points = rng.uniform((100, 50), (115, 62), (20, 2))
    found = labels_around(points, labels, window, distance)
    row, col = np.nonzero(labels)
    for point, row_found in zip(points, found, strict=True):
        centre = np.floor(point) + 0.5
        near = np.hypot(col + 100.5 - centre[0], row + 50.5 - centre[1]) <= distance
        assert set(row_found[row_found > 0]) == set(labels[row[near], col[near]])


def test_nodata_that_fills_a_tile_changes_nothing_elsewhere(monkeypatch):
    """Columns 900 to 2200 are nodata, so the middle tile has no data."""
    bands = mirrored(SAMPLES / "iguacu_landsat8_rgb_uint16.tif", 3300, 600)
    gray = cv2.normalize(bands[0], None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    valid = np.ones(gray.shape, bool)
    valid[:, 900:2200] = False
    recipe = Recipe()

    class Scene:
        """A gray image that is filled window by window, as in a scene."""

        extent = Window(0, 0, 3300, 600)

        def read(self, window):
            block = window.slices()
            return fill_invalid(gray[block], valid[block]), valid[block]

        def excerpt(self, _window):
            return self

    tiled = thin(detect(Scene(), recipe).keypoints, stage.SEAM)
    whole = thin(in_one_tile(monkeypatch, Scene(), recipe).keypoints, stage.SEAM)
    assert cKDTree(whole.xy).query(tiled.xy)[0].max() < 0.01
    # Extrema on the axes of the mirrored image are ties, and rounding decides them.
    distance, _ = cKDTree(tiled.xy).query(whole.xy)
    lost = whole.xy[distance > 0.01]
    assert len(lost) <= 2
    on_axis = np.abs((lost - 512.5 + 256) % 512 - 256).min(axis=1) < 0.01
    assert on_axis.all()


def test_thresholds_are_found_where_data_are_sparse(large):
    """A small patch of data between the sampled blocks."""
    gray, valid = np.zeros((3000, 3000), np.uint8), np.zeros((3000, 3000), bool)
    gray[:110, :110], valid[:110, :110] = large[:110, :110], True
    found = canny_thresholds(ArrayGray.whole(gray, valid), Recipe())
    cropped = canny_thresholds(ArrayGray.whole(gray[:110, :110], valid[:110, :110]), Recipe())
    assert found.high == pytest.approx(cropped.high, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("distance", [1.5, 20])
def test_little_is_remembered_of_the_edges_around_keypoints(large, distance):
    """Only edges that other tiles can change are kept, not all around each keypoint."""
    image, recipe = (
        ArrayGray.whole(large, np.ones(large.shape, bool)),
        Recipe(edge_distance=distance),
    )
    tile = plan_tiles(image.extent)[0]
    part = stage._DetectFeatures(recipe, canny_thresholds(image, recipe))((image, tile))
    assert len(part.keypoints) > 5000
    assert len(part.open_label) < 0.1 * len(part.keypoints)


@pytest.mark.parametrize(
    "values", [{"sift_max_octave": 3}, {"sift_sigma": 3.0}, {"sift_source": "edges"}]
)
def test_recipes_that_look_far_take_the_image_as_one_tile(values):
    assert Recipe().is_local
    assert not Recipe(**values).is_local
