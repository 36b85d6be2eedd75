"""Stage 1: gray, stretch, fill, Sobel and resize, compared with OpenCV, numpy and brute force."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.distance import cdist

from geomesh.errors import BandError
from geomesh.features.filters import fill_invalid, resize, sobel_enhance
from geomesh.features.gray import Tone, fit_tone, gray_weights, stretch_to_uint8, to_gray
from geomesh.recipe import Recipe

# Invalid pixels may have any value, and must not cause a warning.
pytestmark = pytest.mark.filterwarnings("error")

SHAPE = (37, 53)
PAPER = Recipe.from_preset("paper")


def noise(bands: int, dtype: Any, top: float, seed: int = 0) -> np.ndarray:
    values = np.random.default_rng(seed).random((bands, *SHAPE)) * top
    return values.astype(dtype)


def all_valid(bands: np.ndarray) -> np.ndarray:
    return np.ones(bands.shape[1:], bool)


def gray_of(bands: np.ndarray, method: str = "auto", **options: Any) -> np.ndarray:
    return to_gray(bands, gray_weights(bands, method, **options))


def opencv_gray(red: np.ndarray, green: np.ndarray, blue: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(np.dstack([red, green, blue]), cv2.COLOR_RGB2GRAY)


# Gray


@pytest.mark.parametrize("method", ["luma", "auto"])
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)])
def test_8_bit_rgb_becomes_opencvs_gray_in_any_order(method: str, order: tuple) -> None:
    bands = noise(3, np.uint8, 256)
    red, green, blue = order
    expected = opencv_gray(bands[red], bands[green], bands[blue])
    found = gray_of(bands, method, rgb=order)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, expected)


def test_every_8_bit_colour_becomes_opencvs_gray() -> None:
    level = np.arange(0, 256, 5, dtype=np.uint8)
    bands = np.stack(np.meshgrid(level, level, level)).reshape(3, len(level), -1)
    np.testing.assert_array_equal(gray_of(bands, rgb=(0, 1, 2)), opencv_gray(*bands))


def test_luma_finds_its_bands_among_more() -> None:
    bands = noise(5, np.uint8, 256)
    found = gray_of(bands, "luma", rgb=(3, 1, 0))
    np.testing.assert_array_equal(found, opencv_gray(bands[3], bands[1], bands[0]))


def test_luma_of_16_bits_keeps_the_bands_units() -> None:
    bands = noise(3, np.uint16, 65_535)
    found = gray_of(bands, "luma", rgb=(2, 1, 0))
    expected = 0.299 * bands[2] + 0.587 * bands[1] + 0.114 * bands[0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_mean_is_the_mean() -> None:
    bands = noise(4, np.uint16, 65_535)
    np.testing.assert_allclose(gray_of(bands, "mean"), bands.mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize("method", ["auto", "mean", "band:1"])
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_one_band_is_its_own_gray(method: str, dtype: Any) -> None:
    bands = noise(1, dtype, 200)
    found = gray_of(bands, method)
    np.testing.assert_array_equal(found, bands[0])
    assert found.dtype == dtype


def correlated(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    common = rng.random(SHAPE) * 4000
    share = rng.uniform(-1, 1, count)[:, None, None]
    return share * common + rng.random((count, *SHAPE)) * 400 + 5000


@pytest.mark.parametrize("method", ["pca", "auto"])
@pytest.mark.parametrize("count", [2, 4, 7])
@pytest.mark.parametrize("seed", range(3))
def test_pca_is_the_first_singular_vector(method: str, count: int, seed: int) -> None:
    bands = correlated(count, seed)
    weights = gray_weights(bands, method)
    values = bands.reshape(count, -1)
    u, _, _ = np.linalg.svd(values - values.mean(axis=1, keepdims=True), full_matrices=False)
    np.testing.assert_allclose(np.abs(weights @ u[:, 0]), 1, rtol=1e-9)
    assert np.linalg.norm(weights) == pytest.approx(1)
    assert weights.sum() >= 0


def test_pca_looks_at_valid_pixels_only() -> None:
    bands = correlated(3)
    valid = np.random.default_rng(1).random(SHAPE) < 0.7
    spoiled = np.where(valid, bands, np.nan)
    weights = gray_weights(spoiled, "pca", valid=valid)
    np.testing.assert_allclose(weights, gray_weights(bands[:, valid][:, None], "pca"))


def test_pca_keeps_bright_bright() -> None:
    bands = np.stack([np.linspace(0, 1, 100).reshape(10, 10)] * 3)
    gray = gray_of(bands, "pca")
    assert np.corrcoef(gray.ravel(), bands[0].ravel())[0, 1] == pytest.approx(1)


@pytest.mark.parametrize(("number", "position"), [(4, 0), (3, 1), (2, 2)])
def test_a_band_goes_by_its_number_in_the_file(number: int, position: int) -> None:
    bands = noise(3, np.uint16, 65_535)
    found = gray_of(bands, f"band:{number}", numbers=(4, 3, 2))
    np.testing.assert_array_equal(found, bands[position])


def test_luma_without_colours_is_refused() -> None:
    with pytest.raises(BandError, match="luma needs red, green and blue among the 4 bands"):
        gray_weights(noise(4, np.uint8, 256), "luma")


@pytest.mark.parametrize(("method", "numbers"), [("band:4", None), ("band:1", (4, 3, 2))])
def test_a_band_that_was_not_chosen_is_refused(method: str, numbers: Any) -> None:
    with pytest.raises(BandError) as caught:
        gray_weights(noise(3, np.uint8, 256), method, numbers=numbers)
    assert method in str(caught.value)
    assert ", ".join(map(str, numbers or (1, 2, 3))) in str(caught.value)
    assert "\n" not in str(caught.value)


# Stretch


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e4))
def test_stretch_is_a_line_between_black_and_white(black: float, span: float) -> None:
    white = black + span
    values = np.linspace(black - span, white + span, 301)
    found = stretch_to_uint8(values, black, white).astype(float)
    exact = np.clip((values - black) / (white - black), 0, 1) * 255
    assert np.abs(found - exact).max() <= 0.5 + 1e-6
    assert stretch_to_uint8(np.array([black, white]), black, white).tolist() == [0, 255]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32, np.float64])
def test_stretch_does_not_wrap_around(dtype: Any) -> None:
    ends = [0, 255] if dtype == np.uint8 else [0, 30_000]
    assert stretch_to_uint8(np.array(ends, dtype), 10, 20).tolist() == [0, 255]


def test_stretch_of_what_is_no_number_is_quiet() -> None:
    values = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 5])
    assert stretch_to_uint8(values, 0, 10).tolist() == [0, 255, 0, 255, 0, 128]
    extreme = np.array([1.7e308, -1.7e308])
    assert stretch_to_uint8(extreme, -1, 1).tolist() == [255, 0]


@pytest.mark.parametrize("white", [3.0, 2.0, np.nan])
def test_stretch_without_a_range_is_black(white: float) -> None:
    assert not stretch_to_uint8(np.arange(6.0), 3.0, white).any()


def scene_with_nodata(dtype: Any, bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Values 1000..5000 with a corner of nodata: 65535, or NaN and infinities."""
    values = (noise(bands, np.float64, 4000, seed=3) + 1000).astype(dtype)
    valid = np.ones(SHAPE, bool)
    valid[:15, :20] = False
    values[:, ~valid] = 65_535
    if np.dtype(dtype).kind == "f":
        values[:, :5, :20], values[:, 5:9, :20], values[:, 9, :20] = np.nan, np.inf, -np.inf
    return values, valid


@pytest.mark.parametrize("stretch", [(2, 98), (0, 100), (10, 60.5)])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_the_gray_is_stretched_between_percentiles_of_the_valid(stretch: Any, dtype: Any) -> None:
    bands, valid = scene_with_nodata(dtype, 3)
    tone = fit_tone(bands, valid, Recipe(stretch=stretch), rgb=(0, 1, 2))
    gray = np.tensordot([0.299, 0.587, 0.114], bands[:, valid].astype(float), axes=1)
    black, white = np.percentile(gray, stretch)
    assert tone.gray_range == pytest.approx((black, white), rel=1e-12)
    assert tone.band_ranges is None
    found = tone.gray(bands, valid)
    assert found.dtype == np.uint8
    exact = np.clip((gray - black) / (white - black), 0, 1) * 255
    assert np.abs(found[valid] - exact).max() <= 0.5 + 1e-6


def test_each_band_is_stretched_before_the_gray_where_the_recipe_says_so() -> None:
    bands, valid = scene_with_nodata(np.uint16, 3)
    bands[1] //= 4
    tone = fit_tone(bands, valid, PAPER, rgb=(0, 1, 2))
    expected = [np.percentile(band[valid], (2, 98)) for band in bands]
    np.testing.assert_allclose(tone.band_ranges, expected)
    assert tone.gray_range is None
    levels = [stretch_to_uint8(b, *r) for b, r in zip(bands, expected, strict=True)]
    np.testing.assert_array_equal(tone.gray(bands, valid)[valid], opencv_gray(*levels)[valid])


@pytest.mark.parametrize("rgb", [(0, 1, 2), (2, 1, 0)])
def test_the_paper_leaves_8_bit_colours_alone(rgb: tuple[int, int, int]) -> None:
    bands = noise(3, np.uint8, 90) + np.uint8(40)
    tone = fit_tone(bands, all_valid(bands), PAPER, rgb=rgb)
    assert (tone.band_ranges, tone.gray_range, tone.display_ranges) == (None, None, None)
    expected = opencv_gray(*(bands[k] for k in rgb))
    np.testing.assert_array_equal(tone.gray(bands, all_valid(bands)), expected)


def test_the_paper_leaves_one_8_bit_band_alone() -> None:
    bands = noise(1, np.uint8, 90)
    tone = fit_tone(bands, all_valid(bands), PAPER)
    np.testing.assert_array_equal(tone.gray(bands, all_valid(bands)), bands[0])


def test_a_principal_component_of_8_bits_is_stretched_as_it_leaves_8_bits() -> None:
    bands = noise(4, np.uint8, 256)
    tone = fit_tone(bands, all_valid(bands), PAPER.with_values(gray="pca"))
    weighed = np.tensordot(tone.weights, bands.astype(float), axes=1)
    assert tone.gray_range == pytest.approx(tuple(np.percentile(weighed, (2, 98))))
    found = tone.gray(bands, all_valid(bands))
    assert found.min() == 0
    assert found.max() == 255


@pytest.mark.parametrize("recipe", [Recipe(), PAPER], ids=lambda r: r.preset)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_a_constant_image_is_one_gray(recipe: Recipe, dtype: Any, count: int) -> None:
    bands = np.full((count, *SHAPE), 77, dtype)
    rgb = (0, 1, 2) if count == 3 else None
    found = fit_tone(bands, all_valid(bands), recipe, rgb=rgb).gray(bands, all_valid(bands))
    assert found.dtype == np.uint8
    assert len(np.unique(found)) == 1


@pytest.mark.parametrize("recipe", [Recipe(), PAPER], ids=lambda r: r.preset)
def test_an_image_of_mostly_one_value_keeps_its_contrast(recipe: Recipe) -> None:
    bands = np.zeros((1, *SHAPE), np.uint16)
    bands[0, 5, 5] = 900
    found = fit_tone(bands, all_valid(bands), recipe).gray(bands, all_valid(bands))
    assert found[5, 5] == 255
    assert found.sum() == 255


@pytest.mark.parametrize("recipe", [Recipe(), PAPER], ids=lambda r: r.preset)
@pytest.mark.parametrize("gray", ["mean", "luma", "pca", "band:2"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_invalid_pixels_hold_does_not_matter(recipe: Recipe, gray: str, dtype: Any) -> None:
    recipe = recipe.with_values(gray=gray)
    bands, valid = scene_with_nodata(dtype, 3)
    clean = np.where(valid, bands, dtype(1234))
    tones = [fit_tone(values, valid, recipe, rgb=(0, 1, 2)) for values in (bands, clean)]
    assert tones[0] == tones[1]
    np.testing.assert_array_equal(tones[0].gray(bands, valid), tones[1].gray(clean, valid))


def test_the_tone_of_one_valid_pixel_is_harmless() -> None:
    bands, _ = scene_with_nodata(np.float32, 4)
    valid = np.zeros(SHAPE, bool)
    valid[30, 30] = True
    found = fit_tone(bands, valid, Recipe()).gray(bands, valid)
    assert len(np.unique(found)) == 1


def test_a_tone_gives_a_tile_what_it_gives_the_whole() -> None:
    bands, valid = scene_with_nodata(np.uint16, 4)
    tone = fit_tone(bands, valid, Recipe())
    whole = tone.gray(bands, valid)
    part = tone.gray(bands[:, 20:, 25:], valid[20:, 25:])
    np.testing.assert_array_equal(part, whole[20:, 25:])


def test_display_shows_8_bits_as_they_are_and_stretches_others() -> None:
    plain = Tone((1.0,), None, None, None)
    values = np.array([[0, 99.6, 300, -5, np.nan]])
    assert plain.display(values).tolist() == [[0, 100, 255, 0, 0]]
    stretched = Tone((1.0,), None, None, ((0, 510),))
    assert stretched.display(values).tolist() == [[0, 50, 150, 0, 0]]


# Nodata


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40), st.floats(0.002, 0.98))
def test_fill_takes_the_value_of_a_nearest_valid_pixel(
    seed: int, height: int, width: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (height, width), dtype=np.uint8)
    valid = rng.random((height, width)) < share
    valid.flat[rng.integers(valid.size)] = True
    before = image.copy()
    found = fill_invalid(image, valid)
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(found[valid], image[valid])
    places, holes = np.argwhere(valid), np.argwhere(~valid)
    distance = cdist(holes, places)
    # The chamfer distance is not exact. So the value may come from any valid pixel that is no
    # farther than 1.1 times the distance of the nearest one.
    near = distance <= 1.1 * distance.min(axis=1, keepdims=True)
    lent = found[~valid][:, None] == image[valid][None]
    assert (near & lent).any(axis=1).all()


def test_fill_crosses_a_wide_gap() -> None:
    image = np.full((5, 3000), 7, np.uint8)
    image[:, 0], image[:, -1] = 10, 200
    valid = np.zeros(image.shape, bool)
    valid[:, [0, -1]] = True
    found = fill_invalid(image, valid)
    assert (found[:, :1400] == 10).all()
    assert (found[:, 1600:] == 200).all()


@pytest.mark.parametrize("value", [True, False])
def test_fill_leaves_an_image_alone_where_all_or_nothing_is_valid(value: bool) -> None:
    image = noise(1, np.uint8, 256)[0]
    np.testing.assert_array_equal(fill_invalid(image, np.full(SHAPE, value)), image)


def test_fill_leaves_no_edge_at_the_border_of_nodata() -> None:
    image = np.full(SHAPE, 180, np.uint8)
    image[:10] = 0
    valid = image > 0
    assert not sobel_enhance(fill_invalid(image, valid)).any()


# Sobel and resize


@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 30))
def test_sobel_is_half_the_sum_of_saturated_gradients(seed: int, height: int, width: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    found = sobel_enhance(image)
    gx = cv2.convertScaleAbs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=3))
    gy = cv2.convertScaleAbs(cv2.Sobel(image, cv2.CV_16S, 0, 1, ksize=3))
    np.testing.assert_array_equal(found, cv2.addWeighted(gx, 0.5, gy, 0.5, 0))
    assert found.dtype == np.uint8
    if min(height, width) > 1:  # OpenCV mirrors at the middle of the outer pixels
        axes = [ndimage.sobel(image.astype(int), axis=k, mode="mirror") for k in (0, 1)]
        exact = sum(np.minimum(np.abs(g), 255) for g in axes) / 2
        assert np.abs(found - exact).max() <= 0.5


@pytest.mark.parametrize("size", [(256, 256), (20, 90), (53, 37), (1, 1)])
def test_resize_is_opencvs_by_area(size: tuple[int, int]) -> None:
    image = noise(1, np.uint8, 256)[0]
    found = resize(image, size)
    assert found.shape == size[::-1]
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def test_resize_by_a_whole_number_is_the_mean_of_blocks() -> None:
    image = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
    means = image.reshape(20, 3, 20, 4).mean(axis=(1, 3))
    assert np.abs(resize(image, (20, 20)) - means).max() <= 0.5 + 1e-6


def test_resize_to_the_same_size_changes_nothing() -> None:
    image = noise(1, np.uint8, 256)[0]
    np.testing.assert_array_equal(resize(image, (SHAPE[1], SHAPE[0])), image)
