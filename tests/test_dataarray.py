"""The mesh of a DataArray is that of its file: same nodes, triangles and statistics."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context

import dask.array
import numpy as np
import pytest
import rasterio
import rioxarray
import xarray as xr
from affine import Affine
from rasterio.control import GroundControlPoint

import geomesh
from geomesh.errors import (
    BandError,
    GeomeshError,
    GeoreferenceError,
    MissingExtraError,
    SourceError,
)
from geomesh.raster.open import open_scene
from support.samples import OLINDA, ROTATED, SAMPLES, fingerprint, mirrored

pytestmark = [
    pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning"),
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),  # rioxarray's and rasterio's
]


@cache
def arrays_of_file(path):
    return arrays_of(path)


def arrays_of(source, **options):
    """Return the fingerprint without the metadata, because they name the source."""
    return {
        name: value
        for name, value in fingerprint(geomesh.mesh_raster(source, nodes=400, **options)).items()
        if name != "metadata"
    }


def grid_array(values=None, x=None, y=None, crs="EPSG:31985", **coords):
    """Make a DataArray (y, x). Default: 12 x 8 pixels of 30 m with descending y."""
    values = np.arange(96.0).reshape(8, 12) ** 2 % 61 if values is None else values
    height, width = values.shape[-2:]
    x = 500_015.0 + 30 * np.arange(width) if x is None else x
    y = 9_000_000.0 - 30 * np.arange(height) if y is None else y
    array = xr.DataArray(values, dims=("y", "x"), coords={"x": x, "y": y, **coords})
    return array if crs is None else array.rio.write_crs(crs)


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [None, {"x": 200, "y": 150}], ids=["of a file", "of Dask"])
def test_a_lazy_dataarray_gives_the_mesh_of_its_file(sample, chunks):
    assert arrays_of(rioxarray.open_rasterio(sample, chunks=chunks)) == arrays_of_file(sample)


@pytest.mark.parametrize("path", [OLINDA, ROTATED])
@pytest.mark.parametrize("order", [("band", "y", "x"), ("x", "y", "band")])
def test_dimensions_may_come_in_any_order(path, order):
    array = rioxarray.open_rasterio(path).load().transpose(*order)
    assert arrays_of(array) == arrays_of_file(path)


def test_a_masked_dataarray_has_the_validity_and_the_statistics_of_its_file(sample):
    array = rioxarray.open_rasterio(sample, masked=True)
    # Refinement counts bands of bytes as they are, but other bands by their spread.
    is_byte = array.encoding["rasterio_dtype"] == "uint8"
    options = {"preset": "features"} if is_byte else {}
    masked = arrays_of(array, **options)
    of_file = arrays_of(sample, **options) if is_byte else arrays_of_file(sample)
    differing = {name for name, value in of_file.items() if masked[name] != value}
    # Colours of bytes are not changed. Masked data are float, so they are stretched.
    assert differing <= {"triangles.color"}


@pytest.mark.parametrize("name", [OLINDA.name, "parana_landsat8_rgb_uint16_nodata_edge.tif"])
def test_rows_may_run_north(name, tmp_path):
    array = rioxarray.open_rasterio(SAMPLES / name)
    north = array.sortby("y")
    with rasterio.open(SAMPLES / name) as dataset:
        profile, bands = dataset.profile, dataset.read()
        a, b, c, d, e, f = dataset.transform[:6]
        descriptions = dataset.descriptions
    profile |= {"transform": Affine(a, b, c, d, -e, f + e * dataset.height)}
    with rasterio.open(tmp_path / "north.tif", "w", **profile) as dataset:
        dataset.write(bands[:, ::-1])
        dataset.descriptions = descriptions
    mesh, turned = (geomesh.mesh_raster(source, nodes=400) for source in (array, north))
    same = geomesh.mesh_raster(tmp_path / "north.tif", nodes=400)
    assert not turned.grid.flips
    assert (turned.nodes == same.nodes).all()
    assert (turned.triangles == same.triangles).all()
    np.testing.assert_allclose(turned.map_nodes, same.map_nodes, atol=1e-6)
    assert turned.grid.bounds() == pytest.approx(mesh.grid.bounds(), abs=1e-6)
    assert turned.certify().passed


def test_columns_may_run_west():
    array = rioxarray.open_rasterio(OLINDA).sortby("x", ascending=False)
    mesh = geomesh.mesh_raster(array, nodes=400)
    assert not mesh.grid.flips
    assert mesh.grid.bounds() == pytest.approx(open_scene(OLINDA).grid.bounds(), abs=1e-6)


@pytest.mark.parametrize("path", [OLINDA, ROTATED])
def test_a_part_lies_where_it_was_cut_out(path):
    part = rioxarray.open_rasterio(path).isel(x=slice(40, 190), y=slice(30, 160))
    with rasterio.open(path) as dataset:
        window = rasterio.windows.Window(40, 30, 150, 130)
        expected = dataset.window_transform(window)
        values = dataset.read(window=window)
    scene = open_scene(part)
    assert scene.grid.transform.almost_equals(expected, precision=1e-6)
    assert (scene.read(scene.grid.extent)[0] == values).all()


def test_every_other_pixel_is_a_raster_of_larger_pixels():
    scene = open_scene(rioxarray.open_rasterio(OLINDA).isel(x=slice(None, None, 2)))
    assert scene.grid.transform.a == pytest.approx(57, abs=1e-6)
    # The centre of the first pixel does not move.
    assert scene.grid.transform.c == pytest.approx(288776.25 - 28.5 / 2, abs=1e-3)


def test_bands_keep_their_names_whichever_are_chosen():
    array = rioxarray.open_rasterio(OLINDA)

    def names(source):
        return [band.description for band in open_scene(source).bands]

    assert names(array) == ["red", "green", "blue"]
    assert names(array.sel(band=[3, 1])) == ["blue", "red"]
    assert names(array.sel(band=2)) == ["green"]
    assert names(array.assign_coords(band=["a", "b", "c"])) == ["a", "b", "c"]
    assert names(array.assign_coords(band=[0, 1, 2])) == [None] * 3
    assert names(array.assign_coords(band=[0.5, 0.6, 0.7])) == [None] * 3
    assert names(grid_array().assign_attrs(long_name="height")) == ["height"]
    assert names(grid_array()) == [None]


def test_chosen_bands_are_counted_in_the_dataarray():
    array = rioxarray.open_rasterio(OLINDA).sel(band=[3, 1])
    scene = open_scene(array, bidx=[2])
    assert scene.bands[0].description == "red"
    assert (scene.read(scene.grid.extent)[0][0] == array.sel(band=1).values).all()


def test_variables_of_a_dataset_are_bands():
    array = rioxarray.open_rasterio(OLINDA)
    stacked = xr.Dataset(
        {"r": array.sel(band=1, drop=True), "g": array.sel(band=2, drop=True)}
    ).to_dataarray()
    scene = open_scene(stacked)
    assert [band.description for band in scene.bands] == ["r", "g"]
    assert scene.grid.crs.to_epsg() == 31985


@pytest.mark.parametrize("names", [("longitude", "latitude"), ("lon", "lat"), ("easting", "row")])
def test_spatial_dimensions_have_the_names_that_rioxarray_knows(names):
    array = rioxarray.open_rasterio(OLINDA).rename(x=names[0], y=names[1])
    for name, axis in zip(names, "XY", strict=True):
        array[name].attrs["axis"] = axis
    assert open_scene(array).grid == open_scene(OLINDA).grid


def test_the_callers_nodata_and_crs_take_the_place_of_its_own():
    array = grid_array().rio.write_nodata(4.0)
    own, given = open_scene(array), open_scene(array, nodata=9, crs="EPSG:32722")
    values = array.values[None]
    assert (own.read(own.grid.extent)[1] == (values[0] != 4)).all()
    assert (given.read(own.grid.extent)[1] == (values[0] != 9)).all()
    assert given.grid.crs.to_epsg() == 32722
    unclear = array.drop_vars("spatial_ref").assign_attrs(crs="EPSG:999999")
    assert open_scene(unclear, crs="EPSG:32722").grid.crs.to_epsg() == 32722


def test_a_nodata_value_that_no_pixel_can_have_hides_none():
    array = grid_array(np.arange(96, dtype=np.uint8).reshape(8, 12)).assign_attrs(_FillValue=-9999)
    scene = open_scene(array)
    assert scene.read(scene.grid.extent)[1].all()


def test_a_lazy_dataarray_can_be_cropped_as_its_file():
    bounds = (290_000, 9_112_000, 295_000, 9_118_000)
    array = rioxarray.open_rasterio(OLINDA, chunks={"x": 100, "y": 90})
    assert arrays_of(array, bounds=bounds) == arrays_of(OLINDA, bounds=bounds)


def test_coordinates_in_single_precision_are_evenly_spaced():
    y = (9_000_000.0 - 30 * np.arange(200)).astype(np.float32)
    x = (-60.125 + 0.0083333 * np.arange(300)).astype(np.float32)
    values = np.arange(60_000.0).reshape(200, 300)
    scene = open_scene(grid_array(values, y=y))
    assert scene.grid.transform.e == pytest.approx(-30, rel=1e-3)
    assert open_scene(grid_array(values, x=x)).grid.transform.a == pytest.approx(
        0.0083333, rel=1e-4
    )


def test_ground_control_points_place_it_as_they_place_the_file(tmp_path):
    with rasterio.open(OLINDA) as dataset:
        profile, bands = dataset.profile, dataset.read()
        corners = [(0, 0), (0, 256), (256, 0), (200, 120)]
        gcps = [GroundControlPoint(r, c, *(dataset.transform @ (c, r))) for r, c in corners]
        crs = dataset.crs
    for name in ("transform", "crs"):
        del profile[name]
    with rasterio.open(tmp_path / "gcps.tif", "w", **profile) as dataset:
        dataset.write(bands)
        dataset.gcps = gcps, crs
    by_path, by_array = (
        open_scene(source)
        for source in (tmp_path / "gcps.tif", rioxarray.open_rasterio(tmp_path / "gcps.tif"))
    )
    assert by_array.grid == by_path.grid
    assert "4 ground control points" in by_array.notes[0]


def test_without_a_crs_it_is_as_a_raster_without_one():
    placed = open_scene(grid_array(crs=None))
    assert placed.grid.crs is None
    assert placed.grid.transform == Affine(30, 0, 500_000, 0, -30, 9_000_015)
    assert placed.notes == ("the DataArray has no CRS, so the mesh has no CRS either",)
    bare = open_scene(xr.DataArray(np.eye(8), dims=("y", "x"), name="slope"))
    assert bare.grid.transform == Affine.identity()
    assert bare.notes == (
        "slope has no georeference; the mesh is in pixel coordinates, without a CRS",
    )


@pytest.mark.slow
def test_dask_computes_no_more_than_a_window_at_a_time():
    largest = []

    def block(block_info=None):
        (rows, cols) = block_info[None]["array-location"]
        largest.append((rows[1] - rows[0]) * (cols[1] - cols[0]))
        image = mirrored(OLINDA, 3000, 2600)[0]
        return image[rows[0] : rows[1], cols[0] : cols[1]]

    lazy = dask.array.map_blocks(
        block, chunks=((520,) * 5, (500,) * 6), dtype=np.uint8, meta=np.empty((0, 0), np.uint8)
    )
    whole = mirrored(OLINDA, 3000, 2600)[0]
    transform = Affine(30, 0, 0, 0, -30, 0)
    scene = open_scene(
        xr.DataArray(lazy, dims=("y", "x")).rio.write_crs(31985).rio.write_transform(transform)
    )
    largest.clear()
    from geomesh.raster.grid import Window

    bands, _ = scene.read(Window(900, 700, 1152, 1152))
    assert (bands[0] == whole[700:1852, 900:2052]).all()
    assert len(largest) == 3 * 4
    thin, _ = scene.read(Window(0, 0, 3000, 2600), (1300, 1500))
    assert (thin[0] == whole[1::2, 1::2]).all()


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [None, {"x": 100, "y": 90}])
def test_other_processes_get_the_pixels(chunks):
    array = rioxarray.open_rasterio(OLINDA, chunks=chunks)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        assert arrays_of(array, executor=executor) == arrays_of_file(OLINDA)


UNEVEN = np.array([0, 30, 60, 91, 120, 150, 180, 210.0])
REFUSED = {
    "time": (
        lambda: grid_array().expand_dims(time=3),
        SourceError,
        r"another dimension, time, of size 3: choose one index with \.isel\(time=0\), "
        r"or \.rename\(time='band'\)",
    ),
    "time and bands": (
        lambda: grid_array().expand_dims(band=[1]).expand_dims(time=3),
        SourceError,
        r"another dimension, time, of size 3: choose one index with \.isel\(time=0\)$",
    ),
    "two dimensions of bands": (
        lambda: grid_array().expand_dims(band=[1]).expand_dims(variable=["a", "b"]),
        SourceError,
        "choose one index with",
    ),
    "no x and y": (
        lambda: xr.DataArray(np.eye(8), dims=("lat", "lon")),
        SourceError,
        r"no dimensions x and y \(its dimensions: lat, lon\); rename them, as in \.rename",
    ),
    "a number": (lambda: xr.DataArray(5.0), SourceError, r"\(its dimensions: none\); rename them"),
    "a dataset": (
        lambda: xr.Dataset({"red": grid_array()}),
        SourceError,
        r"choose a variable, .* or stack the variables of one grid as bands with "
        r"\.to_dataarray\(\)",
    ),
    "no pixels": (lambda: grid_array().isel(x=slice(0, 0)), SourceError, r"shape \(8, 0\)"),
    "uneven y": (
        lambda: grid_array(y=UNEVEN),
        GeoreferenceError,
        "y coordinates that are not evenly spaced, by up to 0.033 pixels: resample it to a regular",
    ),
    "uneven x": (
        lambda: grid_array(x=np.geomspace(1, 2, 12)),
        GeoreferenceError,
        "x coordinates that are not evenly spaced",
    ),
    "a gap in x": (
        lambda: grid_array().isel(x=[0, 1, 2, 5, 6, 7]),
        GeoreferenceError,
        "x coordinates that are not evenly spaced",
    ),
    "nan in x": (
        lambda: grid_array(x=np.full(12, np.nan)),
        GeoreferenceError,
        "x coordinates that are not evenly spaced",
    ),
    "all of one x": (
        lambda: grid_array(x=np.full(12, 7.0)),
        GeoreferenceError,
        "maps every pixel onto a line",
    ),
    "turned, with a gap": (
        lambda: rioxarray.open_rasterio(ROTATED).isel(x=[0, 1, 5, 6]),
        GeoreferenceError,
        "not evenly spaced",
    ),
    "texts as coordinates": (
        lambda: grid_array(x=list("abcdefghijkl")),
        GeoreferenceError,
        "x coordinates of type <U1: give numbers",
    ),
    "one pixel wide": (
        lambda: grid_array().isel(x=[3]),
        GeoreferenceError,
        r"only one pixel wide, .* set it with \.rio\.write_transform\(transform\)",
    ),
    "one pixel high": (lambda: grid_array().isel(y=[3]), GeoreferenceError, "one pixel high"),
    "an unknown crs": (
        lambda: grid_array(crs=None).assign_attrs(crs="EPSG:999999"),
        GeoreferenceError,
        "has an invalid CRS .* give another, crs='EPSG:32722'",
    ),
    "an odd nodata value": (
        lambda: grid_array().assign_attrs(_FillValue="none"),
        SourceError,
        r"has an invalid nodata value .* \.rio\.write_nodata\(\)",
    ),
    "truths": (lambda: grid_array() > 5, BandError, "of type bool: .* convert them first"),
    "texts": (lambda: grid_array().astype(str), BandError, "of type <U"),
    "dates": (
        lambda: grid_array().astype("datetime64[ns]"),
        BandError,
        "datetime64.*convert them first",
    ),
    "complex numbers": (lambda: grid_array() * 1j, BandError, "take the magnitude or one part"),
}


@pytest.mark.filterwarnings("ignore:Converting non-nanosecond")
@pytest.mark.parametrize(("make", "error", "told"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_raster_is_refused_in_one_line(make, error, told):
    with pytest.raises(error, match=told) as refusal:
        geomesh.mesh_raster(make())
    assert isinstance(refusal.value, GeomeshError)
    assert len(str(refusal.value).splitlines()) == 1


def test_one_pixel_wide_is_enough_with_a_transform():
    array = grid_array().isel(x=[3])
    transform = Affine(30, 0, 500_090, 0, -30, 9_000_015)
    assert open_scene(array.rio.write_transform(transform)).grid.transform == transform


def test_rioxarray_missing_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "rioxarray", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'geomesh-toolkit\[xarray\]'"):
        geomesh.mesh_raster(grid_array())


def test_a_path_needs_no_xarray():
    code = (
        "import sys, geomesh; geomesh.mesh_raster(sys.argv[1], nodes=50); "
        "sys.exit('xarray' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(OLINDA)], check=True)
