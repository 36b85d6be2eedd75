"""CRSs of every kind: read, passed between PROJ databases, kept by each format."""

from __future__ import annotations

import math
import re
import sqlite3
from typing import TYPE_CHECKING, Any

import numpy as np
import pyproj.database
import pytest
import rasterio.crs
import xugrid
from affine import Affine
from pyproj import CRS, Geod, Transformer
from pyproj.exceptions import ProjError
from scipy.io import netcdf_file

import geomesh
from geomesh.errors import GeoreferenceError
from geomesh.formats.crs_text import portable_wkt, wkt1_or_wkt2
from geomesh.io.render import render_file
from geomesh.io.write import write_mesh
from geomesh.raster.crs import (
    LONLAT,
    crs_label,
    has_angles,
    is_lonlat,
    is_on_earth,
    same_crs,
    to_pyproj,
)
from geomesh.raster.grid import Grid
from geomesh.raster.open import open_scene
from geomesh.surface.fidelity import measure_fidelity
from support.files import read_layer
from support.meshes import random_mesh
from support.rasters import MARS, picture, write_raster

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pyproj.aoi import AreaOfUse

    from support.commands import Geomesh


def rotated_pole(
    latitude: float = 39.25, longitude: float = -162.0, turn: float = 0.0, **ellipsoid: float
) -> CRS:
    return CRS.from_cf(
        {
            "grid_mapping_name": "rotated_latitude_longitude",
            "grid_north_pole_latitude": latitude,
            "grid_north_pole_longitude": longitude,
            "north_pole_grid_longitude": turn,
            **(ellipsoid or {"earth_radius": 6371000.0}),
        }
    )


# Uzbekistan 2024: of the databases of 2025, which rasterio and pyogrio bring and pyproj does not.
NEW_CODE = 10726
SHIFT = (-84, -97, -117)
SHIFTED_WKT = re.sub(
    r'(,AUTHORITY\["EPSG","6230"\]\])',
    f",TOWGS84[{SHIFT[0]},{SHIFT[1]},{SHIFT[2]},0,0,0,0]\\1",
    CRS(23032).to_wkt("WKT1_GDAL"),
    count=1,
)
SHIFTED_TEXT = "+proj=utm +zone=32 +ellps=intl +towgs84=-84,-97,-117 +units=m +type=crs"
SITE = (
    'ENGCRS["building site",EDATUM["peg"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
    'LENGTHUNIT["metre",1]]'
)
KINDS = {
    "WGS 84": CRS(4326),
    "CRS84": CRS(LONLAT),
    "three axes": CRS(4979),
    "with heights": CRS("EPSG:4326+5773"),
    "grads from Paris": CRS(4807),
    "longitudes, own shift": CRS("+proj=longlat +ellps=intl +towgs84=-87,-98,-121 +type=crs"),
    "UTM": CRS(32633),
    "UTM with heights": CRS("EPSG:32633+5773"),
    "UTM in space": CRS(32633).to_3d(),
    "northing first": CRS(31467),
    "westing and southing": CRS(2053),
    "US feet": CRS(2263),
    "without a code": CRS("+proj=laea +lat_0=45 +lon_0=10 +type=crs"),
    "of ESRI": CRS("ESRI:102008"),
    "newer code": to_pyproj(NEW_CODE),
    "own shift": CRS(SHIFTED_TEXT),
    "code and own shift": CRS.from_wkt(SHIFTED_WKT),
    "rotated pole": rotated_pole(),
    "rotated by PROJ": CRS("+proj=ob_tran +o_proj=longlat +o_lat_p=30 +lon_0=10 +type=crs"),
    "Mars": CRS(MARS),
    "Mars, projected": CRS("+proj=eqc +a=3396190 +b=3396190 +type=crs"),
    "building site": CRS.from_wkt(SITE),
    "local": CRS('LOCAL_CS["local",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'),
}
LONLAT_KINDS = {
    "WGS 84",
    "CRS84",
    "three axes",
    "with heights",
    "grads from Paris",
    "longitudes, own shift",
}
ANGLES = LONLAT_KINDS | {"rotated pole", "rotated by PROJ", "Mars"}
NOT_EARTH = {"Mars", "Mars, projected", "building site", "local"}
each_kind = pytest.mark.parametrize("kind", KINDS)


def grid_in(kind: str) -> Grid:
    crs = KINDS[kind]
    if has_angles(crs):
        return Grid(50, 40, Affine(0.01, 0, 10, 0, -0.01, 50), crs)
    return Grid(50, 40, Affine(100, 0, 500_000, 0, -100, 5_000_000), crs)


# What a CRS says of its coordinates


@each_kind
def test_only_longitude_and_latitude_on_earth_are_taken_for_them(kind: str) -> None:
    assert is_lonlat(KINDS[kind]) == (kind in LONLAT_KINDS)
    assert has_angles(KINDS[kind]) == (kind in ANGLES)
    assert is_on_earth(KINDS[kind]) == (kind not in NOT_EARTH)


def test_without_a_crs_nothing_is_longitude_and_latitude() -> None:
    assert not is_lonlat(None)


@pytest.mark.parametrize("code", [4978, 5773])
@pytest.mark.parametrize("given", [True, False], ids=["given", "own"])
def test_what_is_no_map_is_refused_and_the_advice_works(code: int, given: bool) -> None:
    array, transform = picture(), Affine(30, 0, 5e5, 0, -30, 5e6)
    own, options = (None, {"crs": code}) if given else (CRS(code), {})
    with pytest.raises(GeoreferenceError, match=r"no place on a map: give .* with `crs`$"):
        open_scene((array, transform, own), **options)
    assert open_scene((array, transform, own), crs=32633).grid.crs == CRS(32633)


# From one PROJ database to another


def test_a_code_unknown_to_pyproj_is_read_by_its_definition(tmp_path: Path) -> None:
    path = write_raster(tmp_path, crs=f"EPSG:{NEW_CODE}")
    expected = CRS.from_wkt(rasterio.crs.CRS.from_epsg(NEW_CODE).to_wkt(version="WKT2_2019"))
    for crs in (open_scene(path).grid.crs, to_pyproj(f"EPSG:{NEW_CODE}"), to_pyproj(NEW_CODE)):
        assert crs is not None
        assert crs.equals(expected)
        assert crs_label(crs) == f"EPSG:{NEW_CODE}"
    other = write_raster(tmp_path, "other.tif")
    assert same_crs(open_scene(other, crs=NEW_CODE).grid.crs, expected)


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(3067, id="another realization of ETRS89"),
        pytest.param(4194, id="a renamed datum, which has a shift"),
        pytest.param(4747, id="an ensemble by now"),
        pytest.param(31467, id="northing first"),
        pytest.param(2053, id="westing and southing"),
        pytest.param(32633, id="the same in both"),
    ],
)
def test_a_code_that_means_the_same_is_kept(code: int) -> None:
    assert to_pyproj(rasterio.crs.CRS.from_epsg(code)) == CRS.from_epsg(code)


def test_a_code_found_by_the_names_in_wkt_is_used() -> None:
    esri = rasterio.crs.CRS.from_wkt(CRS(32633).to_wkt("WKT1_ESRI"))
    assert to_pyproj(esri) == CRS(32633)


def test_a_code_that_does_not_fit_the_definition_is_not_believed() -> None:
    wkt = CRS(32633).to_wkt("WKT1_GDAL").replace('"central_meridian",15', '"central_meridian",16')
    assert 'AUTHORITY["EPSG","32633"]]' in wkt
    found = to_pyproj(rasterio.crs.CRS.from_wkt(wkt))
    assert found is not None
    assert found.to_cf()["longitude_of_central_meridian"] == 16


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        'ENGCRS["Undefined Cartesian SRS with unknown unit",EDATUM["Unknown"],CS[Cartesian,2],'
        'AXIS["x",unspecified],AXIS["y",unspecified],LENGTHUNIT["unknown",0]]',
    ],
    ids=["none", "empty", "GeoPackage's undefined"],
)
def test_no_crs_is_none(text: str | None) -> None:
    assert to_pyproj(text) is None
    assert crs_label(to_pyproj(text)) == "no CRS"


@pytest.mark.parametrize("text", ["EPSG:99999", "nonsense", "", 99999])
def test_an_unknown_crs_is_refused_in_one_line_and_nothing_is_printed(
    text: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(GeoreferenceError, match=r"is unknown .*; give a code such as EPSG:32722"):
        open_scene((picture(), Affine(30, 0, 5e5, 0, -30, 5e6), None), crs=text)
    assert capfd.readouterr() == ("", "")


def test_crss_are_the_same_whatever_their_axis_order_and_text() -> None:
    assert same_crs(CRS(4326), CRS(LONLAT))
    assert same_crs(CRS(32633), CRS.from_wkt(CRS(32633).to_wkt("WKT1_ESRI")))
    assert same_crs(None, None)
    assert not same_crs(CRS(32633), CRS(32634))
    assert not same_crs(CRS(32633), None)
    assert not same_crs(CRS(23032), CRS.from_wkt(SHIFTED_WKT))
    assert not same_crs(CRS(4326), CRS(MARS))


def test_the_original_of_a_mesh_is_found_by_another_text_of_its_crs(tmp_path: Path) -> None:
    path = write_raster(tmp_path, crs="EPSG:3067")
    mesh = geomesh.mesh_raster(path, nodes=50)
    texts = [rasterio.crs.CRS.from_epsg(3067).to_wkt(version="WKT2_2019"), "EPSG:3067+3900", 3067]
    errors = {measure_fidelity(mesh, path, crs=text).psnr for text in texts}
    assert len(errors) == 1
    with pytest.raises(GeoreferenceError, match=r"the mesh is in EPSG:3067 and .* in EPSG:32635"):
        measure_fidelity(mesh, path, crs=32635)


# A datum shift of the file's own


def in_geotiff(folder: Path) -> str:
    return write_raster(folder, crs=rasterio.crs.CRS.from_wkt(SHIFTED_WKT))


def in_geotiff_without_code(folder: Path) -> str:
    return write_raster(folder, crs=rasterio.crs.CRS.from_string(SHIFTED_TEXT))


def in_vrt(folder: Path) -> str:
    path = folder / "scene.vrt"
    source = write_raster(folder, crs=None)
    path.write_text(
        f'<VRTDataset rasterXSize="64" rasterYSize="48"><SRS>{SHIFTED_WKT}</SRS>'
        "<GeoTransform>288000,30,0,9120000,0,-30</GeoTransform>"
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        f"<SourceFilename>{source}</SourceFilename><SourceBand>1</SourceBand>"
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return str(path)


def in_side_file(folder: Path) -> str:
    path = write_raster(folder, crs=None)
    (folder / "scene.tif.aux.xml").write_text(f"<PAMDataset><SRS>{SHIFTED_WKT}</SRS></PAMDataset>")
    return path


def in_prj(folder: Path) -> str:
    path = folder / "scene.asc"
    rows = "\n".join(" ".join(map(str, row)) for row in picture()[0])
    path.write_text(
        f"ncols 64\nnrows 48\nxllcorner 288000\nyllcorner 5120000\ncellsize 30\n{rows}\n"
    )
    path.with_suffix(".prj").write_text(SHIFTED_WKT)
    return str(path)


@pytest.mark.parametrize(
    "write", [in_geotiff, in_geotiff_without_code, in_vrt, in_side_file, in_prj, None]
)
def test_a_datum_shift_of_its_own_is_kept(
    tmp_path: Path, write: Callable[[Path], str] | None
) -> None:
    if write is None:
        mesh = geomesh.mesh_raster(write_raster(tmp_path), nodes=50, crs=SHIFTED_TEXT)
    else:
        mesh = geomesh.mesh_raster(write(tmp_path), nodes=50)
    shift = "+proj=helmert +x={} +y={} +z={}".format(*SHIFT)
    expected = Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=utm +zone=32 +ellps=intl +step +proj=cart +ellps=intl "
        f"+step {shift} +step +inv +proj=cart +ellps=WGS84 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    nodes = read_layer(write_mesh(mesh, tmp_path / "m.geojson", layers=["nodes"]), "nodes")
    found = np.column_stack([nodes.geometry.x, nodes.geometry.y])
    x, y = mesh.map_nodes.T
    np.testing.assert_allclose(
        found, np.column_stack(expected.transform(x, y, np.zeros(len(x)))[:2]), atol=2e-7
    )
    kept = read_layer(write_mesh(mesh, tmp_path / "m.parquet", layers=["nodes"]), "nodes").crs
    assert same_crs(kept, mesh.grid.crs)
    assert same_crs(geomesh.read_mesh(write_mesh(mesh, tmp_path / "m.gpkg")).grid.crs, kept)
    assert crs_label(kept).endswith("with its own datum shift")


def test_a_shift_that_proj_knows_itself_leaves_the_plain_code(tmp_path: Path) -> None:
    wkt = re.sub(
        r'(,AUTHORITY\["EPSG","6674"\]\])',
        r",TOWGS84[0,0,0,0,0,0,0]\1",
        CRS(31985).to_wkt("WKT1_GDAL"),
        count=1,
    )
    assert CRS.from_wkt(wkt).is_bound
    path = write_raster(tmp_path, crs=rasterio.crs.CRS.from_wkt(wkt))
    assert open_scene(path).grid.crs == CRS(31985)
    assert open_scene(path, crs=wkt).grid.crs == CRS(31985)


def test_gdal_reads_as_it_did_once_a_raster_is_open(tmp_path: Path) -> None:
    path = in_geotiff(tmp_path)
    with rasterio.open(path) as dataset:
        before = dataset.crs.to_wkt()
    open_scene(path)
    with rasterio.open(path) as dataset:
        assert dataset.crs.to_wkt() == before


# Areas

ROTATED = [
    pytest.param(rotated_pole(), id="sphere"),
    pytest.param(
        rotated_pole(6.55, 20, 30, semi_major_axis=6378137.0, inverse_flattening=298.257223563),
        id="ellipsoid",
    ),
    pytest.param(KINDS["rotated by PROJ"], id="PROJ"),
]


def area_in(crs: CRS, corners: np.ndarray) -> float:
    (area,) = Grid(9, 9, Affine.identity(), crs).areas(corners, np.array([[0, 1, 2]], np.int32))
    return float(area)


@pytest.mark.parametrize("crs", ROTATED)
@pytest.mark.parametrize("size", [0.01, 0.5, 3.0])
def test_areas_of_a_rotated_pole_are_those_on_the_earth(crs: CRS, size: float) -> None:
    base = crs.source_crs
    geod = base.get_geod()
    assert isinstance(geod, Geod)
    to_base = Transformer.from_crs(crs, base, always_xy=True)
    # Around the true pole too, which lies within the rotated grid.
    pole = np.array(to_base.transform(0, 90, direction="INVERSE"))
    random = np.random.default_rng(1)
    around = pole + random.uniform(-size, size, (10, 2)) / 3
    anywhere = random.uniform((-180, -80), (180, 80), (40, 2))
    for middle in [*around, *anywhere]:
        angles = np.radians(random.uniform(0, 360) + np.array([0, 110, 230]))
        corners = middle + size * np.column_stack([np.cos(angles), np.sin(angles)])
        expected, _ = geod.polygon_area_perimeter(*to_base.transform(*corners.T))
        # Great circles of the authalic sphere are not quite geodesics.
        assert area_in(crs, corners) == pytest.approx(abs(expected), rel=2e-4)


@pytest.mark.parametrize("crs", ROTATED)
def test_small_areas_of_a_rotated_pole_agree_with_straight_sides_on_the_map(crs: CRS) -> None:
    geod = crs.source_crs.get_geod()
    assert isinstance(geod, Geod)
    to_base = Transformer.from_crs(crs, crs.source_crs, always_xy=True)
    corners = np.array([(20, 30), (20.1, 30.02), (20.03, 30.1)])
    shares = np.arange(50)[:, None] / 50
    ring = np.vstack(
        [a + (b - a) * shares for a, b in zip(corners, corners[[1, 2, 0]], strict=True)]
    )
    expected, _ = geod.polygon_area_perimeter(*to_base.transform(*ring.T))
    assert area_in(crs, corners) == pytest.approx(abs(expected), rel=1e-3)


def test_planetocentric_latitudes_are_converted() -> None:
    # On an ellipsoid a planetocentric latitude is nearer to the equator than a geodetic one.
    ocentric, ographic = CRS("IAU_2015:49902"), CRS("IAU_2015:49901")
    flat = ographic.ellipsoid
    assert flat is not None
    geodetic = np.array([(10, 45), (10.1, 45), (10, 45.1)])
    squares = (flat.semi_minor_metre / flat.semi_major_metre) ** 2
    centric = np.degrees(np.arctan(squares * np.tan(np.radians(geodetic[:, 1]))))
    corners = np.column_stack([geodetic[:, 0], centric])
    assert area_in(ocentric, corners) == pytest.approx(area_in(ographic, geodetic), rel=1e-9)


def test_each_axis_has_its_own_unit() -> None:
    wkt = re.sub(
        r'(AXIS\["\(E\)",east,ORDER\[1\],LENGTHUNIT\[)"metre",1',
        r'\1"kilometre",1000',
        CRS(32633).to_wkt(),
    )
    crs = CRS.from_wkt(wkt)
    assert [axis.unit_conversion_factor for axis in crs.axis_info] == [1000, 1]
    assert area_in(crs, np.array([(500, 0), (501, 0), (500, 10)])) == pytest.approx(5000)


def test_areas_in_an_unknown_unit_are_in_its_square() -> None:
    crs = CRS.from_wkt(SITE.replace('"metre",1', '"unknown",0'))
    assert area_in(crs, np.array([(0, 0), (4, 0), (0, 6)])) == pytest.approx(12)


@pytest.mark.parametrize("unit", [1.0, math.pi / 200], ids=["radian", "grad"])
def test_angles_in_other_units_have_the_aspect_and_the_areas_of_degrees(unit: float) -> None:
    definition = CRS(4326).to_json_dict()
    definition.pop("id")
    for axis in definition["coordinate_system"]["axis"]:
        axis["unit"] = {"type": "AngularUnit", "name": "other", "conversion_factor": unit}
    other = CRS.from_json_dict(definition)
    scale = math.radians(1) / unit
    transform = Affine(0.1, 0, 10, 0, -0.1, 60)
    one = Grid(20, 10, transform, CRS(4326))
    two = Grid(20, 10, Affine(*(np.array(transform[:6]) * scale)), other)
    assert two.aspect == pytest.approx(one.aspect)
    nodes, triangles = np.array([(0, 0), (0, 10), (20, 10)]), np.array([[0, 1, 2]])
    assert two.areas(nodes, triangles) == pytest.approx(one.areas(nodes, triangles))


# Formats


@each_kind
@pytest.mark.parametrize("suffix", [".gpkg", ".fgb", ".parquet"])
def test_geopandas_reads_the_same_crs(tmp_path: Path, kind: str, suffix: str) -> None:
    mesh = random_mesh(grid_in(kind), 30)
    path = write_mesh(mesh, tmp_path / f"mesh{suffix}", layers=["nodes"])
    found = read_layer(path, "nodes").crs
    if kind == "code and own shift" and suffix == ".gpkg":
        # It is in the file, but GDAL drops it on reading, unless OSR_STRIP_TOWGS84 is NO.
        with sqlite3.connect(path) as database:
            texts = database.execute("SELECT definition FROM gpkg_spatial_ref_sys").fetchall()
        assert any("TOWGS84[-84,-97,-117" in text for (text,) in texts)
        assert same_crs(found, CRS(23032))
        return
    assert found.equals(KINDS[kind], ignore_axis_order=True)
    assert same_crs(found, KINDS[kind])


@each_kind
def test_a_mesh_read_back_has_its_crs(tmp_path: Path, kind: str) -> None:
    mesh = random_mesh(grid_in(kind), 30)
    found = geomesh.read_mesh(write_mesh(mesh, tmp_path / "mesh.gpkg"))
    assert same_crs(found.grid.crs, mesh.grid.crs)
    assert found.grid.crs.type_name == mesh.grid.crs.type_name


@each_kind
def test_ugrid_states_the_crs_for_mdal_and_for_cf(tmp_path: Path, kind: str) -> None:
    crs = KINDS[kind]
    path = write_mesh(random_mesh(grid_in(kind), 30), tmp_path / "mesh.nc")
    with netcdf_file(path, mmap=False) as dataset:
        stated = dict(dataset.variables["projected_coordinate_system"]._attributes)
        axes = [dict(dataset.variables[f"mesh_node_{axis}"]._attributes) for axis in "xy"]
    assert same_crs(CRS.from_wkt(stated["crs_wkt"].decode()), crs)
    if "epsg" in stated:
        assert stated["EPSG_code"] == b"EPSG:%d" % stated["epsg"]
        assert same_crs(CRS(int(stated["epsg"])), crs)
    else:
        wkt = stated["wkt"].decode()
        assert same_crs(CRS.from_wkt(wkt), crs)
        assert not re.search(r'(AUTHORITY|ID)\["\w+",[^]]*\]\]$', wkt) or "BOUND" in wkt
    names = {axis["standard_name"] for axis in axes}
    if kind in ("rotated pole", "rotated by PROJ"):
        assert names == {b"grid_longitude", b"grid_latitude"}
        assert {axis["units"] for axis in axes} == {b"degrees"}
    elif kind in ANGLES:
        assert names == {b"longitude", b"latitude"}
    else:
        assert names == {b"projection_x_coordinate", b"projection_y_coordinate"}
        assert axes[0]["units"] == (b"US_survey_foot" if kind == "US feet" else b"metre")
    opened = xugrid.open_dataset(path, engine="scipy")
    assert opened.ugrid.grid.n_face > 0


def test_ugrid_of_a_rotated_pole_is_what_cf_says(tmp_path: Path) -> None:
    path = write_mesh(random_mesh(grid_in("rotated pole"), 30), tmp_path / "mesh.nc")
    with netcdf_file(path, mmap=False) as dataset:
        stated = dict(dataset.variables["projected_coordinate_system"]._attributes)
    assert stated["grid_mapping_name"] == b"rotated_latitude_longitude"
    assert stated["grid_north_pole_latitude"] == 39.25
    assert stated["grid_north_pole_longitude"] == -162
    texts = {
        key: value.decode() if isinstance(value, bytes) else value for key, value in stated.items()
    }
    del texts["crs_wkt"]
    del texts["wkt"]
    again = CRS.from_cf(texts)
    assert again.to_cf()["grid_north_pole_latitude"] == 39.25


def test_a_rendered_geotiff_keeps_a_crs_that_it_cannot_hold(tmp_path: Path) -> None:
    path = write_raster(
        tmp_path,
        crs=rasterio.crs.CRS.from_wkt(rotated_pole().to_wkt()),
        transform=Affine(0.1, 0, -3, 0, -0.1, 2),
    )
    mesh = geomesh.mesh_raster(path, nodes=50)
    target = tmp_path / "out" / "rendered.tif"
    target.parent.mkdir()
    render_file(mesh, path, target)
    assert same_crs(open_scene(str(target)).grid.crs, mesh.grid.crs)


def test_info_names_a_crs_in_a_few_words(tmp_path: Path, command: Geomesh) -> None:
    wkt = rotated_pole().to_wkt()
    path = write_raster(
        tmp_path, crs=rasterio.crs.CRS.from_wkt(wkt), transform=Affine(0.1, 0, -3, 0, -0.1, 2)
    )
    mesh = write_mesh(geomesh.mesh_raster(path, nodes=50), tmp_path / "mesh.gpkg")
    for source in (path, mesh):
        (line,) = [line for line in command("info", source).out.splitlines() if "crs:" in line]
        assert line == "crs: an unnamed CRS (Pole rotation (netCDF CF convention))"


# Any CRS of the database


def area_of_use(area: AreaOfUse) -> tuple[float, float]:
    width = (area.east - area.west) % 360
    return area.west + width / 2, (area.south + area.north) / 2


def sample_of_codes(count: int) -> list[str]:
    infos = [
        info
        for kind in ("PROJECTED_CRS", "GEOGRAPHIC_2D_CRS", "GEOGRAPHIC_3D_CRS", "COMPOUND_CRS")
        for info in pyproj.database.query_crs_info("EPSG", pj_types=kind)
        if info.area_of_use is not None
    ]
    chosen = np.random.default_rng(11).choice(len(infos), count, replace=False)
    return [infos[k].code for k in sorted(chosen)]


def check_code(folder: Path, code: int) -> bool:
    """Write a raster in a CRS, and a mesh of it in each kind of format.

    Return False for a CRS whose projection PROJ lacks.
    """
    crs = CRS.from_epsg(code)
    middle = area_of_use(crs.area_of_use)
    try:
        x, y = Transformer.from_crs(LONLAT, crs, always_xy=True).transform(*middle)
    except ProjError:
        return False
    pixel = 10 / crs.axis_info[0].unit_conversion_factor
    if has_angles(crs):
        pixel /= 6e6
    path = write_raster(
        folder,
        data=picture(rows=40, cols=50),
        crs=rasterio.crs.CRS.from_epsg(code),
        transform=Affine(pixel, 0, x, 0, -pixel, y),
    )
    grid = open_scene(path).grid
    assert same_crs(grid.crs, crs), code
    mesh = random_mesh(grid, 6)
    options: dict[str, Any] = {"layers": ["triangles"], "overwrite": True}
    frame = read_layer(write_mesh(mesh, folder / "m.geojson", **options))
    west, south, east, north = frame.total_bounds
    assert (west - 0.1 <= middle[0] <= east + 0.1) or abs(middle[0]) > 179, code
    assert south - 0.1 <= middle[1] <= north + 0.1, code
    write_mesh(mesh, folder / "m.nc", overwrite=True)
    found = read_layer(write_mesh(mesh, folder / "m.gpkg", **options)).crs
    assert same_crs(found, crs), code
    return True


@pytest.mark.parametrize("code", sample_of_codes(200)[::25])
def test_any_code_is_read_and_stated_as_the_same_crs(tmp_path: Path, code: str) -> None:
    assert check_code(tmp_path, int(code))


@pytest.mark.slow
def test_many_codes_are_read_and_stated_as_the_same_crs(tmp_path: Path) -> None:
    for code in sample_of_codes(200):
        crs = CRS.from_epsg(int(code))
        found = to_pyproj(rasterio.crs.CRS.from_epsg(int(code)))
        assert same_crs(found, crs), code
        assert same_crs(CRS.from_wkt(portable_wkt(found)), crs), code
        assert same_crs(CRS.from_wkt(wkt1_or_wkt2(found)), crs), code
    checked = [check_code(tmp_path, int(code)) for code in sample_of_codes(200)[5::10]]
    assert sum(checked) >= len(checked) - 1
