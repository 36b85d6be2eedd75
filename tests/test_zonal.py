"""Zonal: statistics compared with GDAL, numpy and exactextract, and tile by tile."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
import rasterio
from affine import Affine
from exactextract import exact_extract
from geopandas import GeoDataFrame
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.features import rasterize
from scipy.ndimage import map_coordinates
from shapely import Polygon, polygons

from geomesh.mesh.colors import format_colors
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.bands import Band
from geomesh.raster.grid import Window
from geomesh.zonal.columns import node_columns, triangle_columns
from geomesh.zonal.owners import find_owners
from geomesh.zonal.statistics import merge
from geomesh.zonal.tile_statistics import measure_tile
from support.geometry import rectangle_mesh

DTYPES = ["uint8", "int16", "uint16", "int64", "uint64", "float32", "float64", ">u2", "float16"]


def statistics(nodes, triangles, bands, valid=None, *, core=1024, halo=1):
    """Compute statistics over the tiles of the image."""
    height, width = bands.shape[1:]
    valid = np.ones((height, width), bool) if valid is None else valid
    partials = []
    for tile in plan_tiles(Window(0, 0, width, height), core=core, halo=halo):
        part = tile.read.slices()
        partials.append(
            measure_tile(nodes, triangles, bands[:, *part], valid[part], tile.read, tile.core)
        )
    return merge(partials, len(triangles), len(nodes), len(bands))


def by_labels(owners, values, valid, count):
    """Return (mean, std, min, max) of `values` for each label, computed with pandas."""
    groups = pd.Series(values[valid].astype(float)).groupby(owners[valid])
    frame = groups.agg(["mean", lambda v: v.std(ddof=0), "min", "max"])
    return frame.reindex(range(count)).to_numpy().T


@pytest.fixture
def scene():
    """A mesh over 90 x 70 pixels with three bands; a third of the pixels is invalid."""
    rng = np.random.default_rng(7)
    nodes, triangles = rectangle_mesh(rng, 90, 70, 150)
    bands = rng.integers(0, 10_000, (3, 70, 90)).astype(np.uint16)
    return nodes, triangles, bands, rng.random((70, 90)) > 1 / 3


def test_statistics_agree_with_gdal_and_bincount(scene):
    nodes, triangles, bands, valid = scene
    # The nodes are moved away from pixel centres, so GDAL's rule gives the same pixels.
    nodes = np.where((nodes > 0) & (nodes < (90, 70)), nodes + 2**-10, nodes)
    rings = polygons(nodes[triangles[:, [0, 1, 2, 0]]])
    labels = rasterize(zip(rings, range(len(rings)), strict=True), out_shape=(70, 90), fill=-1)
    np.testing.assert_array_equal(labels, find_owners(nodes, triangles, Window(0, 0, 90, 70)))
    found = statistics(nodes, triangles, bands, valid)
    expected_count = np.bincount(labels[valid], minlength=len(triangles))
    np.testing.assert_array_equal(found.count, expected_count)
    np.testing.assert_array_equal(found.pixels, np.bincount(labels.ravel(), minlength=len(rings)))
    some = expected_count > 0
    for band in range(3):
        sums = np.bincount(labels[valid], bands[band][valid], minlength=len(triangles))
        np.testing.assert_allclose(found.mean[band, some], sums[some] / expected_count[some])
        _, std, low, high = by_labels(labels, bands[band], valid, len(triangles))
        np.testing.assert_allclose(found.std[band, some], std[some], rtol=1e-12, atol=1e-9)
        np.testing.assert_array_equal(found.min[band, some], low[some])
        np.testing.assert_array_equal(found.max[band, some], high[some])


def test_statistics_agree_with_exactextract_where_no_pixel_is_cut(tmp_path):
    # Blocks of 4 x 4 pixels, each divided into two triangles along its diagonal. exactextract
    # gets the pixels of each triangle as a polygon along pixel borders, with a staircase for the
    # diagonal. So it never counts a part of a pixel.
    rng = np.random.default_rng(1)
    side, block = 24, 4
    bands = (1000 + rng.normal(0, 30, (1, side, side))).astype(np.float64)
    path = tmp_path / "band.tif"
    profile = {"driver": "GTiff", "width": side, "height": side, "count": 1, "dtype": "float64"}
    transform = Affine(1, 0, 0, 0, -1, side)
    with rasterio.open(path, "w", transform=transform, crs="EPSG:32631", **profile) as file:
        file.write(bands)
    nodes, triangles, shapes = [], [], []
    for x in range(0, side, block):
        for y in range(0, side, block):
            first = len(nodes)
            nodes += [(x, y), (x + block, y), (x + block, y + block), (x, y + block)]
            triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
            # Down, then right: the pixels on the diagonal belong to the triangle right of it.
            stairs = [(x + k // 2, y + (k + 1) // 2) for k in range(2 * block + 1)]
            shapes.append([*stairs, (x + block, y)])
            shapes.append([*stairs[1:-1], (x, y + block)])
    rings = [[(x, side - y) for x, y in shape] for shape in shapes]
    frame = GeoDataFrame(geometry=[Polygon(ring) for ring in rings], crs="EPSG:32631")
    expected = exact_extract(
        str(path), frame, ["count", "mean", "stdev", "min", "max"], output="pandas"
    )
    found = statistics(np.array(nodes, float), np.array(triangles, np.int32), bands, core=7)
    np.testing.assert_array_equal(found.count, expected["count"])
    np.testing.assert_allclose(found.mean[0], expected["mean"], rtol=1e-12)
    np.testing.assert_allclose(found.std[0], expected["stdev"], rtol=1e-12)
    np.testing.assert_allclose(found.min[0], expected["min"], rtol=1e-12)
    np.testing.assert_allclose(found.max[0], expected["max"], rtol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.integers(4, 40))
def test_counts_add_up_to_valid_pixels(seed, share, core):
    rng = np.random.default_rng(seed)
    nodes, triangles = rectangle_mesh(rng, 31, 23, 40, step=1 / 2)
    valid = rng.random((23, 31)) < share
    found = statistics(nodes, triangles, np.zeros((1, 23, 31), np.uint8), valid, core=core)
    assert found.count.sum() == valid.sum()
    assert found.pixels.sum() == valid.size


@pytest.mark.parametrize("core", [1, 7, 64])
def test_tiles_do_not_change_the_statistics(scene, core):
    nodes, triangles, bands, valid = scene
    whole = statistics(nodes, triangles, bands, valid)
    tiled = statistics(nodes, triangles, bands, valid, core=core)
    for name in ("pixels", "count", "min", "max", "node_values"):
        np.testing.assert_array_equal(getattr(tiled, name), getattr(whole, name), name)
    np.testing.assert_allclose(tiled.mean, whole.mean, rtol=1e-12)
    np.testing.assert_allclose(tiled.std, whole.std, rtol=1e-12, atol=1e-9)


def test_the_halo_does_not_change_a_bit(scene):
    one, wide = (statistics(*scene, core=16, halo=halo) for halo in (1, 9))
    for name in ("count", "mean", "std", "min", "max", "node_values"):
        assert getattr(one, name).tobytes() == getattr(wide, name).tobytes()


def test_partials_from_threads_and_pickles_merge_to_the_same_bits(scene):
    nodes, triangles, bands, valid = scene

    def measure(tile):
        part = tile.read.slices()
        partial = measure_tile(nodes, triangles, bands[:, *part], valid[part], tile.read, tile.core)
        return pickle.loads(pickle.dumps(partial))

    tiles = plan_tiles(Window(0, 0, 90, 70), core=16, halo=1)
    with ThreadPoolExecutor(4) as threads:
        threaded = merge(threads.map(measure, tiles), len(triangles), len(nodes), 3)
    plain = statistics(nodes, triangles, bands, valid, core=16)
    for name in ("mean", "std", "min", "max", "node_values"):
        assert getattr(threaded, name).tobytes() == getattr(plain, name).tobytes()


@pytest.mark.parametrize(("core", "rtol"), [(64, 1e-12), (5, 1e-6)])
@pytest.mark.parametrize("outlier", [False, True])
def test_small_noise_on_large_values_keeps_its_digits(core, rtol, outlier):
    rng = np.random.default_rng(2)
    nodes, triangles = rectangle_mesh(rng, 40, 40, 10)
    noise = np.round(rng.normal(0, 0.01, (1, 40, 40)) * 2**20) / 2**20
    if outlier:
        noise[0, 0, 0] = 2.0**10
    owners = find_owners(nodes, triangles, Window(0, 0, 40, 40))
    found = statistics(nodes, triangles, noise + 1e9, core=core)
    # 1e9 + noise is exact in steps of 2^-20, so the expected values use only the noise.
    mean, std, *_ = by_labels(owners, noise[0], np.ones((40, 40), bool), len(triangles))
    some = found.count > 1
    np.testing.assert_allclose(found.mean[0, some] - 1e9, mean[some], atol=5e-7)
    np.testing.assert_allclose(found.std[0, some], std[some], rtol=rtol)


def test_equal_values_have_no_deviation():
    nodes, triangles = rectangle_mesh(np.random.default_rng(4), 50, 50, 40)
    found = statistics(nodes, triangles, np.full((1, 50, 50), 0.1), core=16)
    assert set(found.mean[0]) == {0.1}
    assert set(found.std[0]) == {0.0}


@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_of_band_gives_float64_statistics(dtype):
    top = 2**63 if dtype == "uint64" else 200
    band = np.array([[[top, 1], [2, 3]]]).astype(dtype)
    nodes = np.array([(0, 0), (2, 0), (2, 2), (0, 2)], float)
    # Triangle 0 has the diagonal and the pixel above it, triangle 1 has the pixel below it.
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    found = statistics(nodes, triangles, band)
    values = np.array([top, 1, 3], float)
    assert found.mean.dtype == np.float64
    np.testing.assert_allclose(found.mean[0], [values.mean(), 2])
    np.testing.assert_allclose(found.std[0], [values.std(), 0])
    assert found.min[0].tolist() == [1, 2]
    assert found.max[0].tolist() == [top, 2]
    assert found.count.tolist() == [3, 1]


@pytest.mark.parametrize("core", [1, 2, 8])
def test_triangles_without_a_valid_pixel_take_the_value_at_their_centroid(core):
    in_valid_pixel = [(2.1, 1.1), (2.4, 1.1), (2.1, 1.4)]
    in_invalid_pixel = [(3.1, 3.1), (3.4, 3.1), (3.1, 3.4)]
    # It owns only pixel (5, 4), which is not valid. Its centroid is in pixel (5, 5).
    owner_of_invalid = [(4.2, 5.3), (7.0, 6.2), (4.2, 5.7)]
    nodes = np.array([*in_valid_pixel, *in_invalid_pixel, *owner_of_invalid])
    triangles = np.arange(9, dtype=np.int32).reshape(3, 3)
    bands = np.arange(64, dtype=np.int32).reshape(1, 8, 8)
    valid = np.ones((8, 8), bool)
    valid[3, 3] = valid[5, 4] = False
    found = statistics(nodes, triangles, bands, valid, core=core)
    assert found.pixels.tolist() == [0, 0, 1]
    assert found.count.tolist() == [0, 0, 0]
    for name in ("mean", "min", "max"):
        np.testing.assert_array_equal(getattr(found, name)[0], [10, np.nan, 45])
    np.testing.assert_array_equal(found.std[0], [0, np.nan, 0])


def test_owned_pixels_that_are_not_valid_are_told_from_counted_ones():
    nodes = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    valid = np.ones((4, 4), bool)
    valid[:, 2:] = False
    valid[3, 0] = False
    found = statistics(nodes, triangles, np.ones((1, 4, 4), np.uint8), valid, core=3)
    assert found.pixels.tolist() == [10, 6]
    assert found.count.tolist() == [3, 4]


@pytest.mark.parametrize("core", [1, 7, 64])
def test_node_values_are_bilinear_between_pixel_centres(core):
    rng = np.random.default_rng(9)
    nodes, triangles = rectangle_mesh(rng, 40, 30, 200)
    bands = rng.normal(0, 100, (2, 30, 40))
    found = statistics(nodes, triangles, bands, core=core)
    for band in range(2):
        # Outside of the outer pixel centres, the value is that of the border.
        expected = map_coordinates(bands[band], nodes.T[::-1] - 0.5, order=1, mode="nearest")
        np.testing.assert_allclose(found.node_values[band], expected, rtol=1e-10, atol=1e-10)


def test_node_values_leave_invalid_pixels_out():
    nodes = np.array([(1.0, 1.0), (1.25, 0.5), (1.5, 1.5), (0.0, 2.0)])
    bands = np.array([[[10.0, 20.0], [30.0, 40.0]]])
    valid = np.array([[True, True], [False, False]])
    found = statistics(nodes, np.zeros((0, 3), np.int32), bands, valid)
    # Two of four pixels; between two centres; on an invalid pixel; at the outer corner.
    np.testing.assert_array_equal(found.node_values[0], [15.0, 17.5, np.nan, np.nan])


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(1, 13))
def test_every_node_of_the_image_has_one_tile(width, height, core):
    x, y = np.meshgrid(np.arange(0, width + 0.5, 0.5), np.arange(0, height + 0.5, 0.5))
    nodes = np.column_stack([x.ravel(), y.ravel()])
    bands, none = np.zeros((1, height, width), np.uint8), np.zeros((0, 3), np.int32)
    seen = np.zeros(len(nodes), int)
    for tile in plan_tiles(Window(0, 0, width, height), core=core, halo=1):
        part = tile.read.slices()
        valid = np.ones(tile.read.shape, bool)
        partial = measure_tile(nodes, none, bands[:, *part], valid, tile.read, tile.core)
        seen[partial.node_index] += 1
    assert (seen == 1).all()


def test_arrays_that_do_not_fit_the_window_are_refused(scene):
    nodes, triangles, bands, valid = scene
    with pytest.raises(ValueError, match="do not cover"):
        measure_tile(nodes, triangles, bands, valid, Window(0, 0, 90, 71), Window(0, 0, 9, 9))
    with pytest.raises(ValueError, match="not inside"):
        measure_tile(nodes, triangles, bands, valid, Window(0, 0, 90, 70), Window(85, 0, 9, 9))


def test_statistics_are_read_only(scene):
    found = statistics(*scene)
    with pytest.raises(ValueError, match="read-only"):
        found.mean[0, 0] = 1


def test_columns_are_named_by_band_and_statistic(scene):
    found = statistics(*scene)
    bands = [Band(k, None, None, name) for k, name in enumerate(("red", "nir", "b3"), start=1)]
    columns = triangle_columns(found, bands, which=("mean", "max"))
    assert list(columns) == [
        *("count", "red_mean", "red_max", "nir_mean", "nir_max", "b3_mean", "b3_max")
    ]
    np.testing.assert_array_equal(columns["nir_max"], found.max[1])
    default = triangle_columns(found, bands[:1])
    assert list(default) == ["count", "red_mean", "red_std", "red_min", "red_max"]
    values = node_columns(found, bands)
    assert list(values) == ["red", "nir", "b3"]
    np.testing.assert_array_equal(values["nir"], found.node_values[1])


@given(st.lists(st.tuples(*[st.integers(0, 255)] * 3), max_size=20))
def test_colors_are_those_of_string_formatting(rows):
    found = format_colors(np.array(rows, np.uint8).reshape(-1, 3))
    assert found.dtype == "<U7"
    assert found.tolist() == [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in rows]
