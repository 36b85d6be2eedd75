"""Names of columns: made from what the file says, short, distinct and stable."""

from __future__ import annotations

import json
import unicodedata
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import rasterio.shutil
import xarray as xr
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

import geomesh
from geomesh.formats.registry import FORMATS
from geomesh.parameters import STATISTICS
from geomesh.raster.band_names import LONGEST_NAME, RESERVED, BandText, name_bands
from geomesh.raster.open import open_scene
from support.rasters import picture, write_raster
from support.samples import OLINDA

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings(
    "ignore::geomesh.errors.GeomeshWarning", "ignore::rasterio.errors.NotGeoreferencedWarning"
)

DEGREES = {"crs": "EPSG:4326", "transform": Affine(0.5, 0, 10, 0, -0.5, 60)}

# Values of the product definition template 4.0 of GRIB2: category and number of the parameter,
# four numbers of the process, the forecast in hours, and type, scale and value of the level.
GRIB_MESSAGES = {
    "tmp_2_htgl": "0 0 2 0 96 0 0 1 6 103 0 2 255 -127 -2147483647",
    "tmp_85000_isbl": "0 0 2 0 96 0 0 1 6 100 0 85000 255 -127 -2147483647",
    "tmp_50000_isbl_20200101t0600": "0 0 2 0 96 0 0 1 6 100 0 50000 255 -127 -2147483647",
    "tmp_50000_isbl_20200102": "0 0 2 0 96 0 0 1 24 100 0 50000 255 -127 -2147483647",
    "ugrd_10_htgl": "2 2 2 0 96 0 0 1 6 103 0 10 255 -127 -2147483647",
    "tcdc_sfc": "6 1 2 0 96 0 0 1 6 1 0 0 255 -127 -2147483647",
    "prmsl_msl": "3 1 2 0 96 0 0 1 6 101 0 0 255 -127 -2147483647",
    "tmp_0_1_0_4_dbll": "0 0 2 0 96 0 0 1 6 106 2 10 106 2 40",
    "param_0_0_150_sfc": "0 150 2 0 96 0 0 1 6 1 0 0 255 -127 -2147483647",
    "param_0_3_250_sfc": "3 250 2 0 96 0 0 1 6 1 0 0 255 -127 -2147483647",
    "sfc": "0 255 2 0 96 0 0 1 6 1 0 0 255 -127 -2147483647",
}


def names_of(source: Any, bidx: list[int] | None = None) -> list[str]:
    return [band.name for band in open_scene(source, bidx=bidx).bands]


def named(*descriptions: str | None) -> list[str]:
    return list(name_bands([BandText((text,) if text else ()) for text in descriptions]))


def write_grib(folder: Path, messages: list[str | None]) -> str:
    """Write a GRIB2 file with one message for each product definition, or None for none."""
    plain = write_raster(folder, data=picture(len(messages)).astype(np.float32), **DEGREES)
    start = "CENTER=7 SUBCENTER=0 MASTER_TABLE=2 SIGNF_REF_TIME=1 REF_TIME=2020-01-01T00:00:00Z"
    options: dict[str, Any] = {}
    for number, values in enumerate(messages, start=1):
        if values is not None:
            options |= {
                f"BAND_{number}_DISCIPLINE": 0,
                f"BAND_{number}_IDS": start,
                f"BAND_{number}_PDS_PDTN": 0,
                f"BAND_{number}_PDS_TEMPLATE_ASSEMBLED_VALUES": values,
            }
    rasterio.shutil.copy(plain, folder / "scene.grb2", driver="GRIB", **options)
    return str(folder / "scene.grb2")


def write_netcdf(folder: Path, **variables: tuple[tuple[str, ...], dict[str, str]]) -> str:
    """Write a NetCDF file with three days, two levels, and the given variables."""
    sizes = {"time": 3, "level": 2, "lat": 20, "lon": 30}
    coordinates = {
        "time": pd.date_range("2020-01-01T06:00", periods=3, freq="D"),
        "level": ("level", [-850.0, 500.5]),
        "lat": np.linspace(60, 50, 20),
        "lon": np.linspace(10, 25, 30),
    }
    content = {
        name: (
            (*dimensions, "lat", "lon"),
            np.zeros([sizes[each] for each in (*dimensions, "lat", "lon")], np.float32),
            attributes,
        )
        for name, (dimensions, attributes) in variables.items()
    }
    path = folder / "scene.nc"
    xr.Dataset(content, coordinates).to_netcdf(path, engine="scipy")
    return str(path)


def columns_of(names):
    """Return the columns of triangles with a mean, of a refined mesh with these bands."""
    return [f"{name}_{each}" for name in names for each in ("mean", "rmse", "max_error")]


# ---------------------------------------------------------------- descriptions


def test_descriptions_become_names():
    given_names = ["Red", None, "", "Bande (10 m)", "10m", "---", "angle", " B8A: narrow  NIR "]
    assert named(*given_names) == [
        *("red", "b2", "b3", "bande_10_m", "b_10m", "b6", "b_angle", "b8a_narrow_nir")
    ]


@pytest.mark.parametrize(
    ("description", "name"),
    [
        ("近红外", "近红外"),
        ("Température (°C)", "température_c"),
        ("Tempe\u0301rature", "température"),
        ("красный КАНАЛ", "красный_канал"),
        ("الأحمر", "الأحمر"),
        ("लाल", "लाल"),
        ("สีแดง", "สีแดง"),
        ("Ｂ１\u3000ＲＥＤ", "b1_red"),
        ("İstanbul", "i̇stanbul"),
        ("m²/s", "m2_s"),
        ("५ मीटर", "b_५_मीटर"),
        ("🌿 ndvi 🌿\ufe0f", "ndvi"),
        ("می\u200cخواهم", "میخواهم"),
        ("nir\x00\n\tred", "nir_red"),
    ],
)
def test_descriptions_keep_their_letters_in_any_script(tmp_path, description, name):
    assert named(description) == [name]
    if "\x00" not in description:
        path = write_raster(
            tmp_path, change=lambda dataset: dataset.set_band_description(1, description)
        )
        assert names_of(path) == [name]


@pytest.mark.parametrize(
    ("encoding", "names"),
    [("utf-8", ["température", "красный"]), ("cp1252", ["temp_rature", "b2"])],
)
def test_descriptions_in_an_old_encoding_keep_what_can_be_read(command, tmp_path, encoding, names):
    header = (
        "ENVI\nsamples = 64\nlines = 48\nbands = 2\ndata type = 1\ninterleave = bsq\n"
        "byte order = 0\nband names = {Température, "
    )
    text = header.encode(encoding)
    text += "красный}\n".encode("utf-8" if encoding == "utf-8" else "cp1251")
    (tmp_path / "scene.hdr").write_bytes(text)
    (tmp_path / "scene.dat").write_bytes(picture(2).tobytes())
    path = tmp_path / "scene.dat"
    assert names_of(path) == names
    with rasterio.open(path) as dataset:
        assert names_of(dataset) == names
    mesh = geomesh.mesh_raster(path, nodes=30, statistics=("mean",))
    assert list(mesh.triangle_table)[1:-1] == columns_of(names)
    mesh.render(path, tmp_path / "shown.tif")
    mesh.to_file(tmp_path / "mesh.gpkg")
    shown = json.loads(command("info", path, "--json").out)["bands"]
    assert [band["name"] for band in shown] == names


def test_units_in_an_old_encoding_stop_nothing(command, tmp_path):
    write_raster(tmp_path)
    rasterio.shutil.copy(tmp_path / "scene.tif", tmp_path / "scene.vrt", driver="VRT")
    text = (tmp_path / "scene.vrt").read_bytes()
    unit = "<UnitType>°C</UnitType>".encode("cp1252")
    (tmp_path / "scene.vrt").write_bytes(text.replace(b"<ColorInterp>", unit + b"<ColorInterp>"))
    assert "unit \ufffdC" in command("info", tmp_path / "scene.vrt").out
    mesh = geomesh.mesh_raster(tmp_path / "scene.vrt", nodes=30)
    mesh.render(tmp_path / "scene.vrt", tmp_path / "shown.tif")
    with rasterio.open(tmp_path / "shown.tif") as dataset:
        assert dataset.count == 1


def test_a_long_description_is_cut_between_words():
    text = "Surface downwelling shortwave radiation flux in the air above the canopy"
    assert named(text) == ["surface_downwelling_shortwave_radiation"]
    assert named("x" * 60) == ["x" * 40]


def test_equal_descriptions_are_told_apart_by_the_numbers_of_the_bands():
    assert named("Red", "nir", "red", "RED") == ["red_1", "nir", "red_3", "red_4"]
    assert named("x" * 60, "x" * 61) == ["x" * 38 + "_1", "x" * 38 + "_2"]
    assert named("straße", "STRASSE") == ["straße_1", "strasse_2"]
    # The number would give the name of another band.
    assert named("red", "red", "red_1", "red 2") == ["red_1_1", "red_2_2", "red_1", "red_2"]
    assert named("b2", None) == ["b2_1", "b2_2"]


def test_a_band_does_not_have_the_name_of_another_bands_statistic():
    assert named("b1_mean", None, "b1") == ["b1_mean_1", "b2", "b1"]
    assert named("ki", "map ki", "Count", "geom") == ["b_ki", "b_map_ki", "b_count", "b_geom"]


@given(st.lists(st.none() | st.text(max_size=70) | st.sampled_from(["a", "A mean", "a_2"])))
def test_any_descriptions_give_distinct_names(descriptions):
    names = named(*descriptions)
    columns = [*RESERVED, *names, *(f"{name}_{each}" for name in names for each in STATISTICS)]
    assert len({unicodedata.normalize("NFKC", each.casefold()) for each in columns}) == len(columns)
    for name in names:
        assert name.isidentifier()
        assert len(name) <= LONGEST_NAME
        assert name == name.lower() == unicodedata.normalize("NFKC", name)


def test_every_other_column_is_reserved():
    mesh = geomesh.mesh_raster(OLINDA, nodes=50)
    plain = mesh.with_measures().with_measures("map")
    bands = ("red", "green", "blue")
    others = {
        name
        for layer in ("triangles", "edges", "nodes")
        for name in plain.attributes(layer)
        if name not in bands and not name.startswith(tuple(f"{band}_" for band in bands))
    }
    # A band cannot have the name of a measure in map units, unless it is map_ki.
    assert {name for name in others if not name.startswith("map_")} <= RESERVED
    for known in FORMATS:
        assert {known.geometry, *known.reserved} <= RESERVED


# ---------------------------------------------------------------- stable


def test_names_do_not_depend_on_the_chosen_bands(tmp_path):
    texts = ["red", None, "red", "b2", "nir"]
    path = write_raster(
        tmp_path,
        data=picture(5),
        change=lambda dataset: setattr(dataset, "descriptions", texts),
    )
    every = names_of(path)
    assert every == ["red_1", "b2_2", "red_3", "b2_4", "nir"]
    for bidx in ([2], [5, 1], [3, 4, 2], [4]):
        assert names_of(path, bidx) == [every[index - 1] for index in bidx]
    mesh = geomesh.mesh_raster(path, bidx=[3, 2], statistics=("mean",), nodes=20)
    assert list(mesh.triangle_table)[1:-1] == columns_of(["red_3", "b2_2"])
    assert [band["name"] for band in mesh.metadata["source"]["bands"]] == ["red_3", "b2_2"]
    assert mesh.psnr(path).bands == ("red_3", "b2_2")


def test_bands_of_an_array_are_numbered_as_in_the_array():
    array = picture(3), Affine.identity(), None
    assert names_of(array) == ["b1", "b2", "b3"]
    assert names_of(array, [3, 1]) == ["b3", "b1"]


def test_an_alpha_band_has_a_number_too(tmp_path):
    def tag(dataset):
        colors = [rasterio.enums.ColorInterp[name] for name in ("gray", "alpha", "undefined")]
        dataset.colorinterp = colors

    path = write_raster(tmp_path, data=picture(3), change=tag)
    assert names_of(path) == ["b1", "b3"]


# ---------------------------------------------------------------- GRIB and NetCDF


def test_grib_messages_are_named_by_element_and_level(tmp_path):
    path = write_grib(tmp_path, list(GRIB_MESSAGES.values()))
    assert names_of(path) == list(GRIB_MESSAGES)
    assert names_of(path, [4, 1]) == ["tmp_50000_isbl_20200102", "tmp_2_htgl"]
    copy = tmp_path / "copy.tif"
    rasterio.shutil.copy(path, copy, driver="GTiff")
    assert names_of(copy) == list(GRIB_MESSAGES)


def test_grib_messages_that_say_nothing_are_numbered(tmp_path):
    assert names_of(write_grib(tmp_path, [None, None])) == ["b1", "b2"]


def test_netcdf_bands_are_named_by_variable_time_and_level(tmp_path):
    long = "Mean of the surface downwelling shortwave radiation flux in air"
    path = write_netcdf(
        tmp_path,
        t2m=(("time", "level"), {"long_name": "2 metre temperature"}),
        ndvi=(("time",), {}),
        rsds=(("level",), {"long_name": long, "standard_name": "x" * 36}),
        sst=((), {"standard_name": "sea_surface_temperature"}),
        tas=((), {"long_name": "Température"}),
    )
    assert names_of(f"netcdf:{path}:sst") == ["sea_surface_temperature"]
    assert names_of(f"netcdf:{path}:tas") == ["température"]
    days = ["20200101t0600", "20200102t0600", "20200103t0600"]
    assert names_of(f"netcdf:{path}:ndvi") == [f"ndvi_{day}" for day in days]
    # Neither of its longer names leaves room for the level.
    assert names_of(f"netcdf:{path}:rsds") == ["rsds_m850", "rsds_500_5"]
    levels = names_of(f"netcdf:{path}:t2m")
    assert levels == [f"t2m_{day}_{level}" for day in days for level in ("m850", "500_5")]


def test_netcdf_bands_of_another_calendar_keep_their_numbers(tmp_path):
    dates = {"units": "days since 2020-01-01", "calendar": "360_day"}
    values = np.zeros((2, 20, 30), np.float32)
    coordinates = {"lat": np.linspace(60, 50, 20), "lon": np.linspace(10, 25, 30)}
    dataset = xr.Dataset(
        {"pr": (("time", "lat", "lon"), values)}, {"time": ("time", [30.0, 59.0], dates)}
    ).assign_coords(coordinates)
    dataset.to_netcdf(tmp_path / "scene.nc", engine="scipy")
    assert names_of(str(tmp_path / "scene.nc")) == ["pr_30", "pr_59"]


def test_hdf5_arrays_are_named_by_their_path(tmp_path):
    plain = write_raster(tmp_path, data=picture(2), **DEGREES)
    path = tmp_path / "scene.nc"
    rasterio.shutil.copy(plain, path, driver="netCDF", FORMAT="NC4")
    assert names_of(f"HDF5:{path}://Band2") == ["band2"]
    assert names_of(f"netcdf:{path}:Band2") == ["band2"]


def test_envi_bands_are_named_by_wavelength(tmp_path):
    header = (
        "ENVI\nsamples = 8\nlines = 8\nbands = 2\ndata type = 1\ninterleave = bsq\n"
        "byte order = 0\nwavelength units = Micrometers\nwavelength = {0.443, 0.56}\n"
    )
    (tmp_path / "scene.hdr").write_text(header)
    (tmp_path / "scene.dat").write_bytes(picture(2, 8, 8).tobytes())
    assert names_of(str(tmp_path / "scene.dat")) == ["b_0_443_micrometers", "b_0_56_micrometers"]
    (tmp_path / "scene.hdr").write_text(header + "band names = {Band 1, Band 2}\n")
    names = names_of(str(tmp_path / "scene.dat"))
    assert names == ["band_1_0_443_micrometers", "band_2_0_56_micrometers"]


def test_sentinel_bands_are_named_by_their_short_name(tmp_path):
    """GDAL's SENTINEL2 driver gives bands this description and this tag."""

    def change(dataset):
        dataset.set_band_description(1, "B4, central wavelength 665 nm")
        dataset.update_tags(1, BANDNAME="B4", WAVELENGTH="665")

    assert names_of(write_raster(tmp_path, change=change)) == ["b4"]


# ---------------------------------------------------------------- DataArray


@pytest.mark.parametrize(
    ("labels", "attributes", "names"),
    [
        (["Near IR", "красный"], {}, ["near_ir", "красный"]),
        ([443, 665], {}, ["b443", "b665"]),
        ([0.443, 0.665], {}, ["b0_443", "b0_665"]),
        ([2, 3], {}, ["b2", "b3"]),
        (None, {}, ["b1", "b2"]),
        ([1, 2], {"long_name": ("blue", "green")}, ["blue", "green"]),
        (np.array([0.443, 0.665], np.float32), {}, ["b0_443", "b0_665"]),
        ([1577836800.0, 1577923200.0], {}, ["b1577836800", "b1577923200"]),
        ([443, 665], {"long_name": "Reflectance"}, ["reflectance_443", "reflectance_665"]),
        ([-1.5, 2], {"standard_name": "level"}, ["level_m1_5", "level_2"]),
        (
            np.array(["2020-01-01", "2020-01-02T06:30"], "datetime64[ns]"),
            {"long_name": "NDVI"},
            ["ndvi_20200101", "ndvi_20200102t0630"],
        ),
    ],
    ids=str,
)
def test_bands_of_a_dataarray_are_named_by_their_labels(labels, attributes, names):
    coordinates = {} if labels is None else {"band": labels}
    array = xr.DataArray(picture(2), coordinates, ("band", "y", "x"), attrs=attributes)
    assert names_of(array) == names
    assert names_of(array, [2]) == names[1:]
    if labels is not None:
        assert names_of(array.isel(band=[1])) == names[1:]
        assert names_of(array.isel(band=1)) == names[1:]


def test_a_dataarray_of_one_band_is_named_by_its_variable():
    array = xr.DataArray(picture()[0], dims=("y", "x"), name="ndvi")
    assert names_of(array) == ["ndvi"]
    assert names_of(array.rename("band_data")) == ["b1"]
    assert names_of(array.assign_attrs(long_name="Vegetation index")) == ["vegetation_index"]


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("extension", [".gpkg", ".geojson", ".fgb", ".parquet"])
def test_formats_keep_names_in_any_script(tmp_path, extension):
    texts = ["近红外", "Température (°C)", "красный", "الأحمر", "लाल", "x" * 50]
    path = write_raster(
        tmp_path,
        data=picture(6),
        change=lambda dataset: setattr(dataset, "descriptions", texts),
    )
    mesh = geomesh.mesh_raster(path, nodes=30)
    for layer in ("triangles", "nodes"):
        output = mesh.to_file(tmp_path / f"{layer}{extension}", layers=[layer])
        read = gpd.read_parquet if extension == ".parquet" else gpd.read_file
        frame = read(output)
        expected = mesh.attributes(layer)
        assert set(expected) <= set(frame.columns)
        for name in names_of(path):
            column = name if layer == "nodes" else f"{name}_mean"
            np.testing.assert_allclose(np.sort(frame[column]), np.sort(expected[column]), rtol=1e-6)


def test_a_mesh_that_was_written_with_other_names_keeps_them(tmp_path, monkeypatch):
    path = write_raster(tmp_path)
    monkeypatch.setattr("geomesh.raster.bands.name_bands", lambda _: ["b_0_reserved"])
    old = geomesh.mesh_raster(path, nodes=30)
    old.to_file(tmp_path / "old.gpkg")
    monkeypatch.undo()
    again = geomesh.read_mesh(tmp_path / "old.gpkg")
    assert list(again.triangle_table) == list(old.triangle_table)
    assert "b_0_reserved" in again.node_table
    assert again.psnr(path).pixels == old.psnr(path).pixels
