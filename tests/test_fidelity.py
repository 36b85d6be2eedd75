"""How exactly meshes show their rasters: tiles, workers, bands, nodata, other grids."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import rasterio
from affine import Affine
from geopandas import GeoSeries
from matplotlib.tri import LinearTriInterpolator, Triangulation
from rasterio.io import MemoryFile
from shapely import box

import geomesh
from geomesh.errors import (
    BandError,
    EmptyError,
    GeomeshWarning,
    GeoreferenceError,
    MeshFileError,
)
from geomesh.mesh.topology import FILL
from geomesh.parallel.workers import open_workers
from geomesh.raster.open import open_scene
from geomesh.surface import fit as surface
from geomesh.surface.fidelity import Fidelity, compare
from geomesh.surface.fit import fit_surface
from geomesh.surface.original import open_original
from geomesh.zonal import statistics as zonal
from geomesh.zonal.owners import find_owners
from support.samples import OLINDA, SAMPLES, mirrored

MODELS = ("linear", "constant")
FITS = ("sampled", "least_squares")
UTM = "EPSG:31985"
NORTH_UP = Affine(28.5, 0, 288_776, 0, -28.5, 9_120_760)


def silent(fraction, message):
    pass


@pytest.fixture(autouse=True)
def _quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        yield


@pytest.fixture(scope="module")
def mesh():
    """A mesh that is not refined: the values at its nodes are those of the pixels."""
    return geomesh.mesh_raster(OLINDA, preset="features", nodes=500)


def read(path, **options):
    """Return bands as float64 and their validity, read only with rasterio."""
    with rasterio.open(path) as dataset:
        return dataset.read(**options).astype(float), dataset.dataset_mask() > 0


def decibels(errors, peak):
    with np.errstate(divide="ignore"):
        return 20 * np.log10(peak / np.sqrt((errors**2).mean()))


# ---------------------------------------------------------------- reported figures


def test_psnr_of_sampled_values_is_that_of_matplotlib_and_numpy(mesh, olinda):
    bands, _ = read(olinda)
    _, height, width = bands.shape
    row, col = np.mgrid[:height, :width] + 0.5
    found = mesh.psnr(olinda, fit="sampled")
    for band, name in enumerate(("red", "green", "blue")):
        plane = LinearTriInterpolator(
            Triangulation(*mesh.nodes.T, mesh.triangles), mesh.node_table[name]
        )
        errors = bands[band] - plane(col, row)
        assert errors.count() == errors.size == found.pixels
        assert found.rmse[band] == pytest.approx(np.sqrt((errors**2).mean()), rel=1e-9)
        assert found.psnr[band] == pytest.approx(decibels(errors, 255), rel=1e-9)
    every = np.sqrt(np.mean(np.square(found.rmse)))
    assert found.overall == pytest.approx(20 * np.log10(255 / every))
    assert (found.bands, found.peak) == (("red", "green", "blue"), (255, 255, 255))


def test_psnr_of_constant_triangles_is_that_of_their_means_or_centroids(mesh, olinda):
    bands, _ = read(olinda)
    owners = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent)
    col, row = np.floor(mesh.nodes[mesh.triangles].mean(axis=1)).astype(int).T
    means = mesh.psnr(olinda, model="constant")
    held = mesh.psnr(olinda, model="constant", fit="sampled")
    for band, name in enumerate(("red", "green", "blue")):
        mean = mesh.triangle_table[f"{name}_mean"][owners]
        assert means.psnr[band] == pytest.approx(decibels(bands[band] - mean, 255))
        at_centroid = bands[band][row, col][owners]
        assert held.psnr[band] == pytest.approx(decibels(bands[band] - at_centroid, 255))


def test_each_sample_is_shown_best_by_least_squares(sample):
    mesh = geomesh.mesh_raster(sample)
    with rasterio.open(sample) as dataset:
        dtype = dataset.dtypes[0]
    found = {
        (model, fit): mesh.psnr(sample, model=model, fit=fit) for model in MODELS for fit in FITS
    }
    for model in MODELS:
        one, other = found[model, "sampled"], found[model, "least_squares"]
        assert one.pixels == other.pixels == mesh.metadata["pixels"]["counted"]
        assert (np.array(other.rmse) <= np.array(one.rmse)).all()
        assert other.overall > one.overall + (0.05 if dtype == "float32" else 0.5)
        if dtype == "uint8":
            assert set(one.peak) == {255}
    assert found["linear", "least_squares"].overall > found["constant", "least_squares"].overall


def test_the_peak_of_a_dem_is_the_range_of_its_valid_pixels():
    path = SAMPLES / "colorado_dem_float32_epsg4269.tif"
    bands, valid = read(path)
    found = geomesh.mesh_raster(path).psnr(path)
    assert found.peak == (np.ptp(bands[0][valid]),)
    assert found.psnr[0] == pytest.approx(20 * np.log10(found.peak[0] / found.rmse[0]))
    assert found.overall == pytest.approx(found.psnr[0])


def test_bands_count_by_their_own_range_in_the_overall_psnr():
    bands = mirrored(OLINDA, 90, 80)[:2].astype(float)
    bands[1] = bands[0] * 1000 - 7
    source = (bands, NORTH_UP, UTM)
    found = geomesh.mesh_raster(source).psnr(source)
    assert found.rmse[1] == pytest.approx(found.rmse[0] * 1000)
    assert found.psnr[1] == pytest.approx(found.psnr[0])
    assert found.overall == pytest.approx(found.psnr[0])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (40, 50)])
@pytest.mark.parametrize(("value", "dtype"), [(7, "uint8"), (0.1, "float64"), (-3e38, "float32")])
def test_an_image_of_one_value_is_shown_exactly(model, fit, shape, value, dtype):
    source = (np.full(shape, value, dtype), NORTH_UP, UTM)
    found = geomesh.mesh_raster(source).psnr(source, model=model, fit=fit)
    assert (found.pixels, found.rmse, found.psnr) == (shape[0] * shape[1], (0,), (np.inf,))
    assert found.overall == np.inf
    assert found.summary()["psnr"] is None


def test_an_unknown_model_or_fit_is_refused(mesh, olinda):
    with pytest.raises(ValueError, match="model is 'cubic': choose linear or constant"):
        mesh.psnr(olinda, model="cubic")
    with pytest.raises(ValueError, match="fit is 'best': choose least_squares or sampled"):
        mesh.psnr(olinda, fit="best")


# ---------------------------------------------------------------- tiles and workers


def fit_and_compare(mesh, scene, workers=1, **how):
    with open_workers(workers) as pool, scene.open():
        made = fit_surface(mesh.nodes, mesh.triangles, scene, **how, workers=pool, progress=silent)
        return made.values, compare(made, scene, pool, silent)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize(
    "name", ["olinda_landsat7_rgb_uint8", "bahamas_landsat7_rgb_nodata_collar"]
)
def test_tiles_do_not_change_the_picture(monkeypatch, model, fit, name):
    path = SAMPLES / f"{name}.tif"
    mesh, scene = geomesh.mesh_raster(path, preset="features"), open_scene(path)
    values, found = fit_and_compare(mesh, scene, model=model, fit=fit)
    for module in (surface, zonal):
        monkeypatch.setattr(module, "plan_tiles", partial(module.plan_tiles, core=100))
    tiled, again = fit_and_compare(mesh, scene, model=model, fit=fit)
    np.testing.assert_allclose(tiled, values, rtol=1e-7, atol=1e-6)
    if fit == "sampled":
        assert tiled.tobytes() == values.tobytes()
    assert again.pixels == found.pixels
    np.testing.assert_allclose(again.rmse, found.rmse, rtol=1e-9)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("fit", FITS)
def test_workers_do_not_change_a_bit(monkeypatch, mesh, olinda, model, fit):
    for module in (surface, zonal):
        monkeypatch.setattr(module, "plan_tiles", partial(module.plan_tiles, core=64))
    one, two = (
        fit_and_compare(mesh, open_scene(olinda), workers, model=model, fit=fit)
        for workers in (1, 2)
    )
    assert one[0].tobytes() == two[0].tobytes()
    assert one[1] == two[1]


@pytest.mark.parametrize("fit", [*FITS, "stored"])
def test_progress_rises_and_may_cancel(mesh, olinda, fit):
    told = []
    mesh.psnr(olinda, fit=fit, progress=lambda *news: told.append(news))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    fitted = any(message.startswith("Fitting nodes") for _, message in told)
    assert fitted == (fit == "least_squares")

    def cancel(fraction, message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mesh.psnr(olinda, fit=fit, progress=cancel)


# ---------------------------------------------------------------- sources


@pytest.mark.parametrize(
    "transform",
    [
        Affine(30, 0, 5e5, 0, 30, 4e6),
        Affine(-30, 0, 5e5, 0, -30, 4e6),
        Affine.translation(5e5, 4e6) @ Affine.rotation(20) @ Affine.scale(30, -20),
    ],
    ids=["south up", "turned by half", "rotated"],
)
@pytest.mark.parametrize("model", MODELS)
def test_where_the_raster_lies_does_not_matter(olinda, transform, model):
    bands = mirrored(olinda, 100, 90)
    usual, turned = ((bands, place, UTM) for place in (NORTH_UP, transform))
    expected = geomesh.mesh_raster(usual).psnr(usual, model=model)
    found = geomesh.mesh_raster(turned).psnr(turned, model=model)
    np.testing.assert_allclose(found.rmse, expected.rmse, rtol=1e-9)


def test_nodata_and_masks_are_left_out(olinda):
    bands = mirrored(olinda, 120, 100).astype(np.int16)
    valid = np.ones((100, 120), bool)
    valid[20:60, 30:80] = False
    masked = np.ma.masked_array(bands, np.broadcast_to(~valid, bands.shape))
    bands = np.where(valid, bands, -9999)
    reports = []
    with MemoryFile() as file:
        with file.open(
            driver="GTiff",
            width=120,
            height=100,
            count=3,
            dtype="int16",
            nodata=-9999,
            crs=UTM,
            transform=NORTH_UP,
        ) as dataset:
            dataset.write(bands)
        with file.open() as dataset:
            mesh = geomesh.mesh_raster(dataset)
            reports += [mesh.psnr(dataset, model=model) for model in MODELS]
    source = (masked, NORTH_UP, UTM)
    reports += [geomesh.mesh_raster(source).psnr(source, model=model) for model in MODELS]
    assert reports[:2] == reports[2:]
    assert reports[0].pixels == mesh.metadata["pixels"]["counted"]
    assert max(reports[0].rmse) < 50  # not thousands


def test_triangles_over_nodata_say_nothing_of_the_pixels_beside(olinda):
    """The mesh covers the whole image. Some nodes have no valid pixel around them."""
    bands = mirrored(olinda, 120, 100)
    valid = np.zeros((100, 120), bool)
    valid[5:90, 7:60] = True
    source = (np.ma.masked_array(bands, np.broadcast_to(~valid, bands.shape)), NORTH_UP, UTM)
    mesh = geomesh.mesh_raster(source, domain="image")
    assert np.isnan(mesh.node_table["b1"]).any()
    for model in MODELS:
        for fit in FITS:
            found = mesh.psnr(source, model=model, fit=fit)
            assert found.pixels == valid.sum()
            assert np.isfinite(found.overall)


def test_a_mesh_of_a_part_is_compared_with_that_part(olinda, tmp_path):
    mesh = geomesh.mesh_raster(olinda, bounds=(290_000, 9_114_000, 295_000, 9_119_000), nodes=200)
    assert mesh.grid.width < 200
    window = mesh.metadata["source"]["window"]
    bands, _ = read(olinda, window=rasterio.windows.Window(*window))
    alone = (bands.astype(np.uint8), mesh.grid.transform, mesh.grid.crs)
    assert mesh.psnr(olinda).rmse == mesh.psnr(alone).rmse
    again = mesh.to_file(tmp_path / "mesh.gpkg")
    assert geomesh.read_mesh(again).psnr(olinda) == mesh.psnr(olinda)


def test_an_area_of_interest_is_kept_to(olinda, tmp_path):
    area = GeoSeries([box(290_000, 9_114_000, 295_000, 9_119_000).buffer(500)], crs=UTM)
    mesh = geomesh.mesh_raster(olinda, mask=area, nodes=300)
    found = mesh.psnr(olinda)
    assert found.pixels == mesh.metadata["pixels"]["counted"] < mesh.grid.width * mesh.grid.height
    # The same part as a separate raster: the area must move with it.
    part = tmp_path / "part.tif"
    with rasterio.open(olinda) as dataset:
        window = rasterio.windows.Window(*mesh.metadata["source"]["window"])
        profile = dataset.profile | {
            "width": window.width,
            "height": window.height,
            "transform": dataset.window_transform(window),
        }
        with rasterio.open(part, "w", **profile) as smaller:
            smaller.write(dataset.read(window=window))
            smaller.colorinterp = dataset.colorinterp
    assert mesh.psnr(part).rmse == found.rmse


def test_an_area_that_cannot_be_read_is_an_error(olinda):
    mesh = geomesh.mesh_raster(olinda, mask=box(290_000, 9_114_000, 295_000, 9_119_000), nodes=50)
    source = replace(mesh.provenance.source, area="POLYGON((0 0, 9 0, 9 9, 0 0))")
    changed = replace(mesh, provenance=replace(mesh.provenance, source=source))
    with pytest.raises(MeshFileError, match="make the mesh again"):
        changed.psnr(olinda)


def test_bands_are_those_of_the_mesh_in_their_order_or_as_asked(tmp_path):
    path = SAMPLES / "olinda_landsat7_6band_uint8.tif"
    made = geomesh.mesh_raster(path, bidx=[5, 2, 3], nodes=300)
    mesh = geomesh.read_mesh(made.to_file(tmp_path / "mesh.gpkg"))
    bands = {band["name"] for band in made.metadata["source"]["bands"]}
    names = tuple(name for name in made.node_table if name in bands)
    assert mesh.psnr(path).bands == names
    assert [band.index for band in open_original(mesh, path).bands] == [5, 2, 3]
    assert mesh.psnr(path, bidx=[5, 2, 3]) == mesh.psnr(path, fit="least_squares")
    other = mesh.psnr(path, bidx=[1])
    assert len(other.psnr) == 1
    with pytest.raises(BandError, match=r"band 5 does not exist: .*bands 5,2,3: .*`bidx`"):
        mesh.psnr(OLINDA)
    with pytest.raises(BandError, match=r"band 9 does not exist: .* has bands 1 to 6$"):
        mesh.psnr(path, bidx=[9])


def test_the_nodata_value_given_for_the_mesh_holds(olinda):
    mesh = geomesh.mesh_raster(olinda, nodata=60, nodes=300)
    found = mesh.psnr(olinda)
    bands, _ = read(olinda)
    valid = (bands != 60).all(axis=0)
    owned = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent) != FILL
    assert found.pixels == (valid & owned).sum() < valid.size


def test_palettes_are_compared_as_colours(tmp_path):
    path = tmp_path / "palette.tif"
    index = mirrored(OLINDA, 90, 80)[:1]
    profile = {"width": 90, "height": 80, "count": 1, "dtype": "uint8", "photometric": "palette"}
    with rasterio.open(path, "w", crs=UTM, transform=NORTH_UP, **profile) as dataset:
        dataset.write(index)
        dataset.write_colormap(1, {k: (k, 255 - k, k // 2, 255) for k in range(256)})
    found = geomesh.mesh_raster(path).psnr(path)
    assert found.bands == ("red", "green", "blue")
    assert found.rmse[0] == pytest.approx(found.rmse[1], rel=1e-6)


# ---------------------------------------------------------------- rasters that do not match


@pytest.mark.parametrize(
    ("width", "moved", "crs", "told"),
    [
        (
            340,
            Affine.identity(),
            UTM,
            r"349 x 352 of .* among those of the array \(340 x 352 of",
        ),
        (349, Affine.translation(0.5, 0), UTM, "are not among those of the array"),
        (349, Affine.scale(2), UTM, "of 57, -57 from"),
        (349, Affine.rotation(1), UTM, "turned by"),
        (
            349,
            Affine.identity(),
            "EPSG:32725",
            "EPSG:31985 and the array in EPSG:32725: use the raster",
        ),
        (349, Affine.identity(), None, "is in EPSG:31985 and the array in no CRS: .*`crs`"),
    ],
    ids=["smaller", "shifted", "coarser", "turned", "other CRS", "no CRS"],
)
def test_rasters_on_other_pixels_are_refused(mesh, width, moved, crs, told):
    pixels = np.zeros((mesh.grid.height, width), np.uint8)
    with pytest.raises(GeoreferenceError, match=told):
        mesh.psnr((pixels, mesh.grid.transform @ moved, crs), bidx=[1])


def test_a_crs_that_was_given_for_the_mesh_is_given_again(olinda):
    mesh = geomesh.mesh_raster(olinda, crs="EPSG:32725", nodes=200)
    with pytest.raises(GeoreferenceError, match=r"EPSG:32725 .* EPSG:31985: .* `crs`"):
        mesh.psnr(olinda)
    assert isinstance(mesh.psnr(olinda, crs="EPSG:32725"), Fidelity)


def test_a_raster_without_a_valid_pixel_in_the_mesh_is_refused(mesh):
    blank = np.ma.masked_all((mesh.grid.height, mesh.grid.width), np.uint8)
    with pytest.raises(
        EmptyError, match=r"no valid pixel of the array is in a triangle, .*; use the raster"
    ):
        mesh.psnr((blank, mesh.grid.transform, mesh.grid.crs), bidx=[1])
