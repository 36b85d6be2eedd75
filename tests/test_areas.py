"""Areas of interest: whatever is given becomes exactly the pixels whose centres lie in it."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pyproj
import pytest
import shapely
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from rasterio.transform import from_bounds

import geomesh
from geomesh.errors import EmptyError, GeoreferenceError, SourceError
from geomesh.raster.aoi import burn
from geomesh.raster.aoi.polygons import read_polygons
from geomesh.raster.grid import Grid, Window
from geomesh.raster.open import open_scene
from geomesh.raster.pixel_mask import PixelMask

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.raster.scene import Scene


def read_area(scene: Scene, shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels of the area in the whole raster."""
    found = np.zeros(shape, bool)
    with scene.open() as reader:
        _, valid = reader.read(scene.grid.extent)
    found[scene.window.slices()] = valid
    return found


def find_area(raster: Any, **options: Any) -> np.ndarray:
    """Return the pixels of an area in the whole raster; none, if geomesh says that it is empty."""
    shape = raster[0].shape
    try:
        return read_area(open_scene(raster, **options), shape)
    except EmptyError:
        return np.zeros(shape, bool)


def centres_of(transform: Affine, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    t = transform
    return t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f


def expected_area(
    transform: Affine, shape: tuple, crs: Any, area: Any, area_crs: Any
) -> np.ndarray:
    """Ask shapely for the centre of every pixel, in the CRS of the area."""
    xy = np.stack(centres_of(transform, shape))
    if CRS(crs) != CRS(area_crs):
        xy = np.stack(Transformer.from_crs(crs, area_crs, always_xy=True).transform(*xy))
    found = shapely.intersects_xy(area, *xy)
    if CRS(area_crs).is_geographic:
        for turn in (-720, -360, 360, 720):
            found |= shapely.intersects_xy(area, xy[0] + turn, xy[1])
    return found


def random_polygon(rng: np.random.Generator, box: tuple[float, ...]) -> Any:
    """Return a star with a hole, perhaps with a second one, in a box."""
    west, south, east, north = box
    stars = []
    for _ in range(rng.integers(1, 3)):
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(5, 12)))
        centre = rng.uniform((west, south), (east, north))
        size = rng.uniform(0.1, 0.6) * np.array([east - west, north - south])
        radii = rng.uniform(0.3, 1, len(angles))[:, None]
        ring = np.column_stack([np.cos(angles), np.sin(angles)]) * radii * size
        stars.append(shapely.make_valid(shapely.Polygon(centre + ring, [centre + ring * 0.3])))
    return shapely.union_all(stars)


def sample_crss(count: int) -> list[tuple[str, tuple[float, ...]]]:
    """Return codes of CRSs of all kinds, with their areas of use in longitude and latitude."""
    rng = np.random.default_rng(11)
    infos = pyproj.database.query_crs_info("EPSG", ["PROJECTED_CRS", "GEOGRAPHIC_2D_CRS"])
    sample = [infos[k] for k in rng.choice(len(infos), count, replace=False)]
    return [
        (f"EPSG:{info.code}", info.area_of_use.bounds)
        for info in sample
        if info.area_of_use is not None and info.area_of_use.west < info.area_of_use.east
    ]


@pytest.mark.parametrize(("crs", "use"), sample_crss(40))
def test_random_polygons_in_random_crss(crs: str, use: tuple[float, ...]) -> None:
    rng = np.random.default_rng(int(crs[5:]))
    bounds = np.array(Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform_bounds(*use))
    shape = (int(rng.integers(40, 200)), int(rng.integers(40, 200)))
    turn = Affine.rotation(float(rng.uniform(-30, 30))) if rng.random() < 0.3 else Affine.identity()
    transform = from_bounds(*bounds, *shape[::-1]) @ turn
    raster = (np.ones(shape, np.uint8), transform, crs)
    for area_crs, box in (("EPSG:4326", use), (crs, tuple(bounds))):
        area = random_polygon(rng, box)
        if CRS(area_crs).is_geographic:
            area = area.intersection(shapely.box(-360, -90, 360, 90))
        expected = expected_area(transform, shape, crs, area, area_crs)
        found = find_area(raster, mask=f"SRID={area_crs[5:]};{area.wkt}")
        assert (found == expected).all(), (area_crs, int((found != expected).sum()))
    box = shapely.box(*np.sort(rng.uniform(bounds[:2], bounds[2:], (2, 2)), axis=0).ravel())
    expected = expected_area(transform, shape, crs, box, crs)
    found = find_area(raster, bounds=box.bounds)
    assert (found == expected).all()


ROTATED = CRS.from_cf(
    {
        "grid_mapping_name": "rotated_latitude_longitude",
        "grid_north_pole_latitude": 39.25,
        "grid_north_pole_longitude": -162.0,
        "north_pole_grid_longitude": 0.0,
        "earth_radius": 6371229.0,
    }
)
# Name: CRS, bounds of the raster, and its size. No centre of a pixel is at a pole, where a
# longitude means nothing.
WORLDS: dict[str, tuple[Any, tuple[float, ...], tuple[int, int]]] = {
    "lon -180 to 180": (4326, (-180, -90, 180, 90), (90, 180)),
    "lon 0 to 360": (4326, (0, -90, 360, 90), (90, 180)),
    "half a pixel beyond the poles": (4326, (-180.5, -90.4, 179.5, 90.4), (181, 360)),
    "more than a turn": (4326, (-200, -60, 220, 60), (60, 210)),
    "north polar": (3413, (-3_750_000, -3_750_000, 3_750_000, 3_750_000), (150, 150)),
    "south polar": (3031, (-3_100_000, -2_900_000, 3_100_000, 3_300_000), (150, 150)),
    "Mollweide": ("ESRI:54009", (-18_050_000, -9_050_000, 18_050_000, 9_050_000), (100, 200)),
    "geostationary": ("+proj=geos +h=35785831", (-5.5e6, -5.5e6, 5.5e6, 5.5e6), (150, 150)),
    "orthographic": (
        "+proj=ortho +lat_0=40 +lon_0=170",
        (-6.4e6, -6.4e6, 6.4e6, 6.4e6),
        (140, 140),
    ),
    "Pacific Mercator": (3832, (-5e6, -5e6, 8e6, 5e6), (100, 130)),
    "UTM 60": (32660, (300_000, 1_000_000, 900_000, 1_600_000), (120, 120)),
    "rotated pole": (ROTATED, (-28, -23, 18, 21), (100, 104)),
}
AREAS: dict[str, tuple[Any, Any]] = {
    "world": (4326, shapely.box(-180, -90, 180, 90)),
    "world from 0 to 360": (4326, shapely.box(0, -90, 360, 90)),
    "north of 60.3": (4326, shapely.box(-180, 60.3, 180, 90)),
    "south of -62.7": (4326, shapely.box(-180, -90, 180, -62.7)),
    "across the antimeridian": (4326, shapely.box(160.3, -40.2, 200.7, 50.1)),
    "cut at the antimeridian": (
        4326,
        shapely.MultiPolygon(
            [shapely.box(160.3, -40.2, 180, 50.1), shapely.box(-180, -40.2, -159.3, 50.1)]
        ),
    ),
    "Europe": (4326, shapely.Polygon([(-10.1, 36.2), (30.3, 35.1), (40.7, 70.9), (-24.2, 66.6)])),
    "a disc around the pole": (3413, shapely.Point(1e5, -2e5).buffer(2.1e6)),
    "a disc beside the pole": (3413, shapely.Point(1.5e6, 2e5).buffer(1.2e6)),
    "a disc around the south pole": (3031, shapely.Point(-1e5, 2e5).buffer(1.9e6)),
    "a strip in UTM": (32633, shapely.box(1e5, 3.1e6, 9e5, 8.7e6)),
    "in web Mercator": (3857, shapely.box(-2.1e7, -3e6, 2.1e7, 9e6)),
    "on the rotated grid": (ROTATED, shapely.box(-20.3, -15.2, 10.7, 15.9)),
}


@pytest.mark.parametrize("block", [1024, 32])
@pytest.mark.parametrize("world", WORLDS)
def test_areas_at_poles_and_at_the_antimeridian(
    world: str, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    crs, bounds, shape = WORLDS[world]
    transform = from_bounds(*bounds, *shape[::-1])
    raster = (np.ones(shape, np.uint8), transform, crs)
    monkeypatch.setattr(burn, "_BLOCK", block)
    for name, (area_crs, area) in AREAS.items():
        expected = expected_area(transform, shape, crs, area, area_crs)
        found = find_area(raster, mask=gpd.GeoSeries([area], crs=area_crs))
        assert (found == expected).all(), (name, int((found != expected).sum()))


def test_a_small_area_on_a_terapixel_is_found_without_looking_at_all_of_it() -> None:
    grid = Grid(1_000_000, 1_000_000, Affine(1, 0, 0, 0, -1, 6_000_000), CRS(UTM))
    area = shapely.Point(12.1, 50.1).buffer(0.005)
    found = burn.burn([read_polygons(gpd.GeoSeries([area], crs=4326), grid.crs)], grid, "it")
    assert found.mask is not None
    window, shape = found.window, found.window.pad(3).shape
    transform = grid.window(window.pad(3)).transform
    expected = expected_area(transform, shape, UTM, area, 4326)
    np.testing.assert_array_equal(found.mask.read(window.pad(3)), expected)


# What is given

UTM = "EPSG:32633"
SHAPE = (200, 200)
TRANSFORM = Affine(10, 0, 500_000, 0, -10, 5_000_000)
RASTER = (np.ones(SHAPE, np.uint8), TRANSFORM, UTM)
SMALL = shapely.box(500_200, 4_999_200, 500_800, 4_999_800)  # 3,600 pixels
LONLAT = gpd.GeoSeries([SMALL], crs=UTM).to_crs(4326).iloc[0]


def count(mask: Any, raster: Any = RASTER, **options: Any) -> int:
    return int(read_area(open_scene(raster, mask=mask, **options), SHAPE).sum())


class Feature:
    """An object that describes itself as GeoJSON, as those of several libraries do."""

    def __init__(self, geometry: Any) -> None:
        self.__geo_interface__ = {"type": "Feature", "properties": {}, "geometry": geometry}


IN_UTM = {"crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32633"}}}
GIVEN = {
    "shapely": SMALL,
    "shapely 3D": shapely.force_3d(SMALL, 7),
    "WKT": SMALL.wkt,
    "WKT in lower case": f"  {SMALL.wkt.lower()}",
    "WKT with an SRID": f"SRID=4326;{LONLAT.wkt}",
    "GeoSeries": gpd.GeoSeries([SMALL], crs=UTM),
    "GeoSeries in lon, lat": gpd.GeoSeries([LONLAT], crs=4326),
    "GeoDataFrame": gpd.GeoDataFrame({"name": ["a"]}, geometry=[LONLAT], crs=4326),
    "GeoSeries without CRS": gpd.GeoSeries([SMALL]),
    "geometry mapping": shapely.geometry.mapping(LONLAT),
    "feature": {
        "type": "Feature",
        "properties": None,
        "geometry": shapely.geometry.mapping(LONLAT),
    },
    "collection of features": gpd.GeoSeries([LONLAT, None]).__geo_interface__,
    "mapping with a CRS": {**shapely.geometry.mapping(SMALL), **IN_UTM},
    "GeoJSON as text": shapely.to_geojson(LONLAT),
    "object with __geo_interface__": Feature(shapely.geometry.mapping(LONLAT)),
}


@pytest.mark.parametrize("given_as", GIVEN)
def test_an_area_may_be_given_in_many_ways(given_as: str) -> None:
    assert count(GIVEN[given_as]) == 3600


REFUSED: dict[str, tuple[Any, type, str]] = {
    "line": (shapely.LineString([(0, 0), (1, 1)]), SourceError, "contains no polygon"),
    "collapsed polygon": ("POLYGON((0 0, 1 1, 0 0))", SourceError, "contains no polygon"),
    "empty": ("POLYGON EMPTY", SourceError, "contains no polygon"),
    "broken WKT": ("POLYGON((0 0, 1 1)", SourceError, "not valid WKT"),
    "half of WKT": ("POLYGON((0 0, 1 1", SourceError, "no such file"),
    "broken GeoJSON": ('{"type": "Polygon"', SourceError, "not valid GeoJSON"),
    "GeoJSON of another kind": ({"type": "Topology"}, SourceError, "not valid GeoJSON"),
    "features that are none": ({"features": 3}, SourceError, "not valid GeoJSON"),
    "UTM as GeoJSON": (shapely.geometry.mapping(SMALL), GeoreferenceError, "raster's coordinates"),
    "unknown SRID": (f"SRID=999999;{SMALL.wkt}", GeoreferenceError, "CRS that PROJ cannot read"),
    "not finite": (shapely.Polygon([(0, 0), (1, np.inf), (1, 0)]), SourceError, "not finite"),
    "no text": (" ", SourceError, "`mask` is empty"),
    "table": (gpd.GeoDataFrame({"name": ["a"]}), SourceError, "without geometry; choose it"),
    "a number": (7, SourceError, "is a int: give a file"),
    "Mars": (gpd.GeoSeries([SMALL], crs="ESRI:104905").scale(1e-5, 1e-5, origin=(0, 0)),
             GeoreferenceError, "no transformation"),
}  # fmt: skip


@pytest.mark.parametrize("given_as", REFUSED)
def test_what_is_no_area_is_refused_in_one_line(given_as: str) -> None:
    mask, error, message = REFUSED[given_as]
    with pytest.raises(error, match=message) as caught:
        count(mask)
    assert len(str(caught.value).splitlines()) == 1


def spikes() -> Any:
    """Return the small box with forty spikes of no width."""
    ring = [(500_200, 4_999_800), (500_800, 4_999_800)]
    for k in range(40):
        y = 4_999_788 - 10 * k
        ring += [(500_800, y), (501_500, y - 4), (500_800, y)]
    return shapely.Polygon([*ring, (500_800, 4_999_200), (500_200, 4_999_200)])


@pytest.mark.parametrize(
    ("shapes", "pixels", "notes"),
    [
        ([spikes()], 3600, ["1 polygon repaired"]),
        ([shapely.GeometryCollection([SMALL]), shapely.box(501_000, 4_999_000, 501_500, 4_999_500)],
         6100, []),
        ([shapely.GeometryCollection([SMALL, shapely.GeometryCollection([shapely.Point(1, 1)])])],
         3600, ["1 point left out"]),
        ([SMALL, SMALL.boundary, SMALL.centroid, SMALL.centroid, None], 3600,
         ["2 points and 1 line left out"]),
        ([SMALL, SMALL.buffer(0)], 3600, []),
        # Two parts of one geometry that overlap: both count, and so does what they share.
        ([shapely.MultiPolygon([SMALL, SMALL])], 3600, []),
        ([shapely.Polygon(SMALL.exterior, [SMALL.buffer(-100).exterior])], 2000, []),
    ],
    ids=["spikes", "collection", "nested", "mixed", "twice", "overlapping", "hole"],
)  # fmt: skip
def test_only_polygons_count_and_notes_say_the_rest(shapes: list, pixels: int, notes: list) -> None:
    scene = open_scene(RASTER, mask=gpd.GeoSeries(shapes, crs=UTM))
    assert int(read_area(scene, SHAPE).sum()) == pixels
    assert len(scene.notes) == len(notes)
    for note, expected in zip(scene.notes, notes, strict=True):
        assert expected in note


def test_a_side_of_more_than_half_a_turn_is_noted() -> None:
    world = (np.ones((90, 180), np.uint8), Affine(2, 0, -180, 0, -2, 90), "EPSG:4326")
    ring = shapely.Polygon([(170, -20), (-170, -20), (-170, 20), (170, 20)])
    (note,) = open_scene(world, mask=ring).notes
    assert "340 degrees" in note
    assert "beyond 180" in note
    # Its advice: longitudes beyond 180.
    across = shapely.box(170, -20, 190, 20)
    scene = open_scene(world, mask=across)
    assert scene.notes == ()
    assert read_area(scene, (90, 180)).sum() == 10 * 20


def test_bounds_across_the_antimeridian() -> None:
    world = (np.ones((90, 180), np.uint8), Affine(2, 0, -180, 0, -2, 90), "EPSG:4326")
    found = read_area(open_scene(world, bounds=(170, -20, -170, 20)), (90, 180))
    assert found.sum() == 10 * 20
    assert found[35:55, :5].all()
    assert found[35:55, 175:].all()
    pacific = (np.ones((90, 180), np.uint8), Affine(2, 0, 0, 0, -2, 90), "EPSG:4326")
    scene = open_scene(pacific, bounds=(170, -20, -170, 20))
    assert scene.window == Window(85, 35, 10, 20)


# Files


@pytest.mark.parametrize("name", ["area (2).gpkg", "POLYGON((1).gpkg", "a;b!c.gpkg", "区域.gpkg"])
def test_a_file_may_have_any_name(name: str, tmp_path: Path) -> None:
    gpd.GeoSeries([SMALL], crs=UTM).to_file(tmp_path / "area.gpkg")
    (tmp_path / "area.gpkg").rename(tmp_path / name)
    assert count(str(tmp_path / name)) == 3600


def test_a_layer_of_several_is_chosen_or_the_list_is_given(tmp_path: Path) -> None:
    path = tmp_path / "two.gpkg"
    outer = shapely.box(500_000, 4_998_000, 502_000, 5_000_000)
    gpd.GeoSeries([outer], crs=UTM).to_file(path, layer="municipality")
    gpd.GeoSeries([SMALL], crs=UTM).to_file(path, layer="aoi", mode="a")
    with pytest.raises(SourceError, match="several layers, 'municipality', 'aoi': choose one"):
        count(path)
    assert count(path, mask_layer="aoi") == 3600
    assert count(path, mask_layer="municipality") == 40_000
    with pytest.raises(
        SourceError, match=r"has no layer 'area'.*choose from 'municipality', 'aoi'"
    ):
        count(path, mask_layer="area")


def test_tables_without_geometry_are_no_layers_to_choose_from(tmp_path: Path) -> None:
    path = tmp_path / "styled.gpkg"
    gpd.GeoSeries([SMALL], crs=UTM).to_file(path, layer="aoi")
    pyogrio.write_dataframe(
        pd.DataFrame({"style": ["red"]}), path, layer="layer_styles", append=True
    )
    assert count(path) == 3600


@pytest.mark.parametrize("options", [{"mask": SMALL}, {}])
def test_a_layer_without_a_file_is_an_error(options: dict) -> None:
    with pytest.raises(SourceError, match="`mask_layer`"):
        open_scene(RASTER, mask_layer="aoi", **options)


def test_a_shapefile_without_its_index_names_it(tmp_path: Path) -> None:
    path = tmp_path / "lone [1].shp"
    gpd.GeoSeries([SMALL], crs=UTM).to_file(path)
    assert count(path) == 3600
    path.with_suffix(".shx").unlink()
    with pytest.raises(SourceError, match=r"index lone \[1\]\.shx is missing"):
        count(path)


def test_a_file_without_crs_is_in_the_rasters_coordinates_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "area.shp"
    gpd.GeoSeries([SMALL]).to_file(path)
    scene = open_scene(RASTER, mask=path)
    assert int(read_area(scene, SHAPE).sum()) == 3600
    (note,) = scene.notes
    assert "no CRS" in note


def test_a_curved_polygon_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "curved.csv"
    path.write_text(
        'id,WKT\n1,"CURVEPOLYGON(CIRCULARSTRING(500500 4999000, 501000 4999500, 501500 4999000, '
        '501000 4998500, 500500 4999000))"\n'
    )
    x, y = centres_of(TRANSFORM, SHAPE)
    circle = np.hypot(x - 501_000, y - 4_999_000) < 500
    # GDAL follows the arc in steps of 4 degrees.
    assert abs(count(path) - circle.sum()) < 0.005 * circle.sum()


# The mesh of an area


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_the_mesh_of_an_area_counts_exactly_its_pixels(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, SHAPE, dtype=np.uint8)
    use = Transformer.from_crs(UTM, 4326, always_xy=True).transform_bounds(
        *(500_000, 4_998_000, 502_000, 5_000_000)
    )
    area = random_polygon(rng, use)
    expected = expected_area(TRANSFORM, SHAPE, UTM, area, 4326)
    raster, mask = (image, TRANSFORM, UTM), gpd.GeoSeries([area], crs=4326)
    mesh = geomesh.mesh_raster(raster, mask=mask, min_hole=0, nodes=400)
    assert mesh.triangle_table["count"].sum() == expected.sum()
    assert mesh.certify().passed
    # The pixels of the area are kept with the mesh, and compared again.
    read = geomesh.read_mesh(mesh.to_file(tmp_path / "mesh.gpkg"))
    assert read.psnr(raster).pixels == expected.sum()


def test_an_area_gives_the_same_mesh_from_threads_and_processes() -> None:
    image = np.random.default_rng(5).integers(0, 255, (1200, 1300), dtype=np.uint8)
    raster = (image, Affine(10, 0, 500_000, 0, -10, 5_000_000), UTM)
    area = shapely.Point(506_000, 4_994_000).buffer(5500)
    options: dict[str, Any] = {"mask": area, "nodes": 500, "sift_upsample": False}
    here = geomesh.mesh_raster(raster, workers=1, **options)
    with ProcessPoolExecutor(2) as executor:
        there = geomesh.mesh_raster(raster, executor=executor, **options)
    assert np.array_equal(here.nodes, there.nodes)
    assert here.triangle_table["count"].sum() == there.triangle_table["count"].sum()
    x, y = centres_of(raster[1], image.shape)
    inside = shapely.intersects_xy(area, x, y)
    assert here.triangle_table["count"].sum() == inside.sum()


# The mask of pixels


@given(
    col=st.integers(0, 30),
    row=st.integers(0, 30),
    width=st.integers(1, 40),
    height=st.integers(1, 40),
    seed=st.integers(0, 99),
)
def test_a_pixel_mask_cuts_and_reads_and_is_stored(
    col: int, row: int, width: int, height: int, seed: int
) -> None:
    pixels = np.random.default_rng(seed).random((25, 37)) < 0.5
    mask = PixelMask.pack(Window(5, 7, 37, 25), pixels)
    whole = np.zeros((90, 90), bool)
    whole[7:32, 5:42] = pixels
    window = Window(col, row, width, height)
    np.testing.assert_array_equal(mask.read(window), whole[window.slices()])
    np.testing.assert_array_equal(mask.cut(window).read(window), whole[window.slices()])
    np.testing.assert_array_equal(
        PixelMask.from_text(mask.to_text())
        .move(1, 2)
        .read(Window(col + 1, row + 2, width, height)),
        whole[window.slices()],
    )


@pytest.mark.parametrize(
    "text", ["", "POLYGON((0 0, 1 1, 1 0))", "0 0 8 8 !", "0 0 9 9 eJwDAAAAAAE="]
)
def test_text_that_is_no_pixel_mask_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match="not a mask of pixels"):
        PixelMask.from_text(text)
