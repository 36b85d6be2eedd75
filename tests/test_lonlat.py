"""GeoJSON where longitude and latitude are not simple: rotated poles, poles, the antimeridian."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from pyproj import CRS, Transformer

import geomesh
from geomesh.errors import GeoreferenceError
from geomesh.formats.lonlat import LonLatLayer
from geomesh.io.write import write_mesh
from geomesh.raster.crs import LONLAT
from geomesh.raster.grid import Grid
from support.files import read_layer
from support.meshes import frame_mesh, lattice_mesh
from support.rasters import GEOSTATIONARY, MARS, picture

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh import Mesh
    from geomesh.parameters import LayerName

WIDTH, HEIGHT = 40, 30


def rotated_pole(latitude: float, longitude: float, turn: float = 0.0) -> CRS:
    return CRS.from_cf(
        {
            "grid_mapping_name": "rotated_latitude_longitude",
            "grid_north_pole_latitude": latitude,
            "grid_north_pole_longitude": longitude,
            "north_pole_grid_longitude": turn,
            "earth_radius": 6371000.0,
        }
    )


def shapes(mesh: Mesh, name: LayerName = "triangles", precision: int | None = None) -> np.ndarray:
    layer = LonLatLayer.of(mesh, name, precision)
    wkb = layer.geometry(slice(0, len(layer))).to_numpy(zero_copy_only=False)
    found: np.ndarray = shapely.from_wkb(wkb)
    return found


def share_of_wrong_pixels(mesh: Mesh, found: np.ndarray) -> float:
    """Return the share of pixels that are not in the polygon of the triangle that they are in.

    Only those whose centre is 0.3 pixels or more from its sides.
    """
    grid = mesh.grid
    x, y = np.meshgrid(np.arange(grid.width) + 0.5, np.arange(grid.height) + 0.5)
    centres = np.column_stack([x.ravel(), y.ravel()])
    triangles = shapely.polygons(mesh.nodes[mesh.triangles])
    pixel, triangle = shapely.STRtree(triangles).query(shapely.points(centres), "within")
    margin = shapely.distance(shapely.points(centres[pixel]), shapely.boundary(triangles[triangle]))
    pixel, triangle = pixel[margin > 0.3], triangle[margin > 0.3]
    to_lonlat = Transformer.from_crs(grid.crs, LONLAT, always_xy=True)
    lon, lat = to_lonlat.transform(*grid.to_map(centres[pixel]).T)
    lon = (np.array(lon) + 180) % 360 - 180
    inside = shapely.contains_xy(found[triangle], lon, lat)
    on_border = (np.abs(lon) > 180 - 1e-9) | (np.abs(lat) > 90 - 1e-9)
    return float((~inside & ~on_border).sum() / max(len(pixel), 1))


def check(mesh: Mesh, overlap: float = 1e-3) -> None:
    found = shapes(mesh)
    assert shapely.is_valid(found).all()
    assert not shapely.is_empty(found).any()
    bounds = np.array([shape.bounds for shape in [*found, *shapes(mesh, "edges")]])
    assert bounds[:, :2].min(axis=0).tolist() >= [-180, -90]
    assert (np.abs(bounds) <= (180, 90, 180, 90)).all()
    total = shapely.area(found).sum()
    assert shapely.union_all(found).area == pytest.approx(total, rel=overlap)
    assert share_of_wrong_pixels(mesh, found) <= 2 / (WIDTH * HEIGHT)


def pieces(found: np.ndarray) -> np.ndarray:
    parts: np.ndarray = shapely.get_parts(found)
    return parts


# Rotated poles and other maps


REGIONS = {
    "pole inside": (rotated_pole(6.55, 0), Affine(1.43, 0, -22.88, 0, -1.9, 26.84)),
    "south pole inside": (rotated_pole(-6, 100), Affine(1.43, 0, -28.6, 0, -1.9, 28.6)),
    "Europe": (rotated_pole(39.25, -162), Affine(1.1, 0, -28, 0, -1.4, 22)),
    "antimeridian": (rotated_pole(40, 10), Affine(1.43, 0, -28.6, 0, -1.9, 28.6)),
    "around the world": (rotated_pole(39.25, -162), Affine(9, 0, -180, 0, -6, 90)),
    "from 0 to 360": (rotated_pole(60, 30, 20), Affine(9, 0, 0, 0, -6, 90)),
    "south up": (rotated_pole(20, 30), Affine(1, 0, -20, 0, 1, 50)),
    "PROJ": (
        CRS("+proj=ob_tran +o_proj=longlat +o_lat_p=30 +lon_0=10 +type=crs"),
        Affine(2, 0, -40, 0, -2, 60),
    ),
    "polar stereographic": (CRS(3413), Affine(2e5, 0, -3.9e6, 0, -2e5, 3.1e6)),
    "mirrored": (CRS(2053), Affine(2e4, 0, -4e5, 0, -2e4, 3e6)),
}


@pytest.mark.parametrize("place", REGIONS)
@pytest.mark.parametrize("seed", [1, 2])
def test_triangles_are_where_their_pixels_are_and_do_not_overlap(place: str, seed: int) -> None:
    crs, transform = REGIONS[place]
    check(frame_mesh(Grid(WIDTH, HEIGHT, transform, crs), seed))


@pytest.mark.parametrize("place", REGIONS)
def test_a_mesh_of_two_triangles_is_right_too(place: str) -> None:
    crs, transform = REGIONS[place]
    mesh = frame_mesh(Grid(WIDTH, HEIGHT, transform, crs))
    corners = mesh.nodes[-4:]
    order = [[0, 1, 2], [0, 2, 3]] if not mesh.grid.flips else [[0, 2, 1], [0, 3, 2]]
    coarse = geomesh.Mesh(corners, np.array(order, np.int32), mesh.grid, mesh.domain)
    # The seam of a rotated world is a curve, followed from two sides.
    check(coarse, overlap=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_any_rotated_pole_is_right(seed: int) -> None:
    random = np.random.default_rng(seed)
    crs = rotated_pole(*random.uniform((-90, -180, -180), (90, 180, 180)))
    pixel = random.choice([0.05, 0.4, 1.2])
    turned = Affine.rotation(random.choice([0.0, random.uniform(0, 360)]))
    place = Affine.translation(*random.uniform((-150, -55), (150, 55)))
    transform = place @ turned @ Affine(pixel, 0, -20 * pixel, 0, -pixel, 0)
    check(frame_mesh(Grid(WIDTH, HEIGHT, transform, crs), seed))


def test_only_a_triangle_around_a_pole_is_wide(tmp_path: Path) -> None:
    crs, transform = REGIONS["pole inside"]
    mesh = frame_mesh(Grid(WIDTH, HEIGHT, transform, crs))
    found = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson")).geometry.values
    parts = pieces(found)
    wide = np.ptp(shapely.bounds(parts)[:, [0, 2]], axis=1) > 180
    assert shapely.bounds(parts)[wide, 3].tolist() == [90.0] * wide.sum()
    assert wide.sum() == 1


def test_ordinary_triangles_keep_three_corners() -> None:
    # 100 pixels of 10 m: the straight line is within a sixteenth of a pixel.
    mesh = lattice_mesh("EPSG:32633", Affine(1000, 0, 4e5, 0, -1000, 5e6), 10, 10)
    fine = Grid(1000, 1000, Affine(10, 0, 4e5, 0, -10, 5e6), CRS(32633))
    mesh = geomesh.Mesh(mesh.nodes * 100, mesh.triangles, fine, mesh.domain)
    assert (shapely.get_num_coordinates(shapes(mesh)) == 4).all()


def test_long_sides_follow_the_map() -> None:
    # The north side of a UTM zone's scene of 100 km is 130 m off the straight line.
    grid = Grid(10_000, 10_000, Affine(10, 0, 4e5, 0, -10, 7e6), CRS(32633))
    side = shapes(frame_mesh(grid), "edges")
    to_map = Transformer.from_crs(LONLAT, grid.crs, always_xy=True)
    for line in side:
        dense = shapely.get_coordinates(shapely.segmentize(line, 0.001))
        points = np.column_stack(to_map.transform(*dense.T))
        straight = shapely.LineString(points[[0, -1]])
        assert shapely.distance(straight, shapely.points(points)).max() < 10 / 8


# Beyond a pole


BEYOND = {
    "from -0.5": (4326, Affine(9, 0, -4.5, 0, -6, 93), 40, 31),
    "from 0": (4326, Affine(9, 0, 0, 0, -6, 93), 40, 31),
    "from -180": (4326, Affine(9, 0, -184.5, 0, -6, 93), 40, 31),
    "south up": (4326, Affine(9, 0, -4.5, 0, 6, -93), 40, 31),
    "one pole": (4326, Affine(1, 0, 170, 0, -1, 90.25), 40, 30),
    "NAD27": (4267, Affine(9, 0, -4.5, 0, -6, 93), 40, 31),
    "three axes": (4979, Affine(9, 0, -4.5, 0, -6, 93), 40, 31),
}


@pytest.mark.parametrize("place", BEYOND)
def test_pixels_on_a_pole_are_cut_there(place: str) -> None:
    code, transform, width, height = BEYOND[place]
    grid = Grid(width, height, transform, CRS(code))
    for mesh in (frame_mesh(grid), lattice_mesh(f"EPSG:{code}", transform, width, height)):
        check(mesh, overlap=1e-9)
        nodes = shapely.get_coordinates(shapes(mesh, "nodes"))
        assert np.abs(nodes).max(axis=0).tolist() <= [180, 90]
        assert (np.abs(nodes[:, 1]) == 90).any()
        if width * transform.a == 360:
            assert shapely.area(shapes(mesh)).sum() == pytest.approx(360 * 180)


def test_a_grid_of_more_than_a_turn_is_written_as_it_is() -> None:
    mesh = lattice_mesh("EPSG:4326", Affine(9, 0, -4.5, 0, -6, 93), 42, 31)
    found = shapes(mesh)
    assert shapely.is_valid(found).all()
    assert shapely.area(found).sum() == pytest.approx(42 * 9 * 180)
    wide = frame_mesh(Grid(120, 30, Affine(6, 0, -360, 0, -6, 90), CRS(4326)))
    assert shapely.is_valid(shapes(wide)).all()


ADVISED = {
    "rows beyond": Affine(1, 0, 0, 0, -1, 95),
    "a row beyond": Affine(1, 0, 0, 0, -1, 91),
    "in thirds": Affine(1 / 3, 0, -0.123, 0, -1 / 3, 91.3),
    "south": Affine(1, 0, 10, 0, -1, -90 + 40),
    "turned": Affine.rotation(10) @ Affine(1, 0, 0, 0, -1, 90),
}


@pytest.mark.parametrize("place", [*REGIONS, *BEYOND])
@pytest.mark.parametrize("precision", [0, 1, 2, 5])
def test_few_decimals_leave_valid_triangles_that_do_not_overlap(place: str, precision: int) -> None:
    crs, transform = REGIONS[place] if place in REGIONS else BEYOND[place][:2]
    for seed in (1, 2):
        mesh = frame_mesh(Grid(WIDTH, HEIGHT, transform, CRS(crs)), seed)
        found = shapes(mesh, "triangles", precision)
        assert shapely.is_valid(found).all()
        assert not shapely.is_empty(found).any()
        assert shapely.is_ccw(shapely.get_exterior_ring(pieces(found))).all()
        assert (np.abs(shapely.bounds(found)) <= (180, 90, 180, 90)).all()
        total = shapely.area(found).sum()
        assert shapely.union_all(found).area == pytest.approx(total, rel=1e-3)
        assert total == pytest.approx(shapely.area(shapes(mesh)).sum(), rel=0.02)


@pytest.mark.parametrize("place", ADVISED)
@pytest.mark.parametrize("crs", [CRS(4326), rotated_pole(40, 10)], ids=["plain", "rotated"])
def test_the_advised_bounds_work(tmp_path: Path, place: str, crs: CRS) -> None:
    source = (picture(rows=60, cols=60), ADVISED[place], crs)
    target = tmp_path / "mesh.geojson"
    with pytest.raises(GeoreferenceError, match="lie beyond a pole") as caught:
        write_mesh(geomesh.mesh_raster(source, nodes=100), target)
    assert "\n" not in str(caught.value)
    number = r"(-?[\d.]+)"
    numbers = re.search("`bounds` " + " ".join([number] * 4) + ", or", str(caught.value))
    assert numbers is not None
    west, south, east, north = map(float, numbers.groups())
    mesh = geomesh.mesh_raster(source, nodes=100, bounds=(west, south, east, north))
    write_mesh(mesh, target)
    _, lowest, _, highest = mesh.grid.bounds()
    if place != "turned":
        # No row that fits was lost.
        assert max(abs(lowest), abs(highest)) > 90 - abs(ADVISED[place].e)


# Refused, and the way out


OFF_EARTH = {
    "Mars": (CRS(MARS), Affine(0.1, 0, 10, 0, -0.1, 20)),
    "Mars, projected": (CRS("+proj=eqc +a=3396190 +b=3396190 +type=crs"), Affine.scale(1e3)),
    "Mars, rotated": (
        CRS("+proj=ob_tran +o_proj=longlat +o_lat_p=30 +lon_0=10 +a=3396190 +b=3396190 +type=crs"),
        Affine(0.1, 0, 10, 0, -0.1, 20),
    ),
    "building site": (CRS('LOCAL_CS["site",UNIT["metre",1]]'), Affine.scale(1, -1)),
}


@pytest.mark.parametrize("place", OFF_EARTH)
def test_off_the_earth_geojson_is_refused_and_a_geopackage_works(
    tmp_path: Path, place: str
) -> None:
    crs, transform = OFF_EARTH[place]
    mesh = geomesh.mesh_raster((picture(), transform, crs), nodes=50)
    with pytest.raises(GeoreferenceError, match=r"GeoJSON needs .* on Earth, .*: write .gpkg$"):
        write_mesh(mesh, tmp_path / "mesh.geojson")
    path = write_mesh(mesh, tmp_path / "mesh.gpkg")
    assert read_layer(path).crs.equals(crs, ignore_axis_order=True)


def test_off_the_disc_the_advised_bounds_work(tmp_path: Path) -> None:
    transform = Affine(2e5, 0, -6.4e6, 0, -2e5, 4.8e6)
    source = (picture(), transform, GEOSTATIONARY)
    with pytest.raises(GeoreferenceError, match="leave them out with `bounds` or `mask`"):
        write_mesh(geomesh.mesh_raster(source, nodes=50), tmp_path / "mesh.geojson")
    disc = shapely.Point(0, 0).buffer(5e6)
    for part in (
        {"bounds": (-3.5e6, -3.5e6, 3.5e6, 3.5e6)},
        {"mask": gpd.GeoSeries([disc], crs=GEOSTATIONARY)},
    ):
        mesh = geomesh.mesh_raster(source, nodes=50, **part)
        write_mesh(mesh, tmp_path / "mesh.geojson", overwrite=True)
        assert shapely.is_valid(shapes(mesh)).all()


def test_where_nothing_is_on_earth_no_crop_is_advised(tmp_path: Path) -> None:
    source = (picture(), Affine(1e4, 0, 6e6, 0, -1e4, 6e6), GEOSTATIONARY)
    with pytest.raises(GeoreferenceError, match=r"nodes have none: write .gpkg$"):
        write_mesh(geomesh.mesh_raster(source, nodes=50), tmp_path / "mesh.geojson")
