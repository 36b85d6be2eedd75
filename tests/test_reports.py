"""Situations of public reports about other software, each with the right result.

Other tests cover the kinds: tests/test_areas.py, test_crs.py, test_values.py, test_side_data.py,
test_streams.py, test_capacity.py, test_advice.py, test_file_set.py, test_band_names.py.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
import xugrid
from affine import Affine
from pyproj import CRS
from rasterio.enums import ColorInterp

import geomesh
from geomesh.errors import SourceError
from support.commands import run_program
from support.rasters import FLOAT32_MIN, picture, write_raster

if TYPE_CHECKING:
    from pathlib import Path

    from support.commands import Geomesh

UTM = "EPSG:32633"
TEN_METRES = Affine(10, 0, 500_000, 0, -10, 5_000_000)
SMALL = shapely.box(500_200, 4_999_200, 500_800, 4_999_800)  # 3,600 pixels
PIXELS = 200 * 200

ROTATED = CRS.from_cf(
    {
        "grid_mapping_name": "rotated_latitude_longitude",
        "grid_north_pole_latitude": 6.55,
        "grid_north_pole_longitude": 0.0,
        "north_pole_grid_longitude": 0.0,
        "earth_radius": 6_371_000.0,
    }
).to_wkt()


def scene(folder: Path, name: str = "scene.tif", data: Any = None, **profile: Any) -> str:
    data = picture(1, 200, 200) if data is None else data
    return write_raster(folder, name, data, **({"crs": UTM, "transform": TEN_METRES} | profile))


def counted(path: Path) -> int:
    return int(gpd.read_file(path, layer="triangles", ignore_geometry=True)["count"].sum())


def mesh(command: Geomesh, source: str, folder: Path, *options: str | Path) -> int:
    """Mesh a raster by the command, and return the number of pixels in the triangles."""
    output = folder / "mesh.gpkg"
    run = command("mesh", source, "-o", output, "--overwrite", *options)
    assert run.code == 0, run.err
    return counted(output)


def test_nodata_of_a_palette_is_a_class_and_not_a_colour(tmp_path: Path, command: Geomesh) -> None:
    classes = np.digitize(picture(1, 200, 200), [60, 90, 120, 150]).astype(np.uint8) * 10 + 10
    classes[:, :20] = 0
    colors = {value: (250 - value, 4 * value, 5 * value) for value in range(0, 60, 10)}
    path = scene(tmp_path, data=classes, change=lambda d: d.write_colormap(1, colors))
    assert mesh(command, path, tmp_path, "--nodata", "0", "--set", "min_hole=0") == 36_000


def test_an_area_in_degrees_on_a_polar_raster(tmp_path: Path, command: Geomesh) -> None:
    arctic = Affine(25_000, 0, -3_750_000, 0, -25_000, 3_750_000)
    path = scene(tmp_path, data=picture(1, 300, 300), crs="EPSG:3413", transform=arctic)
    gpd.GeoSeries([shapely.box(-180, 60, 180, 90)], crs=4326).to_file(tmp_path / "north.geojson")
    assert mesh(command, path, tmp_path, "--mask", tmp_path / "north.geojson") == 55_512


def test_an_area_with_spikes_of_no_width(tmp_path: Path, command: Geomesh) -> None:
    ring = [(500_200, 4_999_800), (500_800, 4_999_800)]
    for y in range(4_999_788, 4_999_388, -10):
        ring += [(500_800, y), (501_500, y - 4), (500_800, y)]
    area = shapely.Polygon([*ring, (500_800, 4_999_200), (500_200, 4_999_200)])
    gpd.GeoSeries([area], crs=UTM).to_file(tmp_path / "spikes.gpkg")
    assert mesh(command, scene(tmp_path), tmp_path, "--mask", tmp_path / "spikes.gpkg") == 3600


def test_an_area_in_a_collection(tmp_path: Path, command: Geomesh) -> None:
    other = shapely.box(501_000, 4_999_000, 501_500, 4_999_500)  # 2,500 pixels
    shapes = [shapely.GeometryCollection([SMALL]), other]
    gpd.GeoSeries(shapes, crs=UTM).to_file(tmp_path / "area.gpkg")
    assert mesh(command, scene(tmp_path), tmp_path, "--mask", tmp_path / "area.gpkg") == 6100


def test_an_area_file_of_two_layers(tmp_path: Path, command: Geomesh) -> None:
    path, area = scene(tmp_path), tmp_path / "two.gpkg"
    gpd.GeoSeries([SMALL.buffer(300)], crs=UTM).to_file(area, layer="municipality")
    gpd.GeoSeries([SMALL], crs=UTM).to_file(area, layer="aoi", mode="a")
    refused = command("mesh", path, "-o", tmp_path / "mesh.gpkg", "--mask", area).error()
    assert "'municipality', 'aoi': choose one with --mask-layer" in refused
    assert mesh(command, path, tmp_path, "--mask", area, "--mask-layer", "aoi") == 3600


def test_a_shapefile_without_its_index(tmp_path: Path, command: Geomesh) -> None:
    gpd.GeoSeries([SMALL], crs=UTM).to_file(tmp_path / "lone.shp")
    (tmp_path / "lone.shx").unlink()
    options = ("-o", tmp_path / "mesh.gpkg", "--mask", tmp_path / "lone.shp")
    assert "lone.shx is missing" in command("mesh", scene(tmp_path), *options).error()


def test_an_area_of_many_corners(tmp_path: Path, command: Geomesh) -> None:
    angle = np.linspace(0, 2 * np.pi, 400_000)
    radius = 900 + 20 * np.sin(9000 * angle)
    ring = np.column_stack([501_000 + radius * np.cos(angle), 4_999_000 + radius * np.sin(angle)])
    area = shapely.Polygon(ring)
    gpd.GeoSeries([area], crs=UTM).to_file(tmp_path / "corners.gpkg")
    options = ("--mask", tmp_path / "corners.gpkg", "--set", "min_hole=0", "--nodes", "200")
    x, y = np.meshgrid(500_005 + 10 * np.arange(200), 4_999_995 - 10 * np.arange(200))
    shapely.prepare(area)
    expected = int(shapely.intersects_xy(area, x, y).sum())
    assert mesh(command, scene(tmp_path), tmp_path, *options) == expected


@pytest.fixture
def rotated(tmp_path: Path) -> str:
    grid = Affine(0.44, 0, -22.88, 0, -0.44, 26.84)
    return scene(tmp_path, data=picture(1, 130, 130), crs=ROTATED, transform=grid)


def test_a_rotated_pole_as_geojson(tmp_path: Path, rotated: str, command: Geomesh) -> None:
    output = tmp_path / "mesh.geojson"
    assert command("mesh", rotated, "-o", output, "--nodes", "300").code == 0
    found = gpd.read_file(output).geometry
    # Triangles across the antimeridian have two parts. One goes around the pole.
    parts = found.explode().bounds
    assert (parts["maxx"] - parts["minx"])[parts["maxy"] < 90].max() < 180
    assert found.is_valid.all()
    assert found.area.sum() == pytest.approx(found.union_all().area, rel=1e-6)


def test_a_rotated_pole_as_ugrid(tmp_path: Path, rotated: str, command: Geomesh) -> None:
    output = tmp_path / "mesh.nc"
    assert command("mesh", rotated, "-o", output, "--nodes", "300").code == 0
    # xugrid warns that it looks for longitude, not for the grid_longitude of CF.
    with pytest.warns(UserWarning, match="mesh_node_x"), xugrid.open_dataset(output) as dataset:
        assert int(dataset["count"].sum()) == 130 * 130


def test_bands_of_two_types(tmp_path: Path, command: Geomesh) -> None:
    scene(tmp_path, "bytes.tif")
    scene(tmp_path, "floats.tif", picture(1, 200, 200).astype(np.float32))
    bands = "".join(
        f'<VRTRasterBand dataType="{kind}" band="{band}"><SimpleSource><SourceFilename '
        f'relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
        "</VRTRasterBand>"
        for band, (kind, name) in enumerate((("Byte", "bytes.tif"), ("Float32", "floats.tif")), 1)
    )
    path = tmp_path / "separate.vrt"
    path.write_text(
        f'<VRTDataset rasterXSize="200" rasterYSize="200"><SRS>{UTM}</SRS>'
        f"<GeoTransform>500000, 10, 0, 5000000, 0, -10</GeoTransform>{bands}</VRTDataset>"
    )
    assert mesh(command, str(path), tmp_path) == PIXELS


def test_overviews_that_hold_nothing(tmp_path: Path, command: Geomesh) -> None:
    image = picture(1, 1600, 1600)
    path = scene(tmp_path, data=image, tiled=True, compress="deflate")
    before = geomesh.mesh_raster(path, nodes=500, effort="fast")
    scene(tmp_path, "scene.tif.ovr", np.zeros((1, 800, 800), np.uint8))
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1) == [2]
    after = geomesh.mesh_raster(path, nodes=500, effort="fast")
    np.testing.assert_array_equal(after.nodes, before.nodes)


def test_a_layer_that_another_program_added(tmp_path: Path, command: Geomesh) -> None:
    path = tmp_path / "mesh.gpkg"
    made = geomesh.mesh_raster(scene(tmp_path), nodes=50)
    made.to_file(path)
    gpd.GeoSeries([SMALL], crs=UTM).to_file(path, layer="aoi", mode="a")
    np.testing.assert_array_equal(geomesh.read_mesh(path).nodes, made.nodes)
    assert command("quality", path, "-o", tmp_path / "measured.gpkg").code == 0


def test_a_terminal_that_cannot_print_the_name(tmp_path: Path) -> None:
    names = [scene(tmp_path, "北京.tif"), scene(tmp_path, "scene.tif")]
    run = run_program(
        *("mesh", *names, "-o", f"{tmp_path}/out/", "--nodes", "50"),
        env={"PYTHONIOENCODING": "cp1252", "PATH": ""},
    )
    assert run.code == 0, run.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"北京.gpkg", "scene.gpkg"}


def test_nodata_with_fifteen_digits(tmp_path: Path, command: Geomesh) -> None:
    heights = picture(1, 200, 200).astype(np.float32)
    heights[:, :60, :60] = FLOAT32_MIN
    path = scene(tmp_path, data=heights)
    assert mesh(command, path, tmp_path, "--nodata=-3.40282346638529e+38") == PIXELS - 3600


def test_a_code_that_only_one_database_knows(tmp_path: Path, command: Geomesh) -> None:
    path = scene(tmp_path, crs="EPSG:10726")
    assert mesh(command, path, tmp_path) == PIXELS
    found = gpd.read_file(tmp_path / "mesh.gpkg", layer="triangles").crs
    with rasterio.open(path) as dataset:
        assert found.equals(CRS(dataset.crs.to_wkt(version="WKT2_2019")), ignore_axis_order=True)


def test_near_infrared_that_is_tagged_as_alpha(tmp_path: Path, command: Geomesh) -> None:
    bands = picture(4, 200, 200)
    bands[3, :80] = 0
    path = scene(tmp_path, data=bands, photometric="RGB", alpha="YES")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[3] == ColorInterp.alpha
    output = tmp_path / "mesh.gpkg"
    assert "--alpha data" in command("mesh", path, "-o", output, "--bidx", "4,1,2").error()
    assert "alpha in band 4" in command("info", path).out
    assert mesh(command, path, tmp_path, "--bidx", "4,1,2", "--alpha", "data") == PIXELS


def test_more_bands_than_a_geopackage_has_columns(tmp_path: Path, command: Geomesh) -> None:
    path = scene(tmp_path, data=np.repeat(picture(1, 60, 60), 520, 0))
    features = ("--preset", "features")  # which is faster with so many bands
    refused = command("mesh", path, "-o", tmp_path / "mesh.gpkg", *features).error()
    assert "at most 1998" in refused
    assert "--stats mean" in refused
    assert mesh(command, path, tmp_path, "--stats", "mean", *features) == 60 * 60


@pytest.mark.parametrize("bounds", [(), ("--bounds", "-0.5", "-90", "359.5", "90")])
def test_a_global_grid_beyond_the_poles_as_geojson(
    tmp_path: Path, bounds: tuple[str, ...], command: Geomesh
) -> None:
    globe = Affine(1, 0, -0.5, 0, -1, 90.5)
    path = scene(tmp_path, data=picture(1, 181, 360), crs="EPSG:4326", transform=globe)
    output = tmp_path / "mesh.geojson"
    run = command("mesh", path, "-o", output, "--nodes", "300", *bounds)
    assert run.code == 0, run.err
    found = gpd.read_file(output)
    assert found.total_bounds.tolist() == [-180, -90, 180, 90]
    assert found.geometry.area.sum() == pytest.approx(360 * 180, rel=1e-6)


def test_band_names_in_another_script(tmp_path: Path, command: Geomesh) -> None:
    path = scene(tmp_path, change=lambda dataset: dataset.set_band_description(1, "近红外"))
    mesh(command, path, tmp_path, "--nodes", "50")
    assert "近红外_mean" in pyogrio.read_info(tmp_path / "mesh.gpkg", layer="triangles")["fields"]


def test_an_array_with_the_bands_on_the_last_axis() -> None:
    image = np.moveaxis(picture(3, 200, 200), 0, -1)
    with pytest.raises(SourceError, match=r"np\.moveaxis\(array, -1, 0\)"):
        geomesh.mesh_raster((image, TEN_METRES, UTM))
    moved = geomesh.mesh_raster((np.moveaxis(image, -1, 0), TEN_METRES, UTM), nodes=50)
    assert len(moved.provenance.source.bands) == 3


def test_a_mosaic_without_one_of_its_tiles(tmp_path: Path, command: Geomesh) -> None:
    tile = scene(tmp_path, "tile.tif")
    path = tmp_path / "mosaic.vrt"
    path.write_text(
        f'<VRTDataset rasterXSize="400" rasterYSize="200"><SRS>{UTM}</SRS>'
        '<GeoTransform>500000, 10, 0, 5000000, 0, -10</GeoTransform><VRTRasterBand dataType="Byte" '
        'band="1">'
        + "".join(
            f'<SimpleSource><SourceFilename relativeToVRT="0">{name}</SourceFilename>'
            '<SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="200" ySize="200"/>'
            f'<DstRect xOff="{col}" yOff="0" xSize="200" ySize="200"/></SimpleSource>'
            for name, col in ((tile, 0), (tmp_path / "missing.tif", 200))
        )
        + "</VRTRasterBand></VRTDataset>"
    )
    refused = command("mesh", path, "-o", tmp_path / "mesh.gpkg").error()
    assert f"{tmp_path / 'missing.tif'} is missing" in refused
    # The part that the other tile covers needs no more.
    west_half = ("--bounds", "500000", "4998000", "502000", "5000000")
    assert mesh(command, str(path), tmp_path, *west_half) == PIXELS


def test_scale_and_offset(tmp_path: Path, command: Geomesh) -> None:
    stored = picture(1, 200, 200).astype(np.uint16)

    def change(dataset: Any) -> None:
        dataset.scales, dataset.offsets = (0.1,), (-100.0,)

    path = scene(tmp_path, data=stored, change=change)
    told = json.loads(command("info", path, "--json").out)["bands"][0]
    assert (told["scale"], told["offset"]) == (0.1, -100)
    plain, scaled = (  # refinement gives another mesh for floats
        geomesh.mesh_raster(path, preset="features", nodes=50, unscale=unscale)
        for unscale in (False, True)
    )
    expected = plain.triangle_table["b1_mean"] * 0.1 - 100
    np.testing.assert_allclose(scaled.triangle_table["b1_mean"], expected, rtol=1e-9)
    assert mesh(command, path, tmp_path, "--unscale") == PIXELS
