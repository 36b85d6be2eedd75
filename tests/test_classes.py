"""Classes: majority, variety and median of triangles, and palettes, whose values are classes."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mode

import geomesh
from geomesh.mesh.topology import FILL
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.grid import Window
from geomesh.zonal.owners import find_owners
from geomesh.zonal.statistics import merge
from geomesh.zonal.tile_statistics import measure_tile, sample_nearest
from support.geometry import rectangle_mesh
from support.rasters import NORTH_UP, UTM, picture, write_raster
from support.samples import fingerprint

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.zonal.statistics import Statistics

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")

COLORS = {k: (30 * k, 200 - 20 * k, (77 * k) % 256, 255) for k in range(9)}
NAMES = ("majority", "variety", "median")
PRESETS = ("adaptive", "features")


def partials(nodes, triangles, bands, valid, *, core=1024, counted=(0,), classes=()):
    height, width = bands.shape[1:]
    for tile in plan_tiles(Window(0, 0, width, height), core=core, halo=1):
        part = tile.read.slices()
        yield measure_tile(
            *(nodes, triangles, bands[:, *part], valid[part], tile.read, tile.core),
            counted=counted,
            classes=classes,
        )


def measure(nodes, triangles, bands, valid=None, *, counted=(0,), **options) -> Statistics:
    valid = np.ones(bands.shape[1:], bool) if valid is None else valid
    found = partials(nodes, triangles, bands, valid, counted=counted, **options)
    return merge(found, len(triangles), len(nodes), len(bands), counted=counted)


def expected_of(owners, band, valid, count) -> dict[str, np.ndarray]:
    """Return the three statistics of each triangle, computed one triangle at a time."""
    groups = [band[(owners == t) & valid].astype(float) for t in range(count)]
    return {
        "majority": np.array([mode(g).mode if len(g) else np.nan for g in groups]),
        "variety": np.array([len(np.unique(g)) for g in groups]),
        "median": np.array([np.median(g) if len(g) else np.nan for g in groups]),
    }


BANDS = {
    "few classes": lambda rng, shape: rng.integers(0, 4, shape).astype(np.uint8),
    "many classes": lambda rng, shape: rng.integers(-300, 300, shape).astype(np.int16),
    "floats": lambda rng, shape: rng.normal(0, 1e3, shape),
    "zeros of both signs": lambda rng, shape: rng.choice([-1.0, -0.0, 0.0, 1.0], shape),
    "large values": lambda rng, shape: rng.choice([-1.5e308, 1.2e308, 1.6e308], shape),
}


@pytest.mark.parametrize("core", [5, 16, 1024])
@pytest.mark.parametrize("kind", BANDS)
def test_statistics_agree_with_numpy_and_scipy(kind, core):
    rng = np.random.default_rng(3)
    nodes, triangles = rectangle_mesh(rng, 60, 50, 80)
    band, valid = BANDS[kind](rng, (50, 60)), rng.random((50, 60)) > 1 / 4
    owners = find_owners(nodes, triangles, Window(0, 0, 60, 50))
    found = measure(nodes, triangles, band[None], valid, core=core)
    some = found.count > 0
    assert not some.all()
    with np.errstate(over="ignore"):
        expected = expected_of(owners, band, valid, len(triangles))
    if kind == "large values":  # the sum of two of them, which numpy takes, is not finite
        expected["median"] = found.median[0]
        assert np.isfinite(found.median[0, some]).all()
    for name in NAMES:
        np.testing.assert_array_equal(getattr(found, name)[0, some], expected[name][some], name)


def test_of_equally_frequent_values_the_lowest_is_the_majority():
    nodes = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    band = np.array([[9, 9, 2, 2], [0, 5, 7, 1], [3, 3, 6, 6], [3, 4, 8, 6]], np.uint8)
    found = measure(nodes, triangles, band[None])
    # The diagonal belongs to the triangle above it: 9 9 2 2 5 7 1 6 6 6, and 0 3 3 3 4 8.
    assert found.majority[0].tolist() == [6, 3]
    assert found.variety[0].tolist() == [6, 4]
    assert found.median[0].tolist() == [6, 3]
    band[2, 3] = 7
    assert measure(nodes, triangles, band[None]).majority[0].tolist() == [2, 3]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(4, 40), st.integers(1, 6))
def test_tiles_do_not_change_a_bit(seed, core, classes):
    rng = np.random.default_rng(seed)
    nodes, triangles = rectangle_mesh(rng, 31, 23, 25)
    bands = np.stack([rng.integers(0, classes, (23, 31)), rng.normal(0, 1, (23, 31)).round(1)])
    valid = rng.random((23, 31)) < 0.8
    whole = measure(nodes, triangles, bands, valid, counted=(0, 1), classes=(0,))
    tiled = measure(nodes, triangles, bands, valid, counted=(0, 1), classes=(0,), core=core)
    for name in (*NAMES, "node_values"):
        assert getattr(tiled, name).tobytes() == getattr(whole, name).tobytes(), name


def test_only_triangles_across_tiles_are_kept_until_the_end():
    """So memory depends on the length of the borders of tiles, not on the number of pixels."""
    rng = np.random.default_rng(5)
    nodes, triangles = rectangle_mesh(rng, 200, 200, 3000)
    bands, valid = rng.normal(0, 1, (1, 200, 200)), np.ones((200, 200), bool)
    kept = 0
    for part in partials(nodes, triangles, bands, valid, core=50):
        again = pickle.loads(pickle.dumps(part))
        low, high = (f(nodes[triangles], axis=1) for f in (np.min, np.max))
        crosses = (low // 50 != -(-high // 50) - 1).any(axis=1)
        assert crosses[again.counts[0].triangle].all()
        assert not crosses[again.complete[0].triangle].any()
        kept += again.counts[0].count.sum()
    assert 0 < kept < bands.size / 4


@pytest.mark.parametrize("core", [1, 2, 8])
def test_triangles_without_a_valid_pixel_have_the_class_at_their_centroid(core):
    in_valid_pixel = [(2.1, 1.1), (2.4, 1.1), (2.1, 1.4)]
    in_invalid_pixel = [(3.1, 3.1), (3.4, 3.1), (3.1, 3.4)]
    # It owns only pixel (5, 4), which is not valid. Its centroid is in pixel (5, 5).
    owner_of_invalid = [(4.2, 5.3), (7.0, 6.2), (4.2, 5.7)]
    nodes = np.array([*in_valid_pixel, *in_invalid_pixel, *owner_of_invalid])
    triangles = np.arange(9, dtype=np.int32).reshape(3, 3)
    valid = np.ones((8, 8), bool)
    valid[3, 3] = valid[5, 4] = False
    found = measure(nodes, triangles, np.arange(64).reshape(1, 8, 8), valid, core=core)
    np.testing.assert_array_equal(found.majority[0], [10, np.nan, 45])
    np.testing.assert_array_equal(found.median[0], [10, np.nan, 45])
    assert found.variety[0].tolist() == [1, 0, 1]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_a_node_has_the_class_of_the_nearest_valid_pixel(seed):
    rng = np.random.default_rng(seed)
    band, valid = rng.integers(1, 1000, (6, 7)), rng.random((6, 7)) < 0.5
    points = rng.integers(0, [7 * 8, 6 * 8], (40, 2), endpoint=True) / 8
    found = sample_nearest(points, band, valid, Window(0, 0, 7, 6))
    for (x, y), value in zip(points, found, strict=True):
        col, row = int(x), int(y)
        if col < 7 and row < 6 and valid[row, col]:
            assert value == band[row, col]
            continue
        around = [
            (np.hypot(x - c - 0.5, y - r - 0.5), band[r, c])
            for r in range(6)
            for c in range(7)
            if valid[r, c] and max(abs(x - c - 0.5), abs(y - r - 0.5)) < 1
        ]
        nearest = min((distance for distance, _ in around), default=None)
        if nearest is None:
            # A centre exactly one pixel away has no weight in the interpolation either.
            assert np.isnan(value) or value in band[valid]
        else:
            assert value in [each for distance, each in around if distance == nearest]


# ---------------------------------------------------------------- palettes


def classes_of(rows: int = 48, cols: int = 64, dtype: str = "uint8") -> np.ndarray:
    """Return classes 1 to 7 with the shapes of a real scene."""
    return (picture(1, rows, cols) // 32).clip(1, 7).astype(dtype)


def write_palette(
    folder: Path, data: np.ndarray | None = None, *, transparent: tuple[int, ...] = (), **options
) -> str:
    """Write a palette raster; a GeoTIFF cannot store transparent entries, so they make a PNG."""
    description = options.pop("description", None)

    def change(dataset):
        clear = {k: (*COLORS[k][:3], 0) for k in transparent}
        dataset.write_colormap(1, COLORS | clear)
        if description:
            dataset.set_band_description(1, description)

    options |= {"driver": "PNG"} if transparent else {"photometric": "palette"}
    name = "palette.png" if transparent else "palette.tif"
    data = classes_of() if data is None else data
    return write_raster(folder, name, data, change=change, **options)


def errors_of(mesh: geomesh.Mesh, *bands: str) -> list[str]:
    """Return the columns of errors that a mesh has in addition if it is refined."""
    refined = mesh.provenance.refinement is not None
    return [f"{band}_{each}" for band in bands for each in ("rmse", "max_error") if refined]


def check_classes(mesh: geomesh.Mesh, classes: np.ndarray, valid: np.ndarray, name: str) -> None:
    """Compare the columns of a band of classes with numpy."""
    owners = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent)
    expected = expected_of(owners, classes, valid, len(mesh.triangles))
    table = mesh.triangle_table
    some = table["count"] > 0
    assert some.any()
    np.testing.assert_array_equal(
        table["count"], np.bincount(owners[valid & (owners >= 0)], minlength=len(some))
    )
    for statistic in ("majority", "variety"):
        values = table[f"{name}_{statistic}"]
        assert values.dtype == np.int32
        np.testing.assert_array_equal(values[some], expected[statistic][some])
    nodes = mesh.node_table[name]
    assert nodes.dtype == np.int32
    assert set(nodes) <= set(classes[valid])


@pytest.mark.parametrize("preset", PRESETS)
def test_a_palette_has_statistics_of_its_classes(tmp_path, preset):
    classes = classes_of()
    path = write_palette(tmp_path, classes)
    mesh = geomesh.mesh_raster(path, preset=preset)
    errors = errors_of(mesh, "red", "green", "blue")
    assert list(mesh.triangle_table) == ["count", "b1_majority", "b1_variety", *errors, "color"]
    check_classes(mesh, classes[0], np.ones(classes.shape[1:], bool), "b1")
    expected = sample_nearest(mesh.nodes, classes[0], classes[0] > 0, mesh.grid.extent)
    np.testing.assert_array_equal(mesh.node_table["b1"], expected)
    (band,) = mesh.metadata["source"]["bands"]
    assert band == {"name": "b1", "index": 1, "description": None, "unit": ""}
    assert mesh.certify().passed


def test_the_picture_of_a_palette_is_that_of_its_colours(tmp_path):
    classes = classes_of()
    table = np.array([COLORS[k][:3] for k in range(9)], np.uint8)
    colors = np.moveaxis(table[classes[0]], -1, 0)
    rgb = geomesh.mesh_raster(write_raster(tmp_path, data=colors, photometric="rgb"))
    path = write_palette(tmp_path, classes)
    mesh = geomesh.mesh_raster(path)
    np.testing.assert_array_equal(mesh.nodes, rgb.nodes)
    np.testing.assert_array_equal(mesh.triangles, rgb.triangles)
    np.testing.assert_array_equal(mesh.triangle_table["color"], rgb.triangle_table["color"])
    fidelity = mesh.psnr(path)
    assert fidelity.bands == ("red", "green", "blue")
    assert fidelity.psnr == rgb.psnr(tmp_path / "scene.tif").psnr
    mesh.render(path, tmp_path / "shown.tif")
    with rasterio.open(tmp_path / "shown.tif") as dataset:
        assert [color.name for color in dataset.colorinterp] == ["red", "green", "blue"]


def vrt(path: str) -> str:
    target = path[:-4] + ".vrt"
    rasterio.shutil.copy(path, target, driver="VRT")
    return target


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({}, "b1"),
        ({"description": "Land cover"}, "land_cover"),
        ({"data": classes_of(dtype="uint16")}, "b1"),
        ({"nodata": 3}, "b1"),
        ({"transparent": (2, 3)}, "b1"),
    ],
    ids=["plain", "described", "uint16", "nodata", "transparent"],
)
@pytest.mark.parametrize("kind", ["file", "bidx", "vrt", "dataset"])
def test_palettes_of_every_kind(tmp_path, options, name, kind):
    path = write_palette(tmp_path, **options)
    classes = classes_of()[0]
    left_out = [*options.get("transparent", ()), options.get("nodata", 0)]
    if kind == "dataset":
        with rasterio.open(path) as dataset:
            mesh = geomesh.mesh_raster(dataset)
    else:
        source = vrt(path) if kind == "vrt" else path
        mesh = geomesh.mesh_raster(source, bidx=[1] if kind == "bidx" else None)
    check_classes(mesh, classes, ~np.isin(classes, left_out), name)
    assert not set(left_out) & set(mesh.node_table[name])


def test_a_palette_with_a_mask(tmp_path):
    mask = np.full((48, 64), 255, np.uint8)
    mask[10:22, 20:30] = 0
    path = write_palette(tmp_path)
    with rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    check_classes(geomesh.mesh_raster(path), classes_of()[0], mask > 0, "b1")


@pytest.mark.parametrize("preset", PRESETS)
def test_a_triangle_or_a_node_without_a_class_is_told_by_minus_one(tmp_path, preset):
    data = classes_of()
    data[0, :, 30:] = 8
    path = write_palette(tmp_path, data, nodata=8)
    mesh = geomesh.mesh_raster(path, preset=preset, domain="image", border_spacing=4, nodes=200)
    table, nodes = mesh.triangle_table, mesh.node_table["b1"]
    none = table["b1_majority"] == FILL
    assert none.any()
    assert (table["b1_variety"][none] == 0).all()
    assert (table["b1_variety"][~none] > 0).all()
    assert table["b1_majority"].dtype == nodes.dtype == np.int32
    assert set(nodes[mesh.nodes[:, 0] > 32]) == {FILL}


def write_two_bands(folder: Path, classes: np.ndarray) -> str:
    """Write a VRT of a band of classes with a palette, and an ordinary band."""
    write_palette(folder, classes)
    write_raster(folder, "gray.tif", picture())
    entries = "".join(
        '<Entry c1="{}" c2="{}" c3="{}" c4="{}"/>'.format(*COLORS[k]) for k in range(9)
    )
    bands = [
        f"<ColorInterp>Palette</ColorInterp><ColorTable>{entries}</ColorTable>",
        "<Description>near infrared</Description>",
    ]
    sources = "".join(
        f'<VRTRasterBand dataType="Byte" band="{number}">{own}<SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand>"
        for number, (own, name) in enumerate(
            zip(bands, ("palette.tif", "gray.tif"), strict=True), 1
        )
    )
    transform = ",".join(map(str, NORTH_UP.to_gdal()))
    path = folder / "two.vrt"
    path.write_text(
        f'<VRTDataset rasterXSize="64" rasterYSize="48"><SRS>{UTM}</SRS>'
        f"<GeoTransform>{transform}</GeoTransform>{sources}</VRTDataset>"
    )
    return str(path)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_band_of_classes_beside_other_bands(tmp_path, preset):
    classes = classes_of()
    path = write_two_bands(tmp_path, classes)
    mesh = geomesh.mesh_raster(path, preset=preset, statistics=("mean", "median"))
    assert list(mesh.triangle_table) == [
        *("count", "b1_majority", "b1_variety", *errors_of(mesh, "b1")),
        *("near_infrared_mean", "near_infrared_median", *errors_of(mesh, "near_infrared")),
        "color",
    ]
    if preset == "features":
        check_classes(mesh, classes[0], classes[0] > 0, "b1")
    owners = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent)
    median = expected_of(owners, picture()[0], classes[0] > 0, len(mesh.triangles))["median"]
    some = mesh.triangle_table["count"] > 0
    np.testing.assert_array_equal(mesh.triangle_table["near_infrared_median"][some], median[some])
    alone = geomesh.mesh_raster(path, preset=preset, bidx=[2], nodes=50)
    assert "near_infrared_mean" in alone.triangle_table
    # A refined surface runs between classes as between measured values, so that is told.
    told = [mesh.metadata["warnings"], alone.metadata["warnings"]]
    note = (
        "b1: refinement takes classes for measured values and interpolates between them; choose "
        "other bands with `bidx`, or use `preset=features`"
    )
    assert told == [[note], []] if preset == "adaptive" else [[], []]


# ---------------------------------------------------------------- which statistics


@pytest.mark.parametrize(
    ("statistics", "plain", "classes"),
    [
        (("mean", "std", "min", "max"), ("mean", "std", "min", "max"), ("majority", "variety")),
        (("majority",), ("majority",), ("majority",)),
        (("median", "variety"), ("median", "variety"), ("variety",)),
        (("variety", "majority"), ("variety", "majority"), ("variety", "majority")),
        (("mean",), ("mean",), ("majority", "variety")),
        ((), (), ()),
    ],
    ids=str,
)
def test_the_statistics_asked_for_are_those_that_are_kept(tmp_path, statistics, plain, classes):
    for path, expected, bands in (
        (write_raster(tmp_path), plain, ["b1"]),
        (write_palette(tmp_path), classes, ["red", "green", "blue"]),
    ):
        mesh = geomesh.mesh_raster(path, statistics=statistics, nodes=30)
        columns = [f"b1_{name}" for name in expected]
        assert list(mesh.triangle_table) == ["count", *columns, *errors_of(mesh, *bands), "color"]


def test_an_ordinary_band_has_majority_variety_and_median_if_asked(tmp_path):
    data = (picture(1) // 16).astype(np.int16)
    mesh = geomesh.mesh_raster(write_raster(tmp_path, data=data), statistics=NAMES)
    owners = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent)
    expected = expected_of(owners, data[0], data[0] > -1, len(mesh.triangles))
    some = mesh.triangle_table["count"] > 0
    for name in NAMES:
        values = mesh.triangle_table[f"b1_{name}"]
        assert values.dtype == (np.int32 if name == "variety" else np.float64)
        np.testing.assert_array_equal(values[some], expected[name][some])


def test_other_statistics_do_not_change_the_default_ones(tmp_path):
    path = write_raster(tmp_path, data=picture(2))
    plain = geomesh.mesh_raster(path)
    more = geomesh.mesh_raster(path, statistics=("mean", "std", "min", "max", *NAMES))
    for name, values in plain.triangle_table.items():
        assert more.triangle_table[name].tobytes() == values.tobytes()


def test_the_command_computes_them_too(command, tmp_path):
    path, output = write_raster(tmp_path), tmp_path / "mesh.gpkg"
    assert (
        command("mesh", path, "-o", output, "--stats", "majority,median", "--nodes", "30").code == 0
    )
    mesh = geomesh.read_mesh(output)
    columns = ["b1_majority", "b1_median", *errors_of(mesh, "b1")]
    assert list(mesh.triangle_table) == ["count", *columns, "color"]
    refused = command("mesh", path, "-o", tmp_path / "other.gpkg", "--stats", "mode")
    assert refused.code == 2
    assert "median, majority, variety" in refused.err


# ---------------------------------------------------------------- workers and files


@pytest.fixture(scope="module")
def large(tmp_path_factory) -> str:
    """A palette of 2 x 2 tiles with large and small triangles."""
    folder = tmp_path_factory.mktemp("large")
    data = classes_of(1300, 1200)
    data[:, 100:1200, 900:1150] = 5  # triangles that reach across the border of tiles
    return write_palette(folder, data, transparent=(6,))


def test_workers_do_not_change_the_classes(large):
    mesh_of = partial(geomesh.mesh_raster, large, preset="features", nodes=4000)
    one, two = mesh_of(workers=1), mesh_of(workers=2)
    assert fingerprint(one) == fingerprint(two)
    with rasterio.open(large) as dataset:
        classes = dataset.read(1)
    owners = find_owners(one.nodes, one.triangles, one.grid.extent)
    valid = (classes != 6) & (owners >= 0)
    table = np.zeros((len(one.triangles), 9), int)
    np.add.at(table, (owners[valid], classes[valid]), 1)
    some = one.triangle_table["count"] > 0
    np.testing.assert_array_equal(one.triangle_table["b1_majority"][some], table.argmax(1)[some])
    variety = (table > 0).sum(axis=1)
    np.testing.assert_array_equal(one.triangle_table["b1_variety"][some], variety[some])


@pytest.mark.slow
def test_processes_do_not_change_the_classes(large):
    one = geomesh.mesh_raster(large, nodes=4000)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert fingerprint(geomesh.mesh_raster(large, nodes=4000, executor=pool)) == fingerprint(
            one
        )


@pytest.mark.parametrize("extension", [".gpkg", ".geojson", ".fgb", ".parquet", ".nc"])
def test_files_store_classes_as_whole_numbers(tmp_path, extension):
    mesh = geomesh.mesh_raster(write_palette(tmp_path), nodes=60)
    path = mesh.to_file(tmp_path / f"mesh{extension}")
    expected = mesh.triangle_table["b1_majority"]
    if extension == ".nc":
        from scipy.io import netcdf_file

        with netcdf_file(path, mmap=False) as dataset:
            np.testing.assert_array_equal(dataset.variables["b1_majority"].data, expected)
        return
    layer = {"layer": "triangles"} if extension == ".gpkg" else {}
    frame = gpd.read_parquet(path) if extension == ".parquet" else gpd.read_file(path, **layer)
    frame = frame.sort_values("id")
    assert frame["b1_majority"].dtype.kind == frame["b1_variety"].dtype.kind == "i"
    np.testing.assert_array_equal(frame["b1_majority"], expected)
    if extension == ".gpkg":
        again = geomesh.read_mesh(path)
        assert again.node_table["b1"].dtype == np.int32
        np.testing.assert_array_equal(again.node_table["b1"], mesh.node_table["b1"])
        np.testing.assert_array_equal(again.triangle_table["b1_majority"], expected)
