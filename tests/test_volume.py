"""Volumes and areas: against analytic solids, shapely, and sums over pixels."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Geod

import geomesh
from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.errors import GeomeshError
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.height import Height
from geomesh.raster.grid import Grid
from geomesh.raster.open import open_scene
from geomesh.terrain.prisms import prisms
from geomesh.terrain.volume import volume_above_level, volume_above_mesh, volume_above_pixels
from support.samples import SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from support.commands import Geomesh

UTM = Grid(100, 100, Affine(1, 0, 500_000, 0, -1, 4_000_100), CRS(32633))
DEM = SAMPLES / "rmnp_dem.tif"


def quiet(_fraction: float, _message: str) -> None:
    """Report nothing."""


def surface(nodes: Any, heights: Any, triangles: Any, grid: Grid = UTM, **about: Any) -> Mesh:
    """Return a mesh with heights from pixel coordinates."""
    corners = np.array(triangles, np.int32)
    return Mesh(
        np.array(nodes, float),
        corners[:, ::-1] if grid.flips else corners,
        grid,
        DomainFacts("image", 1.0, 1, 0, 1, 1),
        node_table=Table({"dem": np.array(heights, float)}),
        height=Height("dem", **about),
    )


def pyramid(height: float = 30.0, base: float = 0.0, grid: Grid = UTM, **about: Any) -> Mesh:
    """Return a pyramid on the square from 20 to 80."""
    return surface(
        [(20, 20), (80, 20), (80, 80), (20, 80), (50, 50)],
        [base] * 4 + [height],
        [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
        grid,
        **about,
    )


def random_surface(seed: int, count: int = 60, spread: float = 100.0) -> Mesh:
    """Return a surface of random nodes with random heights."""
    from scipy.spatial import Delaunay

    random = np.random.default_rng(seed)
    nodes = np.concatenate(
        [random.uniform(0, spread, (count, 2)), [(0, 0), (0, 100), (100, 0), (100, 100)]]
    )
    triangles = Delaunay(nodes).simplices
    (ux, uy), (vx, vy) = ((nodes[triangles[:, k]] - nodes[triangles[:, 0]]).T for k in (1, 2))
    turned = ux * vy < uy * vx
    triangles[turned] = triangles[turned][:, ::-1]
    return surface(nodes, random.uniform(-50, 50, len(nodes)), triangles)


def test_a_pyramid_has_the_volume_of_the_formula() -> None:
    whole = pyramid().volume(0.0)
    assert whole.cut == pytest.approx(60 * 60 * 30 / 3, rel=1e-12)
    assert (whole.fill, whole.fill_area, whole.missing_area) == (0, 0, 0)
    assert whole.cut_area == pytest.approx(3600, rel=1e-12)
    # Above a third of its height there is a pyramid of two thirds of its size.
    top = pyramid().volume(10.0)
    assert top.cut == pytest.approx(40 * 40 * 20 / 3, rel=1e-12)
    assert top.cut_area == pytest.approx(1600, rel=1e-12)
    assert top.net == pytest.approx(36_000 - 10 * 3600, abs=1e-8)
    assert top.fill == pytest.approx(top.cut - top.net, rel=1e-12)
    below = pyramid().volume(31.0)
    assert (below.cut, below.cut_area) == (0, 0)
    assert pyramid().volume().cut == pytest.approx(36_000)  # over its lowest point


def test_a_pyramid_has_the_surface_of_the_formula() -> None:
    mesh = pyramid()
    assert mesh.surface_area() == pytest.approx(4 * 60 * np.hypot(30, 30) / 2, rel=1e-12)
    table = mesh.attributes("triangles")
    assert table["slope"] == pytest.approx([45] * 4)
    assert sorted(table["aspect"]) == pytest.approx([0, 90, 180, 270])
    # The side to the top of the map falls to the north.
    middles = mesh.map_nodes[mesh.triangles].mean(axis=1)
    assert table["aspect"][np.argmax(middles[:, 1])] == pytest.approx(0, abs=1e-9)
    assert table["aspect"][np.argmax(middles[:, 0])] == pytest.approx(90)


def test_units_of_map_and_heights_become_metres() -> None:
    feet = Grid(100, 100, Affine(1, 0, 500_000, 0, -1, 4_000_100), CRS(2263))  # US survey feet
    foot = 1200 / 3937
    mesh = pyramid(grid=feet, unit="US survey foot", metres=foot)
    assert mesh.volume(0.0).cut == pytest.approx(36_000 * foot**3, rel=1e-9)
    assert mesh.attributes("triangles")["slope"] == pytest.approx([45] * 4)
    in_metres = pyramid(grid=feet)
    assert in_metres.volume(0.0).cut == pytest.approx(36_000 * foot**2, rel=1e-9)
    assert in_metres.attributes("triangles")["slope"] == pytest.approx(
        [np.degrees(np.arctan(1 / foot))] * 4
    )


def test_a_map_in_degrees_is_measured_on_the_ellipsoid() -> None:
    grid = Grid(100, 100, Affine(1e-4, 0, 10, 0, -1e-4, 60), CRS(4326))
    mesh = pyramid(grid=grid)
    ellipsoid = Geod(ellps="WGS84")
    ring = mesh.map_nodes[:4]
    area = abs(ellipsoid.polygon_area_perimeter(*ring.T)[0])
    assert mesh.volume(0.0).cut == pytest.approx(area * 10, rel=1e-9)
    apex = mesh.map_nodes[4]
    _, _, east = ellipsoid.inv(*apex, ring[1, 0], apex[1])
    _, _, north = ellipsoid.inv(*apex, apex[0], ring[1, 1])
    slopes = mesh.attributes("triangles")["slope"]
    expected = [np.degrees(np.arctan(30 / side)) for side in (north, east, north, east)]
    assert slopes == pytest.approx(expected, rel=1e-4)


@given(st.lists(st.floats(-100, 100), min_size=3, max_size=3), st.floats(0.1, 100))
def test_a_prism_is_cut_where_it_changes_its_sign(corners: list[float], area: float) -> None:
    (found,) = prisms(np.array([corners]), np.array([area]))
    # Many small triangles, each of which has nearly one sign.
    steps = 60
    i, j = np.triu_indices(steps)
    weights = np.concatenate(
        [
            np.column_stack([i + 1 / 3, j - i + 1 / 3]),
            np.column_stack([i + 2 / 3, j - i + 2 / 3])[i + (j - i) < steps - 1],
        ]
    )
    weights = np.column_stack([steps - weights.sum(axis=1), weights]) / steps
    heights = weights @ np.array(corners)
    part = area / len(heights)
    tolerance = 2 * area * np.ptp(corners) / steps**2 + 1e-9
    assert found[0] == pytest.approx(heights[heights > 0].sum() * part, abs=tolerance)
    assert found[1] == pytest.approx(-heights[heights < 0].sum() * part, abs=tolerance)
    assert found[0] - found[1] == pytest.approx(area * np.mean(corners), rel=1e-9, abs=1e-9)
    assert found[2] + found[3] == pytest.approx(area, rel=1e-12)


def test_a_corner_without_height_leaves_its_triangle_out() -> None:
    mesh = surface([(0, 0), (10, 0), (10, 10), (0, 10)], [np.nan, 5, 5, 5], [(0, 1, 3), (1, 2, 3)])
    for base in (0.0, pyramid_below()):
        found = mesh.volume(base)
        assert found.cut == pytest.approx(250, rel=1e-9)
        assert found.missing_area == pytest.approx(50, rel=1e-9)
    assert mesh.surface_area() == pytest.approx(50)


def pyramid_below() -> Mesh:
    """Return a flat square at height 0 under all of the grid."""
    corners = [(0, 0), (100, 0), (100, 100), (0, 100)]
    return surface(corners, [0] * 4, [(0, 1, 2), (0, 2, 3)])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_two_meshes_are_compared_as_shapely_does(seed: int) -> None:
    one, other = random_surface(seed, 12), random_surface(seed + 1, 9)
    found = volume_above_mesh(one, other, quiet)
    assert [found.cut, found.fill, found.cut_area, found.fill_area] == pytest.approx(
        by_shapely(one, other), rel=1e-8, abs=1e-6
    )
    assert found.missing_area == 0
    back = volume_above_mesh(other, one, quiet)
    assert (back.cut, back.fill) == pytest.approx((found.fill, found.cut), rel=1e-9)


def by_shapely(one: Mesh, other: Mesh) -> NDArray[np.float64]:
    """Return volumes and areas above and below, from polygons that shapely cuts."""

    def planes(mesh: Mesh) -> tuple[list[Any], NDArray[np.float64]]:
        corners = np.column_stack([mesh.map_nodes - (500_000, 4_000_000), mesh.heights])
        corners = corners[mesh.triangles]
        polygons = [shapely.Polygon(each[:, :2]) for each in corners]
        flat = np.concatenate([corners[..., :2], np.ones((len(corners), 3, 1))], axis=2)
        return polygons, np.linalg.solve(flat, corners[..., 2:])[..., 0]

    found = np.zeros(4)
    (polygons, own), (others, theirs) = planes(one), planes(other)
    for polygon, plane in zip(polygons, own, strict=True):
        for k, neighbour in enumerate(others):
            common = polygon.intersection(neighbour)
            if common.area < 1e-12:
                continue
            difference = plane - theirs[k]
            for sign, column in ((1, 0), (-1, 1)):
                part = common.intersection(half_plane(sign * difference))
                if part.area > 0:
                    x, y = part.centroid.coords[0]
                    found[column] += sign * part.area * (difference @ [x, y, 1])
                    found[column + 2] += part.area
    return found


def half_plane(plane: NDArray[np.float64]) -> Any:
    """Return a large rectangle in which a x + b y + c is positive."""
    a, b, c = plane
    length = np.hypot(a, b)
    normal, along = np.array([a, b]) / length, np.array([-b, a]) / length
    foot = -c / length * normal
    return shapely.Polygon(
        [
            foot - 1e4 * along,
            foot + 1e4 * along,
            foot + 1e4 * (along + normal),
            foot + 1e4 * (normal - along),
        ]
    )


def test_meshes_that_overlap_in_part_say_what_is_missing() -> None:
    left = surface([(0, 0), (60, 0), (60, 50), (0, 50)], [4, 4, 4, 4], [(0, 1, 2), (0, 2, 3)])
    right = surface([(40, 0), (90, 0), (90, 50), (40, 50)], [1, 1, 1, 1], [(0, 1, 2), (0, 2, 3)])
    found = left.volume(right)
    assert found.cut == pytest.approx(20 * 50 * 3, rel=1e-9)
    assert found.missing_area == pytest.approx(40 * 50, rel=1e-9)
    away = surface([(95, 95), (99, 95), (99, 99)], [1, 1, 1], [(0, 1, 2)])
    apart = left.volume(away)
    assert (apart.cut, apart.fill) == (0, 0)
    assert apart.missing_area == pytest.approx(3000)


@pytest.mark.parametrize("turn", [0, 30])
def test_pixels_are_prisms(turn: float) -> None:
    random = np.random.default_rng(8)
    values = random.uniform(-20, 60, (23, 31))
    values[3:6, 4:9] = np.nan
    transform = (
        Affine.translation(499_990, 4_000_110) @ Affine.rotation(-turn) @ Affine.scale(4, -5)
    )
    scene = open_scene((values, transform, CRS(32633)), nodata=np.nan)
    mesh = random_surface(3, 40)
    found = volume_above_pixels(mesh, scene, quiet)
    # The same pixels as a mesh: two flat triangles each.
    corners, triangles, heights = [], [], []
    for (row, col), value in np.ndenumerate(values):
        if np.isnan(value):
            continue
        first = len(corners)
        corners += [(col, row), (col + 1, row), (col + 1, row + 1), (col, row + 1)]
        heights += [value] * 4
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    grid = Grid(31, 23, transform, CRS(32633))
    steps = surface(corners, heights, triangles, grid)
    expected = volume_above_mesh(mesh, steps, quiet)
    assert found.to_dict() == pytest.approx(expected.to_dict(), rel=1e-9)
    assert found.missing_area > 0


@pytest.mark.parametrize("name", ["rmnp_dem.tif", "colorado_dem_float32_epsg4269.tif"])
def test_a_terrain_has_the_volume_of_its_pixels(name: str) -> None:
    mesh = geomesh.mesh_raster(SAMPLES / name, z=1, nodes="2%")
    with rasterio.open(SAMPLES / name) as dataset:
        heights, transform = dataset.read(1).astype(float), dataset.transform
    row = np.arange(heights.shape[0] + 1)
    # The area of each row of pixels on the ellipsoid.
    ellipsoid = Geod(ellps="WGS84")
    west, east = transform.c, transform.c + transform.a
    north = transform.f + transform.e * row
    areas = np.array(
        [
            abs(ellipsoid.polygon_area_perimeter([west, east, east, west], [a, a, b, b])[0])
            for a, b in itertools.pairwise(north)
        ]
    )
    level = float(heights.mean())
    expected = ((heights - level) * areas[:, None]).sum()
    found = mesh.volume(level)
    size = np.abs((heights - level) * areas[:, None]).sum()
    assert found.net == pytest.approx(expected, abs=1e-3 * size)
    assert found.cut + found.fill == pytest.approx(size, rel=0.02)
    # Over its own pixels, what is cut and what is filled are nearly the same.
    own = mesh.volume(SAMPLES / name)
    assert abs(own.net) < 1e-3 * size
    assert own.missing_area == 0


@pytest.mark.parametrize(
    ("transform", "crs"),
    [
        (Affine.identity(), None),
        (Affine(10, 0, 4e5, 0, 10, 4e6), 32613),
        (Affine(-10, 0, 4e5, 0, -10, 4e6), 32613),
        (Affine(8, 6, 4e5, 6, -8, 4e6), 32613),
    ],
    ids=["no CRS", "south up", "mirrored", "rotated"],
)
def test_volumes_over_bases_differ_by_the_volumes_of_the_bases(
    transform: Affine, crs: int | None
) -> None:
    y, x = np.mgrid[:60, :60]
    heights = 50 + 20 * np.sin(x / 9) * np.cos(y / 7)
    other = heights + np.random.default_rng(0).normal(3, 1, heights.shape)
    mesh = geomesh.mesh_raster((heights, transform, crs), z=1, nodes=200)
    base = geomesh.mesh_raster((other, transform, crs), z=1, nodes=90)
    above = mesh.volume(50).net
    assert mesh.volume(base).net == pytest.approx(above - base.volume(50).net, rel=1e-9)
    pixel = abs(transform.a * transform.e - transform.b * transform.d)
    expected = above - (other - 50).sum() * pixel
    assert mesh.volume((other, transform, crs)).net == pytest.approx(expected, rel=1e-8)


def test_what_cannot_be_measured_is_one_line() -> None:
    flat = geomesh.mesh_raster(SAMPLES / "olinda_landsat7_rgb_uint8.tif", nodes=100)
    with pytest.raises(GeomeshError, match="several bands: choose that of the heights with `z`"):
        flat.volume(10)
    for base, words in (
        (np.inf, "the base is inf"),
        (geomesh.mesh_raster(DEM, z=1, nodes=100), "reproject one of them"),
        ("nothing.tif", "no such file"),
    ):
        with pytest.raises(GeomeshError, match=words) as caught:
            pyramid().volume(base)
        assert "\n" not in str(caught.value)


def test_the_command_measures_too(command: Geomesh, tmp_path: Path) -> None:
    for name, nodes in (("a", "300"), ("b", "100")):
        made = command("mesh", DEM, "-o", tmp_path / f"{name}.gpkg", "--nodes", nodes, "--z", "1")
        assert made.code == 0, made.err
    mesh = geomesh.read_mesh(tmp_path / "a.gpkg")
    text = command("volume", tmp_path / "a.gpkg", "--base", "3000")
    assert f"{mesh.volume(3000).cut:,.1f} m3" in text.out
    assert "over 3,000 metres" in text.out
    for base, expected in (
        ("3000", mesh.volume(3000)),
        (tmp_path / "b.gpkg", mesh.volume(tmp_path / "b.gpkg")),
        (DEM, mesh.volume(DEM)),
    ):
        found = json.loads(command("volume", tmp_path / "a.gpkg", "--base", base, "--json").out)
        assert {name: found[name] for name in expected.to_dict()} == expected.to_dict()
        assert found["unit"] == "m3"
    lowest = json.loads(command("volume", tmp_path / "a.gpkg", "--json").out)
    assert lowest["base"] == mesh.heights.min()
    assert lowest["fill"] == 0
    assert (
        "choose that of the heights" not in command("volume", tmp_path / "a.gpkg", "--z", "1").err
    )
    assert command("volume", tmp_path / "a.gpkg", "--z", "5").code == 1


def test_a_level_and_a_flat_mesh_agree() -> None:
    mesh = random_surface(4)
    level = volume_above_level(mesh, 0.0)
    flat = volume_above_mesh(mesh, pyramid_below(), quiet)
    assert flat.to_dict() == pytest.approx(level.to_dict(), rel=1e-9)
