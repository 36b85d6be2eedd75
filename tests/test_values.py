"""What stored values mean: data types and mixtures of them, nodata, scale and offset."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
import rioxarray
import xarray
from rasterio.enums import ColorInterp
from rasterio.vrt import WarpedVRT

import geomesh
from geomesh.errors import BandError, SourceError
from geomesh.mesh.provenance import Provenance
from geomesh.raster.nodata import is_nodata, parse_nodata, stored_range, stored_value
from geomesh.raster.open import open_scene
from geomesh.surface.original import open_original
from support.rasters import COLS, FLOAT32_MIN, NORTH_UP, ROWS, SIZE, UTM, picture, write_raster
from support.reading import notes, read

if TYPE_CHECKING:
    from pathlib import Path

    from support.commands import Geomesh

REAL = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64")
REAL += ("float32", "float64")
FLOAT64_MIN = float(np.finfo(np.float64).min)

# Name of each type in a VRT.
GDAL_TYPES = {
    **{name: name.capitalize().replace("Ui", "UI") for name in REAL},
    "uint8": "Byte",
    "complex_int16": "CInt16",
    "complex64": "CFloat32",
    "complex128": "CFloat64",
}


def write_mixed(folder: Path, *bands: np.ndarray | str, nodata: Any = ()) -> str:
    """Write a VRT whose bands have different types, and return its path.

    A text is the name of a complex type; GDAL has some that numpy has not.
    """
    parts = []
    for number, band in enumerate(bands, start=1):
        dtype = band if isinstance(band, str) else band.dtype.name
        values = np.ones((ROWS, COLS), np.uint8) if isinstance(band, str) else band
        write_raster(folder, f"{number}.tif", values[None])
        marker = dict(enumerate(nodata, start=1)).get(number)
        parts.append(
            f'<VRTRasterBand dataType="{GDAL_TYPES[dtype]}" band="{number}">'
            + ("" if marker is None else f"<NoDataValue>{marker}</NoDataValue>")
            + f'<SimpleSource><SourceFilename relativeToVRT="1">{number}.tif</SourceFilename>'
            "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>"
        )
    path = folder / "mixed.vrt"
    origin = ",".join(map(str, NORTH_UP.to_gdal()))
    path.write_text(
        f'<VRTDataset rasterXSize="{COLS}" rasterYSize="{ROWS}"><SRS>{UTM}</SRS>'
        f"<GeoTransform>{origin}</GeoTransform>{''.join(parts)}</VRTDataset>"
    )
    return str(path)


# --------------------------------------------------------------------------- types


def limits(dtype: str) -> np.ndarray:
    """Return pixels with both limits of a type among them."""
    info = np.finfo(dtype) if np.dtype(dtype).kind == "f" else np.iinfo(dtype)
    values = picture()[0].astype(dtype)
    values[0, 0], values[1, 1] = info.min, info.max
    return values


@pytest.mark.parametrize("one", REAL)
@pytest.mark.parametrize("other", ["uint8", "int64", "uint64", "float32"])
def test_bands_of_any_two_types_are_read_in_a_type_that_holds_both(tmp_path, one, other):
    arrays = limits(one), limits(other)
    path = write_mixed(tmp_path, *arrays)
    bands, valid = read(path)
    assert valid.all()
    assert bands.dtype == np.result_type(one, other)
    for band, array in zip(bands, arrays, strict=True):
        np.testing.assert_array_equal(band, array.astype(bands.dtype))


def test_open_datasets_of_mixed_types_are_read_as_their_path(tmp_path):
    path = write_mixed(tmp_path, limits("uint16"), limits("float32"), limits("int8"))
    expected, _ = read(path)
    with rasterio.open(path) as dataset, WarpedVRT(dataset) as warped:
        for source in (dataset, warped):
            bands, valid = read(source)
            assert valid.all()
            np.testing.assert_array_equal(bands, expected)


def test_mixed_types_are_meshed(tmp_path):
    path = write_mixed(tmp_path, picture()[0], picture(2)[1].astype("f4"))
    mesh = geomesh.mesh_raster(path)
    assert mesh.triangle_table["count"].sum() == SIZE
    assert mesh.psnr(path).pixels == SIZE


@pytest.mark.parametrize("dtype", ["complex_int16", "complex64", "complex128"])
def test_complex_bands_are_refused_unless_others_are_chosen(tmp_path, dtype):
    path = write_mixed(tmp_path, picture()[0], dtype, picture()[0].astype("f4"))
    with rasterio.open(path) as dataset:
        for source in (path, dataset):
            with pytest.raises(
                BandError, match=f"band 2 of .* of type {dtype}: only real .*`bidx`"
            ):
                open_scene(source)
            bands, _ = read(source, bidx=[3, 1])
            np.testing.assert_array_equal(bands, [picture()[0]] * 2)


@pytest.mark.parametrize("dtype", ["complex_int16", "complex64", "complex128"])
def test_a_complex_raster_is_refused_in_one_line(tmp_path, command, dtype):
    path = tmp_path / "radar.tif"
    profile = {"driver": "GTiff", "width": 8, "height": 8, "count": 1, "dtype": dtype}
    rasterio.open(path, "w", **profile).close()
    error = command("mesh", path, "-o", tmp_path / "mesh.gpkg").error()
    assert f"values of type {dtype}: only real numbers" in error
    assert "take the magnitude or one part first" in error


# --------------------------------------------------------------------------- nodata

# Type, stored value, and how tools print it.
PRINTED = (
    ("float32", FLOAT32_MIN, "-3.40282346638529e+38"),  # gdalinfo, before GDAL 3.7
    ("float32", FLOAT32_MIN, "-3.4028234663852886e+38"),
    ("float32", FLOAT32_MIN, "-3.4028235e+38"),  # numpy
    ("float32", FLOAT32_MIN, "-3.402823e+38"),
    ("float32", FLOAT32_MIN, "-3.40282e+38"),  # %g
    ("float32", FLOAT32_MIN, "-3.4e+38"),  # R
    ("float32", -FLOAT32_MIN, "3.40282346638529e+38"),
    ("float32", -3.4028230607370965e38, "-3.40282306073710e+38"),  # ArcGIS
    ("float32", 9.969209968386869e36, "9.96921e+36"),  # netCDF
    ("float32", 1.1754943508222875e-38, "1.17549e-38"),
    ("float32", 123456.7890625, "123456.8"),
    ("float32", 0.1, "0.1"),
    ("float32", -9999, "-9999"),
    ("float32", -9999, "-9999.0"),
    ("float32", -1e32, "-1e+32"),
    ("float64", FLOAT64_MIN, "-1.79769313486232e+308"),  # beyond the limit
    ("float64", FLOAT64_MIN, "-1.7976931348623157e+308"),
    ("float64", FLOAT64_MIN, "-1.797693e+308"),
    ("float64", FLOAT64_MIN, "-1.8e+308"),
    ("float64", FLOAT32_MIN, "-3.40282346638529e+38"),
    ("float64", 9007199254740993.0, "9007199254740992"),
    ("int64", 9007199254740993, "9007199254740993"),
    ("int64", -(2**63), "-9223372036854775808"),
    ("uint64", 2**64 - 1, "18446744073709551615"),
    ("uint8", 255, "255.0"),
    ("int16", -32768, "-3.2768e4"),
)


@pytest.mark.parametrize(("dtype", "stored", "printed"), PRINTED)
def test_nodata_is_found_as_tools_print_it(tmp_path, dtype, stored, printed):
    data = picture().astype(dtype)
    data[:, :10, :10] = stored
    _, valid = read(write_raster(tmp_path, data=data), nodata=printed)
    assert not valid[:10, :10].any()
    assert valid.sum() == SIZE - 100


@pytest.mark.parametrize(("dtype", "stored", "printed"), [PRINTED[0], PRINTED[15], PRINTED[21]])
def test_nodata_given_to_the_command_keeps_its_digits(tmp_path, command, dtype, stored, printed):
    data = picture().astype(dtype)
    data[:, :10, :10] = stored
    path = write_raster(tmp_path, data=data)
    run = command("mesh", path, "-o", tmp_path / "mesh.gpkg", f"--nodata={printed}")
    assert run.code == 0, run.err
    made = geomesh.read_mesh(tmp_path / "mesh.gpkg")
    assert made.domain.valid_pixels == SIZE - 100
    # The value comes back from the file, and means the same.
    assert open_original(made, path).nodata == parse_nodata(printed)


@pytest.mark.parametrize(
    ("dtype", "nodata", "others"),
    [
        ("float32", -9999, [-9999.5, -9998.5, -9999.125, -9998.9]),
        ("float32", 0.1, [0.12, 0.1001, 0.0999]),
        ("float32", 0, [1e-40, -1e-40, 1e-38]),
        ("float32", -3.4e38, [-3.34e38, -3.3e38, 3.4e38]),
        ("float32", "-3.40282e+38", [-3.4027e38, -3.4e38]),
        ("float32", 1e36, [1.1e36, 9e35]),
        ("float32", 1e-60, [0]),
        ("float64", -9999, [-9999.0000001]),
        ("float64", 0.1, [0.10000001]),
        ("float64", math.inf, [3.4e38, 1e308]),
        ("int64", 9007199254740993, [9007199254740992, 9007199254740994]),
        ("int64", 9007199254740992.0, [9007199254740993]),
        ("uint64", 2**64 - 1, [2**64 - 2, 0]),
        ("uint8", 256, [0, 255]),
        ("uint8", -1, [255, 1]),
        ("uint8", 0.5, [0, 1]),
        ("uint8", math.nan, [0]),
    ],
)
def test_nodata_hides_no_other_value(dtype, nodata, others):
    values = np.array(others, dtype)
    assert not is_nodata(values, parse_nodata(nodata)).any()


@pytest.mark.parametrize("dtype", ["float32", "float64", "float16", "int64", "uint64", "uint8"])
@pytest.mark.parametrize("value", [0, -9999, 1e-300, -3.4e38, 255, 2**63, 1e300, math.inf, 0.1])
def test_the_stored_nodata_value_is_in_the_range_of_those_that_equal_it(dtype, value):
    dtype = np.dtype(dtype)
    found, stored = stored_range(dtype, value), stored_value(dtype, value)
    assert (found is None) == (stored is None)
    if found is not None:
        assert found[0].dtype == found[1].dtype == dtype
        assert found[0] <= found[1]
        assert is_nodata(np.array([stored, *found], dtype), value).all()
        assert is_nodata(np.array([stored], dtype), stored).all()


@pytest.mark.parametrize("value", ["none", "", [0], {}, object()])
def test_a_nodata_value_that_is_no_number_is_refused(value):
    with pytest.raises(BandError, match=r"nodata is .* give a number such as -9999"):
        open_scene((picture(), NORTH_UP, UTM), nodata=value)


@pytest.mark.parametrize(
    ("dtype", "value"), [("uint8", -9999), ("uint8", 0.5), ("float32", 1e300), ("int16", 65535)]
)
def test_a_nodata_value_that_no_band_can_have_is_said(tmp_path, dtype, value):
    path = write_raster(tmp_path, data=picture().astype(dtype))
    array = rioxarray.open_rasterio(path)
    for source in (path, (picture().astype(dtype), NORTH_UP, UTM), array):
        (told,) = notes(source, nodata=value)
        assert f"can have the nodata value {value}" in told
        assert f"of type {dtype}" in told
    assert notes(path, nodata=math.nan) == []


def test_one_of_the_bands_may_have_the_nodata_value(tmp_path):
    low = picture()[0].astype("f4")
    low[:5] = -9999
    path = write_mixed(tmp_path, picture()[0], low)
    assert notes(path, nodata=-9999) == []
    _, valid = read(path, nodata=-9999)
    np.testing.assert_array_equal(valid, low != -9999)


def test_each_band_keeps_its_own_nodata_value(tmp_path):
    data = np.repeat(picture(), 3, axis=0).clip(10, 200)
    data[0, :5], data[1, 5:10], data[2, 10:15] = 1, 2, 3
    path = write_mixed(tmp_path, data[0], data[1].astype("i8"), data[2].astype("f4"), nodata=[1, 2])
    _, valid = read(path)
    np.testing.assert_array_equal(valid, (data[0] != 1) & (data[1] != 2))
    _, valid = read(path, nodata=3)
    np.testing.assert_array_equal(valid, data[2] != 3)


@pytest.mark.parametrize(
    ("dtype", "value"),
    [("int64", 2**53 + 1), ("uint64", 2**53 + 1), ("int64", 2**63 - 1), ("uint64", 2**64 - 1)],
)
def test_the_nodata_value_of_a_file_keeps_its_last_digit(tmp_path, dtype, value):
    data = picture()[0].astype(dtype)
    data[0, :2] = value - 1, value
    path = write_mixed(tmp_path, data, nodata=[value])
    with rasterio.open(path) as dataset:
        for source in (path, dataset):
            np.testing.assert_array_equal(read(source)[1], data != value)


def test_nan_is_never_valid_whatever_the_nodata_value(tmp_path):
    data = picture().astype("f4")
    data[0, :4], data[0, 4:6], data[0, 6] = np.nan, -9999, np.inf
    for nodata, hidden in ((None, 5), (-9999, 7), (math.nan, 5), (0, 5)):
        path = write_raster(tmp_path, data=data)
        _, valid = read(path, nodata=nodata)
        assert (~valid).sum() == hidden * COLS


PNG = {"width": COLS, "height": ROWS, "count": 1, "dtype": "uint8"}


def palette_raster(folder: Path, **options: Any) -> tuple[str, np.ndarray]:
    classes = np.array([0, 10, 20, 80], "u1")[np.digitize(picture(), [60, 80, 100])]
    colors = {0: (0, 0, 0, 255), 10: (0, 100, 0, 255), 20: (255, 187, 0, 255), 80: (0, 9, 20, 255)}

    def change(dataset: Any) -> None:
        dataset.write_colormap(1, colors)

    return write_raster(folder, data=classes, change=change, **options), classes[0]


@pytest.mark.parametrize("value", [0, 10, 20, 80, 255])
@pytest.mark.parametrize("by", ["file", "user"])
def test_nodata_of_a_palette_is_a_class_not_a_colour(tmp_path, value, by):
    own, given = ({"nodata": value}, {}) if by == "file" else ({}, {"nodata": value})
    path, classes = palette_raster(tmp_path, **own)
    _, valid = read(path, **given)
    np.testing.assert_array_equal(valid, classes != value)


def test_the_colour_that_gdal_makes_transparent_for_nodata_returns_with_another_value(tmp_path):
    path, classes = palette_raster(tmp_path, nodata=10)
    with rasterio.open(path) as dataset:
        assert dataset.colormap(1)[10][3] == 0
    np.testing.assert_array_equal(read(path, nodata=20)[1], classes != 20)
    assert read(path, nodata=math.nan)[1].all()


def test_transparent_colours_hide_pixels_unless_alpha_is_data(tmp_path):
    path, classes = palette_raster(tmp_path)
    with rasterio.open(path) as dataset:
        table = dataset.colormap(1) | {20: (1, 2, 3, 0), 80: (1, 2, 3, 0)}
    path = str(tmp_path / "scene.png")
    with rasterio.open(path, "w", driver="PNG", **PNG) as dataset:
        dataset.write(classes, 1)
        dataset.write_colormap(1, table)
    for nodata in (None, 0):
        shown = (classes < 20) & (classes != nodata)
        np.testing.assert_array_equal(read(path, nodata=nodata)[1], shown)
    assert read(path, alpha="data")[1].all()


def masked_sources(folder: Path) -> dict[str, str]:
    """Rasters whose mask hides the left, and whose value 1 is in the rows above 5."""
    data = picture(3).clip(2)
    data[:, :5] = 1
    shown = np.tile(np.where(np.arange(COLS) < 20, 0, 255).astype("u1"), (ROWS, 1))

    def with_mask(dataset: Any) -> None:
        dataset.write_mask(shown)

    def with_alpha(dataset: Any) -> None:
        dataset.write(shown, 4)
        dataset.colorinterp = [*dataset.colorinterp[:3], ColorInterp.alpha]

    found = {}
    for nodata in (None, 1):
        name = "plain" if nodata is None else "nodata"
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            found[f"internal, {name}"] = write_raster(
                folder, f"in_{name}.tif", data, change=with_mask, nodata=nodata
            )
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False):
            found[f"beside, {name}"] = write_raster(
                folder, f"out_{name}.tif", data, change=with_mask, nodata=nodata
            )
        four = np.concatenate([data, data[:1]])
        found[f"alpha, {name}"] = write_raster(
            folder, f"alpha_{name}.tif", four, change=with_alpha, nodata=nodata
        )
    assert (folder / "out_plain.tif.msk").exists()
    return found


def test_a_nodata_value_replaces_neither_masks_nor_alpha(tmp_path):
    left, above = np.arange(COLS) < 20, (np.arange(ROWS) < 5)[:, None]
    for name, path in masked_sources(tmp_path).items():
        own = above if name.endswith("nodata") else np.zeros((ROWS, 1), bool)
        with rasterio.open(path) as dataset:
            for source in (path, dataset):
                np.testing.assert_array_equal(read(source)[1], ~(left | own), name)
                np.testing.assert_array_equal(read(source, nodata=1)[1], ~(left | above), name)
                none = read(source, nodata=math.nan)[1]
                np.testing.assert_array_equal(none, np.broadcast_to(~left, none.shape), name)


def test_nodata_values_of_all_bands_together_hide_a_pixel_as_gdal_does(tmp_path):
    data = picture(2).clip(5)
    data[0, :5], data[1, 3:8] = 1, 2

    def change(dataset: Any) -> None:
        dataset.update_tags(NODATA_VALUES="1 2")

    path = write_raster(tmp_path, data=data, change=change)
    with rasterio.open(path) as dataset:
        expected = dataset.dataset_mask() > 0
    assert 0 < (~expected).sum() == 2 * COLS
    np.testing.assert_array_equal(read(path)[1], expected)
    assert read(path, nodata=3)[1].all()


# --------------------------------------------------------------------------- scale and offset


def scaled_raster(folder: Path, scales: Any, offsets: Any, **options: Any) -> str:
    data = picture(len(scales)).astype("i2") * 40
    data[:, :3] = -32768

    def change(dataset: Any) -> None:
        dataset.scales, dataset.offsets = scales, offsets

    return write_raster(folder, data=data, change=change, nodata=-32768, **options)


@pytest.mark.parametrize(
    ("scales", "offsets"), [([0.0001], [-0.2]), ([2, 0.5, 1], [0, 1e6, 0]), ([0.1, 0.1], [5, 5])]
)
def test_unscale_gives_what_was_measured_of_files_and_dataarrays(tmp_path, scales, offsets):
    path = scaled_raster(tmp_path, scales, offsets)
    with rasterio.open(path) as dataset:
        stored = dataset.read(masked=True)
    measured = stored * np.reshape(scales, (-1, 1, 1)) + np.reshape(offsets, (-1, 1, 1))
    with rasterio.open(path) as dataset, WarpedVRT(dataset) as warped:
        for source in (path, dataset, warped, rioxarray.open_rasterio(path)):
            bands, valid = read(source, unscale=True)
            assert bands.dtype == np.float64
            np.testing.assert_array_equal(valid, ~stored.mask.any(axis=0))
            np.testing.assert_allclose(bands[:, valid], measured.data[:, valid], rtol=1e-12)
            bands, valid = read(source)
            assert bands.dtype == np.int16
            np.testing.assert_array_equal(bands, stored.data)


def test_files_and_dataarrays_give_the_same_statistics_and_notes(tmp_path):
    path = scaled_raster(tmp_path, [0.5, 0.25], [1, 2])
    array = rioxarray.open_rasterio(path)
    for unscale in (False, True):
        of_file = geomesh.mesh_raster(path, unscale=unscale)
        of_array = geomesh.mesh_raster(array, unscale=unscale)
        for name, column in of_file.triangle_table.items():
            np.testing.assert_array_equal(column, of_array.triangle_table[name])
    for source, name in ((path, "scene.tif"), (array, "the DataArray")):
        (told,) = notes(source)
        assert f"{name} has a scale or an offset (0.5 and 1 in band 1, 0.25 and 2" in told
        assert "stored values are used; `unscale=True` applies them" in told
        assert notes(source, unscale=True) == []


def test_the_bands_chosen_of_a_dataarray_keep_their_scale(tmp_path):
    path = scaled_raster(tmp_path, [0.5, 0.25, 4], [1, 2, 3])
    array = rioxarray.open_rasterio(path)
    expected, _ = read(path, bidx=[3, 1], unscale=True)
    np.testing.assert_array_equal(read(array, bidx=[3, 1], unscale=True)[0], expected)
    np.testing.assert_array_equal(read(array.sel(band=[3, 1]), unscale=True)[0], expected)
    np.testing.assert_array_equal(read(array.sel(band=3), unscale=True)[0], expected[:1])
    of_one = rioxarray.open_rasterio(path, band_as_variable=True).band_3
    np.testing.assert_array_equal(read(of_one, unscale=True)[0], expected[:1])


def test_a_dataarray_that_is_scaled_already_is_used_as_it_is(tmp_path):
    path = scaled_raster(tmp_path, [0.5, 0.25], [1, 2])
    array = rioxarray.open_rasterio(path, mask_and_scale=True)
    assert notes(array) == []
    for unscale in (False, True):
        bands, valid = read(array, unscale=unscale)
        np.testing.assert_array_equal(bands, array.values)
        expected, known = read(path, unscale=True)
        np.testing.assert_array_equal(valid, known)
        np.testing.assert_allclose(bands[:, valid], expected[:, valid], rtol=1e-6)


def test_packed_values_of_netcdf_are_scaled(tmp_path):
    packed = xarray.DataArray(picture()[0].astype("i2"), dims=("y", "x"), name="t2m")
    packed.attrs = {"scale_factor": 0.01, "add_offset": 273.15, "_FillValue": np.int16(1)}
    bands, _ = read(packed.rio.write_transform(NORTH_UP).rio.write_crs(UTM), unscale=True)
    np.testing.assert_allclose(bands, picture() * 0.01 + 273.15)
    path = tmp_path / "t2m.nc"
    packed.to_netcdf(path)
    for opened, scaled in ((True, False), (False, True)):
        with xarray.open_dataset(path, mask_and_scale=opened) as dataset:
            raster = dataset.t2m.rio.write_transform(NORTH_UP).rio.write_crs(UTM)
            bands, valid = read(raster, unscale=scaled)
        assert valid.sum() == (picture() != 1).sum()
        np.testing.assert_allclose(bands[:, valid], (picture() * 0.01 + 273.15)[:, valid])


def test_bands_without_numbers_have_the_scales_of_their_positions():
    array = xarray.DataArray(picture(2).astype("i2"), dims=("band", "y", "x"))
    array.attrs = {"scales": (2, 3), "offsets": (1, 0)}
    array = array.rio.write_transform(NORTH_UP).rio.write_crs(UTM)
    bands, _ = read(array, unscale=True)
    np.testing.assert_array_equal(bands, picture(2) * [[[2.0]], [[3.0]]] + [[[1]], [[0]]])


def test_a_scale_of_a_dataarray_that_is_no_number_is_refused():
    array = xarray.DataArray(picture()[0], dims=("y", "x"), attrs={"scale_factor": "a tenth"})
    with pytest.raises(SourceError, match=r"invalid scale or offset .* scale_factor and scales"):
        open_scene(array.rio.write_transform(NORTH_UP).rio.write_crs(UTM))


@pytest.mark.parametrize(("scale", "offset"), [(0, 0), (np.nan, 0), (1, np.nan), (np.inf, 0)])
def test_a_scale_that_cannot_be_applied_is_refused(tmp_path, scale, offset):
    path = scaled_raster(tmp_path, [1, scale], [0, offset])
    (told,) = notes(path)
    assert told.endswith("in band 2), but the stored values are used")
    with pytest.raises(
        BandError, match=r"in band 2\) that cannot be applied: leave `unscale=True`"
    ):
        open_scene(path, unscale=True)
    assert notes(path, bidx=[1], unscale=True) == []


def test_unscale_changes_nothing_where_there_is_no_scale(tmp_path):
    path = write_raster(tmp_path)
    bands, _ = read(path, unscale=True)
    assert bands.dtype == np.uint8
    path, _ = palette_raster(tmp_path)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales = (2,)
    assert notes(path) == notes(path, unscale=True) == []
    np.testing.assert_array_equal(read(path)[0], read(path, unscale=True)[0])


@pytest.mark.parametrize("value", [3e38, -3e38])
def test_values_that_scaling_takes_beyond_float64_are_not_valid(tmp_path, value):
    data = picture().astype("f8")
    data[:, :2] = value

    def change(dataset: Any) -> None:
        dataset.scales = (1e300,)

    path = write_raster(tmp_path, data=data, change=change)
    _, valid = read(path, unscale=True)
    assert (~valid).sum() == 2 * COLS


def test_nodata_is_a_stored_value_also_where_values_are_scaled(tmp_path):
    path = scaled_raster(tmp_path, [0.5], [100])
    _, valid = read(path, unscale=True, nodata=80)
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(valid, dataset.read(1) != 80)


def test_a_mesh_of_scaled_values_is_compared_and_painted_with_scaled_values(tmp_path, command):
    path, out = scaled_raster(tmp_path, [0.5, 0.25], [100, 200]), tmp_path / "mesh.gpkg"
    assert command("mesh", path, "-o", out, "--unscale").code == 0
    mesh = geomesh.read_mesh(out)
    assert mesh.provenance is not None
    assert mesh.provenance.source.unscale
    means = np.stack([mesh.triangle_table[f"b{k}_mean"] for k in (1, 2)])
    assert means.min() >= 100
    painted = tmp_path / "painted.tif"
    fidelity = mesh.render(path, painted)
    assert fidelity == mesh.psnr(path)
    with rasterio.open(painted) as dataset, rasterio.open(path) as source:
        assert dataset.dtypes == ("float64", "float64")
        assert (dataset.scales, dataset.offsets) == ((1, 1), (0, 0))
        pixels = dataset.read(masked=True)
        true = source.read(masked=True) * np.array([[[0.5]], [[0.25]]]) + [[[100]], [[200]]]
    both = ~pixels.mask & ~true.mask
    assert np.abs(pixels - true)[both].mean() < 0.1 * np.ptp(true[both])


def test_provenance_of_older_meshes_is_read(olinda):
    made = geomesh.mesh_raster(olinda, nodes=300, nodata=0).provenance
    assert made is not None
    document = made.to_dict()
    assert Provenance.from_dict(document) == made
    del document["source"]["alpha"], document["source"]["unscale"]
    document["source"]["nodata"] = "0.0"
    assert Provenance.from_dict(document) == made


def test_the_command_says_how_to_scale(tmp_path, command: Geomesh):
    path = scaled_raster(tmp_path, [0.5], [100])
    run = command("mesh", path, "-o", tmp_path / "mesh.gpkg")
    assert any("--unscale applies them" in text for text in run.warnings())
    run = command("mesh", path, "-o", tmp_path / "scaled.gpkg", "--unscale")
    assert not any("scale" in text for text in run.warnings())
    facts = command("info", path).out
    assert "scale 0.5, offset 100" in facts
    assert "nodata -32768, scale" in facts
    assert "--unscale applies them" in facts
