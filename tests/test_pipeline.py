"""mesh_raster on real rasters: its results, compared with the file as other libraries read it."""

import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.features import rasterize
from scipy.spatial import cKDTree
from shapely import Polygon

import geomesh
from geomesh.errors import GeomeshWarning, RecipeError
from geomesh.parallel.tiles import plan_tiles
from support.samples import SAMPLES, mirrored

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")

PRESETS = ["features", "paper"]


def mask_of(path):
    """Return the pixels that are valid in every band."""
    with rasterio.open(path) as dataset:
        return dataset.read_masks().all(axis=0)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_sample_gives_a_certified_mesh(sample, preset):
    mesh = geomesh.mesh_raster(sample, preset=preset)
    certificate = mesh.certify()
    assert certificate.passed, certificate.to_dict()
    with rasterio.open(sample) as dataset:
        assert (mesh.grid.width, mesh.grid.height) == (dataset.width, dataset.height)
        assert (mesh.grid.crs is None) == (dataset.crs is None)
        if dataset.crs:
            assert mesh.grid.crs.to_epsg() == dataset.crs.to_epsg()
    triangles = mesh.to_geodataframe()
    assert triangles.is_valid.all()
    assert triangles.exterior.is_ccw.all()


@pytest.mark.parametrize("min_hole", [1, 64])
def test_counts_add_up_to_the_valid_pixels(sample, min_hole):
    mesh = geomesh.mesh_raster(sample, min_hole=min_hole, effort="fast")
    assert mesh.certify().passed
    valid = mask_of(sample)
    assert mesh.domain.valid_pixels == valid.sum()
    counted = mesh.triangle_table["count"].sum()
    if min_hole == 1:
        assert counted == valid.sum()
    else:  # smaller islands are left out
        assert 0 <= valid.sum() - counted <= 64 * mesh.domain.islands_dropped


def test_statistics_are_those_of_the_pixels_in_each_triangle():
    path = SAMPLES / "iguacu_landsat8_rgb_uint16.tif"
    mesh = geomesh.mesh_raster(path, nodes=800)
    with rasterio.open(path) as dataset:
        bands = dataset.read().astype(float)
        frame = mesh.to_geodataframe()
        shapes = zip(frame.geometry, range(len(frame)), strict=True)
        owner = rasterize(
            shapes, dataset.shape, fill=-1, transform=dataset.transform, dtype="int32"
        )
    # Rasterization and geomesh may differ for centres that are exactly on an edge.
    count = np.bincount(owner[owner >= 0], minlength=len(frame))
    same = count == frame["count"]
    assert same.mean() > 0.98
    for band, name in zip(bands, ("b4_red", "b3_green", "b2_blue"), strict=True):
        total = np.bincount(owner[owner >= 0], band[owner >= 0], minlength=len(frame))
        close = np.isclose(frame[f"{name}_mean"][same], (total / np.maximum(count, 1))[same])
        assert close[count[same] > 0].mean() > 0.98
        some = int(frame["count"].to_numpy().argmax())
        values = band[owner == some]
        assert frame[f"{name}_min"][some] == values.min()
        assert frame[f"{name}_max"][some] == values.max()
        assert frame[f"{name}_std"][some] == pytest.approx(values.std(), rel=0.02)


def test_areas_are_those_of_geopandas_in_a_projected_crs(olinda):
    frame = geomesh.mesh_raster(olinda).to_geodataframe()
    np.testing.assert_allclose(frame["area"], frame.geometry.area, rtol=1e-9)
    with rasterio.open(olinda) as dataset:
        expected = dataset.width * dataset.height * abs(dataset.transform.determinant)
    assert frame["area"].sum() == pytest.approx(expected, rel=1e-9)


def test_colours_are_those_of_the_image(olinda):
    mesh = geomesh.mesh_raster(olinda)
    means = np.column_stack([mesh.triangle_table[f"{c}_mean"] for c in ("red", "green", "blue")])
    told = [[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in mesh.triangle_table["color"]]
    assert np.abs(np.array(told) - means).max() <= 0.5


@pytest.mark.parametrize("budget", [50, 500, "0.5%"])
def test_the_node_budget_counts_all_nodes_and_is_met(olinda, budget):
    expected = budget if isinstance(budget, int) else round(0.005 * 349 * 352)
    for preset in ("adaptive", "features"):
        mesh = geomesh.mesh_raster(olinda, nodes=budget, preset=preset)
        assert len(mesh.nodes) == expected
        inside = mesh.nodes[mesh.node_table["kind"] != "border"]
        halves = np.histogram2d(*inside.T, bins=2, range=[(0, 349), (0, 352)])[0]
        assert halves.min() > 0.1 * len(inside)


def test_a_smaller_budget_keeps_a_part_of_the_features_of_a_larger_one(olinda):
    """The cells depend on the budget, but the strongest features are in both meshes."""
    large = geomesh.mesh_raster(olinda, preset="features", nodes=1000)
    small = geomesh.mesh_raster(olinda, preset="features", nodes=200)
    kept = small.nodes[small.node_table["kind"] == "feature"]
    distance, _ = cKDTree(large.nodes[large.node_table["kind"] == "feature"]).query(kept)
    assert (distance == 0).mean() > 0.9


def test_features_keep_their_spacing_and_lie_on_the_lattice(olinda):
    mesh = geomesh.mesh_raster(olinda, preset="features", min_spacing=5)
    features = mesh.nodes[mesh.node_table["kind"] == "feature"]
    nearest, _ = cKDTree(features).query(features, k=2)
    assert nearest[:, 1].min() >= 5
    np.testing.assert_array_equal(features * 256, np.rint(features * 256))


def test_two_runs_are_equal_to_the_last_bit(olinda):
    first, second = (geomesh.mesh_raster(olinda) for _ in range(2))
    assert_identical(first, second)


def assert_identical(first, second):
    np.testing.assert_array_equal(first.nodes, second.nodes)
    np.testing.assert_array_equal(first.triangles, second.triangles)
    for layer in ("triangles", "edges", "nodes"):
        one, other = first.attributes(layer), second.attributes(layer)
        assert list(one) == list(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


def test_the_order_of_tiles_does_not_matter(monkeypatch):
    """Detection over four tiles in any order gives the same nodes and triangles."""
    image = mirrored(SAMPLES / "sanfrancisco_landsat7_nrg_uint8.tif", 1300, 1200)
    image = np.ma.masked_equal(image, 0)
    source = (image, Affine(30, 0, 0, 0, -30, 0), "EPSG:32610")
    forward = geomesh.mesh_raster(source, preset="features")

    def backward(*args, **options):
        return plan_tiles(*args, **options)[::-1]

    monkeypatch.setattr("geomesh.features.detect.plan_tiles", backward)
    assert len(backward(forward.grid.extent)) == 4
    assert_identical(forward, geomesh.mesh_raster(source, preset="features"))


@pytest.mark.parametrize("domain", ["valid", "image", "hull"])
def test_the_domain_is_what_was_asked_for(domain):
    path = SAMPLES / "parana_landsat8_rgb_uint16_nodata_edge.tif"
    # A refined mesh has no hull: see test_adaptive.py.
    options = {"preset": "features"} if domain == "hull" else {}
    mesh = geomesh.mesh_raster(path, domain=domain, **options)
    covered = mesh.to_geodataframe().union_all()
    pixel = 30 * 30
    share = covered.area / (512 * 512 * pixel)
    valid_share = mask_of(path).mean()
    if domain == "image":
        assert share == pytest.approx(1)
    elif domain == "valid":
        assert share == pytest.approx(valid_share, abs=0.005)
    else:
        assert share < valid_share
        assert covered.area == pytest.approx(covered.convex_hull.area)
    assert mesh.domain.kind == domain
    assert mesh.certify().passed


def test_turning_the_grid_turns_the_mesh(olinda):
    """The same pixels on a rotated or flipped grid: same nodes in pixels, ccw on the map."""
    with rasterio.open(olinda) as dataset:
        bands = dataset.read()
    plain = geomesh.mesh_raster((bands, Affine(30, 0, 5e5, 0, -30, 9e6), "EPSG:31985"))
    turned = geomesh.mesh_raster((bands, Affine(20, 22, 5e5, 22, -20, 9e6), "EPSG:31985"))
    flipped = geomesh.mesh_raster((bands, Affine(30, 0, 5e5, 0, 30, 9e6), "EPSG:31985"))
    for other in (turned, flipped):
        np.testing.assert_array_equal(other.nodes, plain.nodes)
        assert other.to_geodataframe().exterior.is_ccw.all()
        assert other.certify().passed
    a = Affine(20, 22, 5e5, 22, -20, 9e6)
    expected = [(a.a * x + a.b * y + a.c, a.d * x + a.e * y + a.f) for x, y in plain.nodes]
    np.testing.assert_allclose(turned.map_nodes, expected, rtol=1e-12)


def test_bands_and_gray_can_be_chosen():
    path = SAMPLES / "olinda_landsat7_6band_uint8.tif"
    mesh_of = partial(geomesh.mesh_raster, path, preset="features")
    mesh = mesh_of(bidx=[4, 3], gray="band:4")
    assert [c for c in mesh.triangle_table if c.endswith("mean")] == ["b4_nir_mean", "b3_red_mean"]
    other = mesh_of(bidx=[4, 3], gray="band:3")
    assert len(mesh.nodes) != len(other.nodes)
    alone = mesh_of(bidx=[4])
    np.testing.assert_array_equal(alone.nodes, mesh.nodes)


def test_only_the_statistics_asked_for_are_kept(olinda):
    for preset, errors in (("adaptive", ["rmse", "max_error"]), ("features", [])):
        mesh = geomesh.mesh_raster(olinda, preset=preset, statistics=("max",))
        told = ["max", *errors]
        columns = [f"{band}_{each}" for band in ("red", "green", "blue") for each in told]
        assert list(mesh.triangle_table) == ["count", *columns, "color"]


def test_a_mesh_can_be_made_again_from_its_metadata(olinda):
    mesh = geomesh.mesh_raster(olinda, nodes=400, canny_low=30.0, domain="image")
    recipe = geomesh.Recipe.from_dict(mesh.metadata["recipe"])
    assert_identical(mesh, geomesh.mesh_raster(olinda, recipe=recipe))
    assert mesh.metadata["source"]["name"] == str(olinda)
    assert mesh.metadata["versions"]["geomesh"] == geomesh.__version__


def test_sources_of_every_kind_give_the_same_mesh(olinda):
    by_path = geomesh.mesh_raster(str(olinda))
    assert_identical(by_path, geomesh.mesh_raster(olinda))
    with rasterio.open(olinda) as dataset:
        assert_identical(by_path, geomesh.mesh_raster(dataset))
        assert not dataset.closed
        by_array = geomesh.mesh_raster((dataset.read(), dataset.transform, dataset.crs))
    np.testing.assert_array_equal(by_array.nodes, by_path.nodes)
    assert by_array.grid == by_path.grid


def test_warnings_are_given_and_kept():
    path = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
    with pytest.warns(GeomeshWarning, match="no georeference"):
        mesh = geomesh.mesh_raster(path)
    assert "no georeference" in mesh.metadata["warnings"][0]


@pytest.mark.parametrize("preset", ["adaptive", *PRESETS])
def test_progress_rises_to_one_and_can_cancel(olinda, preset):
    told = []
    geomesh.mesh_raster(olinda, preset=preset, progress=lambda *news: told.append(news))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    assert all(message for _, message in told)

    class CancelledError(Exception):
        pass

    def cancel(fraction, _message):
        if fraction > 0.5:
            raise CancelledError

    with pytest.raises(CancelledError):
        geomesh.mesh_raster(olinda, preset=preset, progress=cancel)


def test_unknown_parameters_are_named():
    with pytest.raises(RecipeError, match="canny_lo"):
        geomesh.mesh_raster("unused.tif", canny_lo=3)


def test_a_mesh_survives_pickling(olinda):
    mesh = geomesh.mesh_raster(olinda)
    again = pickle.loads(pickle.dumps(mesh))
    assert_identical(mesh, again)
    assert again.certify().passed


def test_no_warning_of_another_library_reaches_the_user(sample):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", GeomeshWarning)
        geomesh.mesh_raster(sample, effort="fast")


def test_band_descriptions_say_what_to_show_as_colour():
    """Bands 1, 2, 3 are blue, green, red, but their colour interpretation does not say it."""
    six = geomesh.mesh_raster(SAMPLES / "olinda_landsat7_6band_uint8.tif")
    means = np.column_stack(
        [six.triangle_table[f"{name}_mean"] for name in ("b3_red", "b2_green", "b1_blue")]
    )
    told = [[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in six.triangle_table["color"]]
    assert np.abs(np.array(told) - means).max() <= 0.5


def test_an_area_of_interest_does_not_depend_on_the_tiles():
    """The border is a zigzag along the seam of two tiles, through many pixel centres."""
    rng = np.random.default_rng(5)
    image = rng.integers(0, 255, (1100, 1100), np.uint8)
    transform = Affine(0.1, 0, -37.3, 0, -0.1, 12.7)
    y = np.linspace(0, 1100, 500)
    x = 1024 + rng.integers(-3, 4, 500) * 0.5
    ring = [(0, 0), *np.column_stack([x, y]), (0, 1100)]
    corners = [(0.1 * a - 37.3, -0.1 * b + 12.7) for a, b in ring]
    area = gpd.GeoSeries([Polygon(corners)])
    mesh = geomesh.mesh_raster((image, transform, None), mask=area, nodes=3000, min_hole=1)
    assert mesh.certify().passed
    assert mesh.triangle_table["count"].sum() == mesh.domain.valid_pixels == mesh.domain.pixels


def test_statistics_of_float32_are_taken_in_float64():
    with rasterio.open(SAMPLES / "colorado_dem_float32_epsg4269.tif") as dataset:
        band, transform = dataset.read(1), dataset.transform
    single = geomesh.mesh_raster((band, transform, "EPSG:4269"), nodes=100)
    double = geomesh.mesh_raster((band.astype(float), transform, "EPSG:4269"), nodes=100)
    for name in ("b1_mean", "b1_std"):
        np.testing.assert_array_equal(single.triangle_table[name], double.triangle_table[name])


def test_threads_do_not_get_each_others_warnings():
    names = ["sanfrancisco_landsat7_nrg_uint8.tif", "olinda_landsat7_rgb_uint8.tif"] * 4

    def mesh_of(name):
        return geomesh.mesh_raster(SAMPLES / name, preset="features")

    alone = {name: mesh_of(name) for name in set(names)}
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(mesh_of, names))
    for name, mesh in zip(names, together, strict=True):
        assert mesh.metadata["warnings"] == alone[name].metadata["warnings"]
        assert_identical(mesh, alone[name])


@pytest.mark.parametrize("budget", [400, 500])
def test_features_outside_the_domain_take_nothing_from_the_budget(budget):
    mesh = geomesh.mesh_raster(
        SAMPLES / "rmnp_rgb.tif", preset="paper", domain="valid", nodes=budget
    )
    assert len(mesh.nodes) == budget


def test_a_threshold_beyond_every_gradient_finds_nothing(olinda):
    mesh = geomesh.mesh_raster(olinda, preset="features", canny_high=1e200)
    assert "no keypoints" in mesh.metadata["warnings"][0]
