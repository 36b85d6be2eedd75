"""Contours: against matplotlib, exact arithmetic on small meshes, and shapely."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from pyproj import CRS
from scipy.spatial import Delaunay

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import BandError, LevelError
from geomesh.mesh.height import Height
from geomesh.mesh.topology import build_edges
from geomesh.raster.grid import Grid
from geomesh.terrain import contours as module
from geomesh.terrain.contours import count_crossings, trace_contours
from geomesh.terrain.levels import plan_levels, round_interval
from support.meshes import frame_mesh, lattice_mesh, random_mesh
from support.samples import SAMPLES

DEMS = {"colorado_dem_float32_epsg4269.tif": 3, "rmnp_dem.tif": 10}


@pytest.fixture(scope="module", params=DEMS)
def dem_mesh(request):
    name = request.param
    return geomesh.mesh_raster(SAMPLES / name, z=1, max_error=DEMS[name] * 5, effort="fast")


def counter_clockwise(points, triangles):
    (ax, ay), (bx, by) = np.moveaxis(np.diff(points[triangles], axis=1), 0, -1)
    turned = triangles.copy()
    turned[ax * by - ay * bx < 0] = triangles[ax * by - ay * bx < 0][:, ::-1]
    return turned.astype(np.int32)


def delaunay(points):
    return counter_clockwise(points, Delaunay(points).simplices)


def trace(points, heights, triangles, levels):
    """Return the contours as (level, vertices, whether closed)."""
    points, heights = np.array(points, np.float64), np.array(heights, np.float64)
    triangles = np.array(triangles, np.int32).reshape(-1, 3)
    levels = np.array(levels, np.float64)
    found = trace_contours(points, heights, triangles, build_edges(triangles), levels)
    lines = np.split(found.places, found.offsets[1:-1]) if len(found.rank) else []
    return [
        (level, line, bool(closed))
        for level, line, closed in zip(levels[found.rank], lines, found.closed, strict=True)
    ]


def lengths(lines):
    total = Counter()
    for level, line, _ in lines:
        total[level] += np.hypot(*np.diff(line, axis=0).T).sum()
    return total


def by_matplotlib(points, heights, triangles, level):
    known = np.isfinite(heights[triangles]).all(axis=1)
    plan = Triangulation(*points.T, triangles, mask=~known)
    drawn = Figure().subplots().tricontour(plan, np.nan_to_num(heights), levels=[level])
    return [line for line in drawn.allsegs[0] if len(line)]


def assert_like_matplotlib(points, heights, triangles, levels):
    lines = trace(points, heights, triangles, levels)
    ours = lengths(lines)
    assert ours
    for level in levels:
        theirs = by_matplotlib(points, heights, triangles, level)
        expected = sum(np.hypot(*np.diff(line, axis=0).T).sum() for line in theirs)
        assert ours[level] == pytest.approx(expected, rel=1e-9)
        if level in heights:
            continue
        mine = [line for at, line, _ in lines if at == level]
        assert len(mine) == len(theirs)
        one, other = (
            np.unique(np.concatenate([*some, np.empty((0, 2))]).round(7), axis=0)
            for some in (mine, theirs)
        )
        np.testing.assert_allclose(one, other, atol=2e-7)


@pytest.mark.parametrize("seed", range(5))
def test_like_matplotlib_on_random_meshes(seed):
    random = np.random.default_rng(seed)
    points = random.uniform(0, 100, (400, 2))
    heights = random.normal(0, 10, 400)
    heights[:3] = np.nan
    assert_like_matplotlib(points, heights, delaunay(points), [-12.5, -3, 0.1, 4, 9.75])


def test_like_matplotlib_on_dems(dem_mesh):
    low, high = np.nanquantile(dem_mesh.heights, [0.01, 0.99])
    levels = plan_levels(low, high).values
    assert 10 <= len(levels) <= 21
    assert_like_matplotlib(dem_mesh.map_nodes, dem_mesh.heights, dem_mesh.triangles, levels)


def test_contours_of_dems_never_cross(dem_mesh):
    lines = dem_mesh.contours(10)
    geometry = lines.geometry.to_numpy()
    assert shapely.is_simple(geometry).all()
    assert shapely.is_valid(geometry).all()
    assert (shapely.is_closed(geometry) == lines["closed"]).all()
    assert_apart(lines["level"].to_numpy(), geometry)
    places, line = shapely.get_coordinates(geometry, include_z=True, return_index=True)
    assert (places[:, 2] == lines["level"].to_numpy()[line]).all()


def assert_apart(level, geometry):
    """Check that lines of one level have at most single points in common, others nothing."""
    one, other = shapely.STRtree(geometry).query(geometry, predicate="intersects")
    one, other = one[one < other], other[one < other]
    assert (level[one] == level[other]).all()
    common = shapely.intersection(geometry[one], geometry[other])
    assert (shapely.get_dimensions(common) == 0).all()


def exact_segments(points, heights, triangles, level):
    """Return the segments of a level with exact arithmetic, without pairs that go and return."""
    level, found = Fraction(level), Counter()
    for corners in triangles:
        ends = []
        for a, b in zip(corners, np.roll(corners, -1), strict=True):
            low, high = Fraction(heights[a]), Fraction(heights[b])
            if (low < level) != (high < level):
                share = (level - low) / (high - low)
                ends.append(
                    tuple(
                        float(Fraction(p) + share * (Fraction(q) - Fraction(p)))
                        for p, q in zip(points[a], points[b], strict=True)
                    )
                )
        if len(set(ends)) == 2:
            found[frozenset(tuple(np.round(end, 9)) for end in ends)] += 1
    assert max(found.values(), default=1) <= 2
    return {segment for segment, count in found.items() if count == 1}


def assert_never_crossing_at_nodes(lines):
    """Check that no line goes from one side of another to its other side where they touch."""
    passes = {}
    for _, line, closed in lines:
        steps = np.diff(line, axis=0)
        angles = np.arctan2(steps[:, 1], steps[:, 0])
        for k in range(len(steps)):
            if k or closed:
                back, on = angles[k - 1] + np.pi, angles[k]
                passes.setdefault(tuple(line[k]), []).append((back, on))
    for through in passes.values():
        for k, (back, on) in enumerate(through):
            between = (on - back) % (2 * np.pi)
            for one, other in through[k + 1 :]:
                inside = [(end - back) % (2 * np.pi) < between for end in (one, other)]
                assert inside[0] == inside[1]


@settings(max_examples=150, deadline=None)
@given(
    heights=st.lists(st.integers(0, 3), min_size=20, max_size=20),
    flips=st.lists(st.booleans(), min_size=12, max_size=12),
)
def test_small_meshes_with_many_ties(heights, flips):
    x, y = np.meshgrid(np.arange(5), np.arange(4))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    triangles = []
    for k, flip in enumerate(flips):
        a = k // 4 * 5 + k % 4
        b, c, d = a + 1, a + 6, a + 5
        triangles += [(a, b, d), (b, c, d)] if flip else [(a, b, c), (a, c, d)]
    triangles = np.array(triangles)
    levels = [0, 0.5, 1, 2, 2.25, 3]
    lines = trace(points, heights, triangles, levels)
    outer = {tuple(points[node]) for node in np.flatnonzero((x % 4 == 0) | (y % 3 == 0))}
    for level in levels:
        of_level = [line for at, line, _ in lines if at == level]
        segments = [
            frozenset(tuple(np.round(end, 9)) for end in pair)
            for line in of_level
            for pair in pairwise(line)
        ]
        assert len(set(segments)) == len(segments)
        assert set(segments) == exact_segments(points, heights, triangles, level)
    geometry = np.array([shapely.LineString(line) for _, line, _ in lines], object)
    assert shapely.is_simple(geometry).all()
    assert_apart(np.array([level for level, _, _ in lines]), geometry)
    assert_never_crossing_at_nodes(lines)
    for _, line, closed in lines:
        assert closed == (line[0] == line[-1]).all()
        if not closed:
            for px, py in (line[0], line[-1]):
                assert (px, py) in outer or px in (0, 4) or py in (0, 3)


def test_higher_ground_is_to_the_left():
    points = [(0, 0), (4, 0), (4, 4), (0, 4), (2, 2)]
    triangles = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    ((_, hill, closed),) = trace(points, [0, 0, 0, 0, 10], triangles, [5])
    assert closed
    assert shapely.LinearRing(hill).is_ccw
    assert len(hill) == 5
    ((_, pit, _),) = trace(points, [10, 10, 10, 10, 0], triangles, [5])
    assert not shapely.LinearRing(pit).is_ccw


def test_one_triangle():
    corner = [(0, 0), (1, 0), (0, 1)]
    ((level, line, closed),) = trace(corner, [0, 0, 10], [0, 1, 2], [5])
    assert (level, closed) == (5, False)
    assert line.tolist() == [[0.5, 0.5], [0, 0.5]] or line.tolist() == [[0, 0.5], [0.5, 0.5]]
    assert trace(corner, [0, 0, 10], [0, 1, 2], [-1, 0, 10, 11]) == []  # 10 is a single point
    ((_, edge, _),) = trace(corner, [10, 10, 0], [0, 1, 2], [10])
    assert sorted(edge.tolist()) == [[0, 0], [1, 0]]


HEXAGON = [(0, 0), (2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2)]
FAN = [(0, k, k % 6 + 1) for k in range(1, 7)]


def test_a_saddle_on_a_level_has_lines_that_touch():
    lines = trace(HEXAGON, [5, 9, 1, 9, 1, 9, 1], FAN, [5])
    assert len(lines) == 3
    assert all([0, 0] in line.tolist() for _, line, _ in lines)
    assert_never_crossing_at_nodes(lines)
    lines = trace(HEXAGON, [5, 9, 1, 9, 1, 9, 1], FAN, [5.5])
    assert len(lines) == 3


def test_peaks_pits_ridges_and_plateaus_on_a_level():
    assert trace(HEXAGON, [5, *[1] * 6], FAN, [5]) == []  # a peak
    assert trace(HEXAGON, [1, *[5] * 6], FAN, [1]) == []  # a pit
    assert trace(HEXAGON, [5, 5, 1, 1, 5, 1, 1], FAN, [5]) == []  # a ridge
    assert trace(HEXAGON, [5] * 7, FAN, [4, 5, 6]) == []  # flat
    ((_, shore, closed),) = trace(HEXAGON, [5, 5, 5, 1, 1, 1, 1], FAN, [5])  # a plateau
    assert not closed
    assert sorted(shore.tolist()) == sorted(map(list, (HEXAGON[1], HEXAGON[0], HEXAGON[2])))


def test_two_hills_joined_by_a_level_ridge_are_two_rings():
    x, y = np.meshgrid(np.arange(8), np.arange(5))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    heights = np.zeros((5, 8))
    heights[2, 1:7] = 5
    heights[2, [1, 6]] = 9
    lines = trace(points, heights.ravel(), delaunay(points + [0, 0.001] * points[:, :1]), [5])
    assert len(lines) <= 2
    for _, line, closed in lines:
        assert closed
        assert shapely.Polygon(line).is_valid


def test_a_level_beside_a_node_by_the_rounding_of_a_factor():
    """Heights in feet as metres are beside their level by a unit in the last place."""
    points = np.array(HEXAGON) + np.array([5e5, 4.2e6])
    heights = np.array([100, 100, 50, 50, 100, 50, 50]) * 0.3048
    for level in (np.nextafter(30.48, 0), 30.48, np.nextafter(30.48, 99)):
        assert trace(points, heights, FAN, [level]) == []


def test_voids_end_lines():
    random = np.random.default_rng(3)
    points = random.uniform(0, 10, (200, 2))
    heights = points[:, 0].copy()
    inside = np.hypot(*(points - 5).T) < 1
    heights[inside] = np.nan
    triangles = delaunay(points)
    known = np.isfinite(heights[triangles]).all(axis=1)
    area = shapely.union_all(shapely.polygons(points[triangles[known]]))
    lines = trace(points, heights, triangles, [5])
    assert len(lines) == 2
    for _, line, closed in lines:
        assert not closed
        assert area.buffer(1e-9).covers(shapely.LineString(line))
        ends = shapely.points(line[[0, -1]])
        assert (shapely.distance(area.boundary, ends) < 1e-9).all()
    assert trace(points, np.full(200, np.nan), triangles, [5]) == []


def test_levels_together_and_apart_give_the_same_lines(monkeypatch):
    mesh = random_mesh()
    heights = np.random.default_rng(1).normal(0, 50, len(mesh.nodes)).round()
    levels = np.arange(-90.0, 90, 3)
    arguments = mesh.map_nodes, heights, mesh.triangles, mesh.edges, levels
    whole = trace_contours(*arguments)
    monkeypatch.setattr(module, "_AT_ONCE", 100)
    told = []
    parts = trace_contours(*arguments, lambda share, text: told.append((share, text)))
    for one, other in zip(whole, parts, strict=True):
        assert np.array_equal(one, other)
    assert len(told) > 10
    assert "60 levels" in told[0][1]
    # Those of closed lines are repeated at the end; at nodes several crossings are one vertex.
    assert len(whole.places) <= count_crossings(heights, mesh.edges, levels) + whole.closed.sum()


# Levels.


@pytest.mark.parametrize("extent", [*np.geomspace(1e-6, 1e7, 200), 1, 10, 1980, 1e-300, 1e300])
def test_a_round_interval_fits_ten_to_twenty_times(extent):
    interval = round_interval(extent)
    assert extent / interval * (1 + 1e-12) >= 10
    assert extent / interval <= 20 * (1 + 1e-12)
    assert f"{interval:.6e}"[:4] in ("1.00", "2.00", "2.50", "5.00")


def test_levels_are_decimals():
    planned = plan_levels(0.05, 0.75, interval=0.1)
    assert planned.values.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    assert planned.is_index.tolist() == [False] * 4 + [True] + [False] * 2
    planned = plan_levels(-37, 12, interval=10, base=3, index=2)
    assert planned.values.tolist() == [-27, -17, -7, 3]  # a level at the lowest node has no line
    assert planned.is_index.tolist() == [False, True, False, True]
    assert plan_levels(0, 10, levels=[1, 2, 3, 4], index=3).is_index.tolist() == [
        *[True, False, False, True]
    ]
    assert not plan_levels(0, 100, interval=1, index=0).is_index.any()
    assert plan_levels(0, 30, interval=10).values.tolist() == [10, 20, 30]
    assert len(plan_levels(5, 5, interval=10).values) == 0
    assert len(plan_levels(np.nan, np.nan).values) == 0
    assert len(plan_levels(0, 10_000, interval=1).values) == 10_000


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"interval": 0}, "`interval` is 0: give a height above 0, such as 10"),
        ({"interval": -5}, "`interval` is -5: "),
        ({"interval": np.nan}, "`interval` is nan: "),
        ({"interval": np.inf}, "`interval` is inf: "),
        ({"base": np.inf}, "`base` is inf: give a height, such as 0"),
        ({"base": np.nan}, "`base` is nan: "),
        ({"levels": []}, "`levels` is empty: give heights such as 100,200,500"),
        ({"levels": [1, np.nan]}, "`levels` has nan: "),
        ({"levels": [1, 3, 2]}, "`levels` has 3 before 2: give them in rising order"),
        ({"levels": [1, 2, 2]}, "`levels` has 2 twice: give each height once"),
        ({"levels": np.arange(10_001)}, "`levels` has 10,001 heights: give at most 10,000"),
        ({"levels": [1], "interval": 1}, "`levels` and `interval` were both given"),
        ({"index": -1}, "`index` is -1: give 5 for every fifth level, or 0 for none"),
        (
            {"interval": 0.01},
            "`interval` is 0.01, which gives 198000 levels for heights from 100 to 2080, and at "
            "most 10,000 are possible: try 100",
        ),
        ({"interval": 5e-324}, "at most 10,000 are possible"),
    ],
)
def test_bad_levels(options, told):
    with pytest.raises(LevelError) as caught:
        plan_levels(100.0, 2080.0, **options)
    assert told in str(caught.value)


# The mesh, its table and its file.


def hills(grid=None, **changes):
    """Return a mesh with heights from -50 to 50."""
    mesh = frame_mesh(grid or Grid(50, 40, Affine(10, 0, 500_000, 0, -10, 7e6), CRS(32723)))
    x, y = mesh.nodes.T
    heights = 50 * np.sin(x / 9) * np.cos(y / 7)
    table = mesh.node_table.with_columns({"b1": heights})
    return replace(mesh, node_table=table, height=Height("b1"), **changes)


def test_contours_of_a_mesh():
    mesh = hills()
    lines = mesh.contours(10)
    assert list(lines.columns) == ["level", "index", "closed", "length", "geometry"]
    assert [lines[name].dtype.kind for name in ("level", "index", "closed", "length")] == [*"fbbf"]
    assert lines.crs == mesh.grid.crs
    assert lines["level"].is_monotonic_increasing
    assert set(lines["level"]) <= set(range(-50, 60, 10))
    assert (lines["index"] == (lines["level"] % 50 == 0)).all()
    np.testing.assert_allclose(lines["length"], lines.length, rtol=1e-12)
    assert set(lines.geom_type) == {"LineString"}
    assert lines.has_z.all()
    assert set(mesh.contours(levels=[-7.5, 3])["level"]) == {-7.5, 3}
    assert set(mesh.contours(25, base=5)["level"]) == {-20, 5, 30}
    assert 10 <= mesh.contours()["level"].nunique() <= 20


def test_length_is_in_metres():
    degrees = Grid(50, 40, Affine(0.01, 0, -44, 0, -0.01, -22), CRS("EPSG:4326"))
    lines = hills(degrees).contours(20)
    geod = CRS("EPSG:4326").get_geod()
    expected = [geod.geometry_length(line) for line in lines.geometry]
    np.testing.assert_allclose(lines["length"], expected, rtol=1e-3)
    feet = Grid(50, 40, Affine(10, 0, 0, 0, -10, 0), CRS("EPSG:2263"))
    lines = hills(feet).contours(20)
    np.testing.assert_allclose(lines["length"], lines.length * 1200 / 3937, rtol=1e-9)


def test_flat_meshes_have_no_contours():
    mesh = hills()
    flat = replace(mesh, node_table=Table({"b1": np.full(len(mesh.nodes), 7.0)}))
    for lines in (flat.contours(), flat.contours(7), flat.contours(levels=[7])):
        assert lines.empty
        assert lines.crs == mesh.grid.crs


def test_a_mesh_without_heights_takes_its_only_band():
    mesh = hills()
    assert len(replace(mesh, height=None).contours(10)) == len(mesh.contours(10))
    with pytest.raises(BandError, match="no values at its nodes"):
        replace(mesh, height=None, node_table=Table({})).contours()


def test_too_many_vertices_are_refused(monkeypatch):
    monkeypatch.setattr("geomesh.terrain.contour_frame._MOST_VERTICES", 50)
    with pytest.raises(LevelError, match=r"would have .* vertices, .* try an `interval` of"):
        hills().contours(5)


def written(mesh, folder, name="mesh.gpkg"):
    path = folder / name
    mesh.to_file(path)
    return path


def read(path):
    return gpd.read_parquet(path) if path.suffix == ".parquet" else gpd.read_file(path)


@pytest.fixture
def run(command):
    def checked(*arguments, code=0):
        done = command(*arguments)
        assert done.code == code, done
        return done

    return checked


def test_the_command_writes_each_format(run, tmp_path):
    mesh = hills()
    path, expected = written(mesh, tmp_path), mesh.contours(20, index=2)
    for extension in (".gpkg", ".geojson", ".fgb", ".parquet"):
        out = tmp_path / f"contours{extension}"
        done = run("contours", path, "-o", out, "--interval", "20", "--index", "2")
        assert done.out.splitlines() == [
            f"{out}: {len(expected)} lines at 5 levels from -40 to 40 m, interval 20 m"
        ]
        lines = read(out).sort_values("id")
        for name in ("level", "index", "closed"):
            assert (lines[name].to_numpy() == expected[name].to_numpy()).all()
        assert lines.has_z.all()
        if extension == ".geojson":
            lines = lines.to_crs(mesh.grid.crs)
            document = json.loads(out.read_text())
            assert document["geomesh"]["contours"]["unit"] == "metre"
            assert "crs" not in document
        assert lines.crs.to_2d() == mesh.grid.crs
        tolerance = 0.02 if extension == ".geojson" else 0
        far = shapely.hausdorff_distance(lines.geometry.to_numpy(), expected.geometry.to_numpy())
        assert far.max() <= tolerance
        run("contours", path, "-o", out, code=1)
    about = pyogrio.read_info(tmp_path / "contours.gpkg")
    assert about["geometry_type"] == "LineString Z"
    document = json.loads(about["layer_metadata"]["geomesh"])
    assert document["contours"]["interval"] == 20
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        *(f"contours{extension}" for extension in (".fgb", ".geojson", ".gpkg", ".parquet")),
        "mesh.gpkg",
    ]


def test_the_command_tells_what_it_does(run, tmp_path):
    path, out = written(hills(), tmp_path), tmp_path / "c.gpkg"
    told = json.loads(run("contours", path, "-o", out, "--json", "--levels", "-10,5").out)
    (result,) = told["results"]
    assert (result["levels"], result["lowest"], result["highest"]) == (2, -10, 5)
    assert (result["interval"], result["unit"]) == (None, "metre")
    done = run("contours", path, "-o", out, "--overwrite")
    assert "(chosen: give another with --interval)" in done.out
    feet = ("--z", "b1", "--z-factor", "3.2808333333333333")
    done = run("contours", path, "-o", out, "--overwrite", *feet)
    assert " us-ft, interval 25 us-ft" in done.out
    events = [
        json.loads(line)
        for line in run(
            *("contours", path, "-o", out, "--overwrite", "--progress", "jsonl")
        ).out.splitlines()
    ]
    assert events[0]["command"] == "contours"
    assert any("levels" in event.get("message", "") for event in events)
    assert events[-1]["event"] == "result"
    done = run("contours", path, "-o", out, "--overwrite", "--levels", "900")
    assert "no contours: no level lies between the heights -" in done.out


def test_an_empty_layer_is_written(run, tmp_path):
    mesh = hills()
    flat = replace(
        mesh,
        node_table=mesh.node_table.with_columns({"b1": np.full(len(mesh.nodes), 7.0)}),
    )
    path = written(flat, tmp_path)
    for extension in (".gpkg", ".geojson", ".fgb", ".parquet"):
        out = tmp_path / f"none{extension}"
        done = run("contours", path, "-o", out)
        assert done.out.splitlines() == [f"{out}: no contours: the mesh is flat, at 7 m"]
        assert len(read(out)) == 0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--interval", "0"], "--interval is 0: give a height above 0"),
        (["--interval", "0.00001"], "at most 10,000 are possible: try 5"),
        (["--base", "inf"], "--base is inf: "),
        (["--levels", ""], "--levels is empty: "),
        (["--levels", "3,2"], "--levels has 3 before 2: "),
        (["--z", "nope"], "the mesh has no band 'nope' for --z; it has 1 (b1)"),
    ],
)
def test_bad_input_is_one_line(run, tmp_path, arguments, told):
    path, out = written(hills(), tmp_path), tmp_path / "c.gpkg"
    assert told in run("contours", path, "-o", out, *arguments, code=1).error()
    assert list(tmp_path.iterdir()) == [path]


def test_bad_files_are_one_line(run, tmp_path):
    path = written(hills(), tmp_path)
    done = run("contours", path, "-o", tmp_path / "c.nc", code=1)
    assert "choose from .gpkg, .geojson, .fgb, .parquet" in done.error()
    assert "is the input" in run("contours", path, "-o", path, "--overwrite", code=1).error()
    assert run("contours", path, "-o", tmp_path / "c.gpkg", "--levels", "a", code=2).err


# Longitude and latitude.


def lifted(mesh):
    heights = np.sin(mesh.nodes[:, 0] / 3.1) * np.cos(mesh.nodes[:, 1] / 2.3) * 10
    return replace(mesh, node_table=Table({"b1": heights}), height=Height("b1"))


@pytest.mark.parametrize(
    ("crs", "transform"),
    [
        ("EPSG:4326", Affine(1, 0, 170, 0, -1, 10)),
        ("EPSG:32660", Affine(20_000, 0, 500_000, 0, -20_000, 2e6)),
        ("EPSG:3995", Affine(100_000, 0, -1e6, 0, -100_000, 1e6)),
    ],
)
def test_geojson_is_cut_at_the_antimeridian(crs, transform):
    from geomesh.formats.lonlat_lines import to_lonlat_lines

    mesh = lifted(lattice_mesh(crs, transform))
    lines = geomesh.Mesh.of(mesh).contours(2.5)
    found = to_lonlat_lines(mesh, lines.geometry.to_numpy())
    assert shapely.has_z(found).all()
    assert "MultiLineString" in set(gpd.GeoSeries(found).geom_type)
    west, south, east, north = shapely.bounds(found).T
    assert west.min() >= -180
    assert east.max() <= 180
    assert np.abs([south, north]).max() <= 90
    places, line = shapely.get_coordinates(found, include_z=True, return_index=True)
    assert (places[:, 2] == lines["level"].to_numpy()[line]).all()
    # No piece jumps around the world, and none is lost.
    pieces = shapely.get_parts(found)
    geod = CRS("EPSG:4326").get_geod()
    length = sum(geod.geometry_length(piece) for piece in pieces)
    steps = [np.abs(np.diff(shapely.get_coordinates(piece)[:, 0])).max() for piece in pieces]
    assert max(steps) < 180
    if crs == "EPSG:4326":
        assert length == pytest.approx(lines["length"].sum(), rel=2e-3)
        assert max(steps) < 1.5
