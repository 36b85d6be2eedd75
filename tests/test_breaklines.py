"""Breaklines: every line inside the domain becomes edges of a certified mesh."""

from __future__ import annotations

import time
import warnings
from typing import TYPE_CHECKING, Any

import cv2
import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

import geomesh
from geomesh.delaunay import triangulate
from geomesh.domain.breaklines import GAP, lay_breaklines, without_crossings
from geomesh.domain.loops import frame, subdivide
from geomesh.errors import GeomeshWarning, GeoreferenceError, RecipeError, SourceError
from geomesh.features import chains, detect
from geomesh.features.edge_pixels import EdgePixels
from geomesh.mesh.certify import certify
from geomesh.parallel.tiles import plan_tiles
from support.commands import run_program
from support.rasters import NORTH_UP, UTM, picture, write_raster
from support.samples import OLINDA, SAMPLES, fingerprint, write_mirrored

if TYPE_CHECKING:
    from pathlib import Path

ROWS, COLS = 150, 200
PRESETS = ("features", "adaptive")
# Simplified by a quarter of a pixel, and moved to a grid of half a pixel.
REACH = 0.25 + GAP * 2**0.5
LINE = shapely.LineString([(-20, 10), (90.3, 40.7), (120, 130), (60, 90), (60.2, 20)])


def made(lines: Any, data: np.ndarray | None = None, **options: Any) -> geomesh.Mesh:
    """Return the mesh of a raster in pixels, whose y runs down, with breaklines."""
    data = picture(1, ROWS, COLS) if data is None else data
    return geomesh.mesh_raster((data, Affine.identity(), None), breaklines=lines, **options)


def inner_constraints(mesh: geomesh.Mesh) -> np.ndarray:
    """Return the edges (L, 2, 2) of breaklines, in pixels."""
    edges = mesh.edges
    fixed = mesh.attributes("edges")["constrained"] & (edges.uses == 2)
    return mesh.nodes[edges.nodes[fixed]]


def fixed_edges(mesh: geomesh.Mesh) -> Any:
    """Return all constrained edges as one geometry, in pixels."""
    edges = mesh.edges.nodes[mesh.attributes("edges")["constrained"]]
    return shapely.multilinestrings(shapely.linestrings(mesh.nodes[edges]))


def outline_of(mesh: geomesh.Mesh) -> Any:
    triangles = shapely.polygons(mesh.nodes[mesh.triangles[:, [0, 1, 2, 0]]])
    return shapely.coverage_union_all(triangles)


def assert_followed(mesh: geomesh.Mesh, lines: Any, reach: float = REACH) -> None:
    """Assert that lines in pixels are edges inside the domain, and that other edges are not.

    A line may end at the outline up to half a pixel early, and short ends are left out.
    """
    assert mesh.certify().passed
    edges = fixed_edges(mesh)
    wanted = shapely.intersection(lines, outline_of(mesh))
    rest = shapely.difference(wanted, shapely.buffer(edges, reach))
    left = [part.length for part in shapely.get_parts(rest)]
    assert max(left, default=0) <= 2, left
    found = inner_constraints(mesh)
    away = shapely.difference(
        shapely.multilinestrings(list(found)), shapely.buffer(lines, 2 * reach)
    )
    assert away.length < 1e-6


# Geometry


def test_a_line_becomes_edges_with_their_own_kind_of_nodes() -> None:
    mesh = made(LINE, preset="features")
    assert_followed(mesh, LINE)
    kinds = mesh.node_table["kind"]
    on_line = np.unique(inner_constraints(mesh).reshape(-1, 2), axis=0)
    places = {tuple(node) for node in mesh.nodes[kinds == "breakline"]}
    border = {tuple(node) for node in mesh.nodes[kinds == "border"]}
    assert places <= set(map(tuple, on_line)) <= places | border
    assert np.isnan(mesh.node_table["response"][kinds == "breakline"]).all()
    assert (mesh.nodes * 256 == np.rint(mesh.nodes * 256)).all()
    facts = mesh.provenance.breaklines
    assert facts.lines >= 1
    # Feature nodes keep their distance.
    features = shapely.points(mesh.nodes[kinds == "feature"])
    distance = shapely.distance(features, shapely.multilinestrings(list(inner_constraints(mesh))))
    assert distance.min() >= 2


@pytest.mark.parametrize("closed", [False, True])
def test_a_closed_line_is_no_hole(closed: bool) -> None:
    ring = shapely.Point(90, 70).buffer(40)
    nested = shapely.union_all([ring.exterior, shapely.Point(90, 70).buffer(10).exterior])
    lines = shapely.MultiPolygon([ring, shapely.box(150, 10, 190, 60)]) if closed else nested
    mesh = made(lines)
    assert_followed(mesh, shapely.boundary(lines) if closed else lines)
    assert outline_of(mesh).area == ROWS * COLS


@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
@given(data=st.data())
def test_random_lines_on_random_data(data: Any) -> None:
    """Lines across each other, along the outline, and over nodata; coordinates in any place."""
    seed, step = data.draw(st.integers(0, 10**6)), data.draw(st.sampled_from(STEPS))
    image, lines = random_lines(seed, step)
    nodes, preset = (data.draw(st.sampled_from(choices)) for choices in ((None, 50), PRESETS))
    mesh = made(lines, image, nodata=0, nodes=nodes, preset=preset)
    assert_followed(mesh, shapely.union_all(lines), reach=2 * REACH)


STEPS = (1.0, 0.5, 1 / 256, 1e-6)


def random_lines(seed: int, step: float) -> tuple[np.ndarray, Any]:
    """Return an image with holes, and lines whose coordinates are multiples of `step`."""
    rng = np.random.default_rng(seed)
    image = rng.integers(1, 255, (1, 40, 50), dtype=np.uint8)
    for _ in range(rng.integers(0, 4)):
        centre = tuple(int(v) for v in rng.integers(0, 50, 2))
        cv2.ellipse(image[0], centre, tuple(rng.integers(1, 15, 2).tolist()), 30, 0, 360, 0, -1)
    lines = [
        shapely.LineString(np.rint(rng.uniform(-10, 60, (rng.integers(2, 8), 2)) / step) * step)
        for _ in range(rng.integers(1, 6))
    ]
    lines += [shapely.LineString([(-5, 0.3), (60, rng.uniform(0, 2))])]
    return image, shapely.multilinestrings(lines)


def test_angles_that_lines_near_each_other_make_small_are_told() -> None:
    image, lines = random_lines(156388, 0.5)
    with pytest.warns(geomesh.GeomeshWarning, match="too near to each other, angles of less than"):
        mesh = geomesh.mesh_raster((image, Affine.identity(), None), nodata=0, breaklines=lines)
    assert mesh.certify().passed
    assert mesh.certify().min_angle < 10


def test_lines_over_nodata_are_cut() -> None:
    data = picture(1, ROWS, COLS)
    data[:, 50:100, 80:120] = 0
    line = shapely.LineString([(10, 75.3), (190, 75.3)])
    mesh = made(line, data, nodata=0)
    assert_followed(mesh, line)
    pieces = inner_constraints(mesh)
    assert not ((pieces[..., 0] > 80) & (pieces[..., 0] < 120)).any()
    # Its nodes on the border of the hole do not move the border past a pixel's centre.
    assert mesh.triangle_table["count"].sum() == np.count_nonzero(data)


def test_lines_near_the_outline_and_through_its_corners() -> None:
    lines = shapely.multilinestrings(
        [
            [(0.2, 5), (0.3, 140)],
            [(-10, -10), (30, 30)],
            [(100, 149.9), (180, 150.3)],
            [(100, 149.2), (180, 149.2)],
            [(50, 20), (50, 0.3)],
            [(51, 20), (50.4, -0.3)],
        ]
    )
    assert_followed(made(lines), lines)


def test_hundreds_of_crossings() -> None:
    x, y = np.arange(5, 195, 8.3), np.arange(5, 145, 8.7)
    lines = [[(a, 2), (a + 3, 148)] for a in x] + [[(2, b), (198, b - 2)] for b in y]
    lines = shapely.multilinestrings(lines)
    mesh = made(lines, preset="features")
    assert_followed(mesh, lines)
    star = np.column_stack([np.cos(np.arange(0, 99) * 2.4), np.sin(np.arange(0, 99) * 2.4)])
    scribble = shapely.LineString(star * 60 + 70)
    assert_followed(made(scribble, preset="features"), scribble)


def test_duplicates_and_nearly_duplicates_are_one_line() -> None:
    line = shapely.LineString([(10, 10), (150, 100)])
    lines = [line, line, shapely.reverse(line), shapely.affinity.translate(line, 0.05, 0.1)]
    lines.append(shapely.LineString([(45, 32.5), (150, 100), (170, 120)]))
    mesh = made(shapely.multilinestrings(lines))
    assert_followed(mesh, shapely.union_all(lines))
    assert mesh.provenance.breaklines.length < 220


def test_a_million_vertices_take_seconds() -> None:
    t = np.linspace(0, 1, 1_000_000)
    noise = np.random.default_rng(0).normal(0, 0.03, len(t))
    y = 75 + 50 * np.sin(9 * t) + 4 * np.sin(180 * t) + noise
    line = shapely.LineString(np.column_stack([200 * t, y]))
    began = time.monotonic()
    mesh = made(line)
    assert time.monotonic() - began < 20
    assert mesh.provenance.breaklines.vertices < 1000
    assert mesh.certify().passed


@pytest.mark.parametrize(
    "line",
    [
        shapely.LineString([(500, 500), (900, 900)]),
        shapely.LineString([(50, 50), (50, 50)]),
        shapely.LineString([(50, 50), (50.3, 50.2)]),
        shapely.LineString([(-5, -5), (300, -5)]),
        shapely.LineString([(0, 0), (200, 0)]),
    ],
    ids=["far away", "of no length", "short", "outside", "on the frame"],
)
def test_lines_that_leave_nothing_inside_say_so(line: Any) -> None:
    with pytest.warns(GeomeshWarning, match="no breakline is inside the domain"):
        mesh = made(line)
    assert mesh.certify().passed
    assert not len(inner_constraints(mesh))
    assert mesh.provenance.breaklines.lines == 0


@pytest.mark.parametrize("preset", PRESETS)
def test_the_budget_counts_the_nodes_of_breaklines(preset: str) -> None:
    mesh = made(LINE, nodes=150, preset=preset)
    assert len(mesh.nodes) == 150
    with pytest.warns(GeomeshWarning, match="the outline and breaklines need .* than the 20 req"):
        made(shapely.Point(90, 70).buffer(40), nodes=20, preset=preset)


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_that_follow_the_raster(preset: str) -> None:
    assert_followed(made(LINE, preset=preset), LINE)
    assert_followed(made(LINE, preset=preset, domain="image"), LINE)


@pytest.mark.parametrize("options", [{"preset": "paper"}, {"domain": "hull"}, {"resize": (64, 64)}])
def test_meshes_that_do_not_follow_the_raster_are_refused(options: dict) -> None:
    with pytest.raises(RecipeError, match="`breaklines` needs a mesh that follows the pixels"):
        made(LINE, **options)


# Parts


def test_chains_meet_at_ends_only_and_keep_their_distance() -> None:
    rng = np.random.default_rng(1)
    lines = shapely.linestrings(rng.uniform(0, 100, (30, 4, 2)))
    laid = lay_breaklines(lines, frame(100, 100), 0.25)
    pieces = np.concatenate([np.stack([c[:-1], c[1:]], axis=1) for c in laid.chains])
    loop = laid.loops[0]
    outline = np.stack([loop, np.roll(loop, -1, axis=0)], axis=1)
    assert without_crossings(outline, pieces).all()
    nodes = shapely.points(np.unique(np.concatenate([pieces.reshape(-1, 2), loop]), axis=0))
    near = shapely.STRtree(nodes).query(nodes, predicate="dwithin", distance=0.3)
    assert (near[0] == near[1]).all()


def test_crossing_and_overlapping_pieces_are_found() -> None:
    outline = np.array([[(0, 0), (10, 0)]], float)
    pieces = np.array(
        [
            [(2, 0), (2, 5)],  # touches the outline between its ends
            [(10, 0), (10, 5)],
            [(9, 3), (11, 3)],  # crosses the one before
            [(10, 5), (12, 5)],
            [(10, 5), (20, 5)],  # lies on the one before
            [(12, 5), (12, 8)],
        ],
        float,
    )
    kept = without_crossings(outline, pieces)
    assert kept.tolist() == [False, True, False, True, False, True]


def test_an_open_line_is_divided_between_its_ends_only() -> None:
    from scipy.spatial import cKDTree

    line = np.array([(0.0, 0.0), (16.0, 0.0), (16.0, 4.0)])
    found = subdivide(line, 4.0, cKDTree([(8.0, 1.0)]), closed=False)
    assert found[0].tolist() == [0, 0]
    assert found[-1].tolist() == [16, 4]
    assert len(found) == 6


@given(seed=st.integers(0, 10**6))
def test_triangulations_with_lines_are_the_same_by_tiles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = np.array([(0, 0), (100, 0), (100, 100), (0, 100)], float)
    hole = 40 + ring / 5
    loose = np.rint(rng.uniform(1, 99, (300, 2)))
    loose = np.unique(loose[((loose < 39) | (loose > 61)).any(axis=1)], axis=0)
    lines = lay_breaklines(
        shapely.linestrings(rng.uniform(0, 100, (4, 3, 2))), [ring, hole[::-1]], 0.25
    )
    pieces = [np.stack([c[:-1], c[1:]], axis=1) for c in lines.chains]
    pieces = np.concatenate([np.empty((0, 2, 2)), *pieces])
    loops = [np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in lines.loops]
    tree = shapely.STRtree(shapely.linestrings(np.concatenate([*loops, pieces])))
    near, _ = tree.query(shapely.points(loose), predicate="dwithin", distance=0.5)
    loose = np.delete(loose, near, axis=0)
    every = np.concatenate([*loops, pieces]).reshape(-1, 2)
    points, place = np.unique(np.concatenate([every, loose]), axis=0, return_inverse=True)
    pairs = place.ravel()[: len(every)].reshape(-1, 2)
    count = sum(map(len, loops))
    whole = triangulate.constrained_delaunay(points, pairs[:count], lines=pairs[count:])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(triangulate, "TILED_ABOVE", 10)
        patch.setattr(triangulate, "TILE_POINTS", 60)
        parts = triangulate.constrained_delaunay(points, pairs[:count], lines=pairs[count:])
    np.testing.assert_array_equal(parts.triangles, whole.triangles)
    corners = points[whole.triangles]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2 == 10_000 - 400


def test_only_a_mesh_with_breaklines_may_have_inner_constraints() -> None:
    mesh = made(LINE, preset="features")  # with a certificate that says Delaunay
    facts = {
        "constraints": mesh.constraints,
        "plane_scale": mesh.plane_scale,
        "counter_clockwise": not mesh.grid.flips,
        "domain": mesh.domain,
    }
    assert certify(mesh.nodes, mesh.triangles, **facts, breaklines=True).passed
    assert not certify(mesh.nodes, mesh.triangles, **facts).passed
    # A part of the outline is no breakline.
    facts["constraints"] = mesh.constraints[1:]
    assert not certify(mesh.nodes, mesh.triangles, **facts, breaklines=True).passed


# What is given


def on_the_map(lines: Any) -> Any:
    with rasterio.open(OLINDA) as dataset:
        transform = dataset.transform
    return shapely.transform(lines, lambda xy: np.column_stack(transform @ tuple(xy.T)))


def utm_and(code: int) -> Any:
    with rasterio.open(OLINDA) as dataset:
        return Transformer.from_crs(dataset.crs, code, always_xy=True)


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    return inner_constraints(geomesh.mesh_raster(OLINDA, breaklines=on_the_map(LINE)))


@pytest.mark.parametrize(
    "kind", ["wkt", "series", "frame", "file", "text file", "3-D", "collection"]
)
def test_kinds_of_input(kind: str, expected: np.ndarray, tmp_path: Path) -> None:
    line = on_the_map(LINE)
    with rasterio.open(OLINDA) as dataset:
        series = gpd.GeoSeries([line], crs=dataset.crs.to_wkt())
    given: Any = {
        "wkt": line.wkt,
        "series": series,
        "frame": series.to_frame("geometry"),
        "3-D": shapely.force_3d(line, 7.0),
        "collection": shapely.GeometryCollection(
            [shapely.Point(0, 0), shapely.GeometryCollection([line])]
        ),
    }.get(kind)
    if kind == "file":
        given = tmp_path / "lines.gpkg"
        series.to_file(given, layer="coast")
        gpd.GeoSeries([shapely.Point(0, 0)], crs=4326).to_file(given, layer="other", mode="a")
    elif kind == "text file":
        given = str(tmp_path / "lines.geojson")
        series.to_crs(4326).to_file(given)
    options = {"breaklines_layer": "coast"} if kind == "file" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        mesh = geomesh.mesh_raster(OLINDA, breaklines=given, **options)
    if kind == "text file":  # 7 decimals, and the ends of the line are curves
        assert_followed(mesh, LINE)
    else:
        np.testing.assert_array_equal(inner_constraints(mesh), expected)
    name = mesh.provenance.breaklines.name
    assert name == (str(given) if "file" in kind else "breaklines")


@pytest.mark.parametrize("code", [4326, 3857, 32724])
def test_lines_in_another_crs_are_straight_there(code: int) -> None:
    """A few long segments: on the raster they are curves."""
    there = utm_and(code)
    west, south, east, north = geomesh.mesh_raster(OLINDA, nodes=50).grid.bounds()
    xy = np.array([(west - 5e5, south + 3000), (east + 4e5, north - 3000), (west, north + 1e5)])
    given = shapely.LineString(np.column_stack(there.transform(*xy.T)))
    mesh = geomesh.mesh_raster(OLINDA, breaklines=f"SRID={code};{given.wkt}")
    fine = shapely.segmentize(given, given.length / 200_000)
    back = np.column_stack(there.transform(*shapely.get_coordinates(fine).T, direction="INVERSE"))
    line = shapely.LineString(mesh.grid.to_pixel(back))
    assert_followed(mesh, line.intersection(shapely.box(-9, -9, 360, 360)), REACH + 0.25)
    assert len(inner_constraints(mesh)) > 10


def test_what_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "two.gpkg"
    for layer in ("coast", "roads"):
        gpd.GeoSeries([LINE], crs=UTM).to_file(path, layer=layer)
    for value, options, message in (
        (path, {}, "several layers, 'coast', 'roads': choose one with `breaklines_layer`"),
        (path, {"breaklines_layer": "x"}, "no layer 'x'.*with `breaklines_layer`"),
        (tmp_path / "none.gpkg", {}, "no such file"),
        (shapely.Point(1, 2), {}, "`breaklines` contains no line; give lines or polygons"),
        (5, {}, "`breaklines` is a int: give a file"),
        ("", {}, "`breaklines` is empty"),
        (None, {"breaklines_layer": "x"}, "`breaklines_layer` chooses a layer of `breaklines`"),
        ("canny", {"breaklines_layer": "x"}, "not of Canny edges"),
        (LINE, {"breaklines_layer": "x"}, "`breaklines` is not a file"),
        ("LINESTRING(0 0, nan 3)", {}, "not finite"),
        ('{"type": "LineString"}', {}, "`breaklines` is not valid GeoJSON"),
    ):
        with pytest.raises(SourceError, match=message):
            made(value, **options)
    with pytest.raises(GeoreferenceError, match="no CRS; georeference the raster, or give"):
        made("SRID=4326;LINESTRING(0 0, 1 1)")
    with pytest.raises(GeoreferenceError, match="no longitude and latitude; check the CRS of `bre"):
        geomesh.mesh_raster(
            OLINDA, breaklines={"type": "LineString", "coordinates": [(9e5, 1)] * 2}
        )


# Edges of the image


def test_canny_breaklines_follow_a_coast() -> None:
    """Two gray levels with noise, and a winding border between them."""
    x, y = np.meshgrid(np.arange(300), np.arange(300))
    land = x > 150 + 60 * np.sin(y / 40)
    noise = np.random.default_rng(3).normal(0, 6, land.shape)
    data = (np.where(land, 160, 60) + noise).astype(np.uint8)[None]
    mesh = made("canny", data, nodes=150)
    assert mesh.certify().passed
    rows = np.linspace(2, 298, 4000)
    coast = shapely.LineString(np.column_stack([150.5 + 60 * np.sin((rows - 0.5) / 40), rows]))
    edges = shapely.multilinestrings(list(inner_constraints(mesh)))
    assert coast.difference(edges.buffer(2.5)).length < 0.03 * coast.length
    assert mesh.provenance.breaklines.name == "canny"


def test_an_image_without_edges_says_so() -> None:
    with pytest.warns(GeomeshWarning, match="no edge of the image is long enough"):
        mesh = made("canny", np.full((1, 60, 60), 9, np.uint8))
    assert mesh.certify().passed


def test_canny_breaklines_do_not_depend_on_tiles_or_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mirrored(tmp_path / "large.tif", OLINDA.name, 1300, 400)
    options: dict[str, Any] = {"breaklines": "canny", "nodes": 3000}
    one, two = (geomesh.mesh_raster(path, workers=workers, **options) for workers in (1, 2))
    assert fingerprint(one) == fingerprint(two)
    assert len(inner_constraints(one)) > 100
    assert one.provenance.breaklines.vertices < 1000

    def small(extent: Any, **options: Any) -> Any:
        return plan_tiles(extent, **{"core": 256} | options)

    monkeypatch.setattr(detect, "plan_tiles", small)
    other = geomesh.mesh_raster(path, workers=2, **options)
    assert other.provenance.breaklines == one.provenance.breaklines


def test_chains_pass_branches_in_line_and_lose_spurs() -> None:
    image = np.zeros((120, 160), np.uint8)
    image[60, 10:150] = 1
    image[20:60, 80] = 1  # a branch
    image[61:65, 40] = 1  # a spur
    cv2.circle(image, (120, 95), 15, 1)
    place = np.flatnonzero(image).astype(np.int64)
    found = chains.follow_chains(EdgePixels(place, np.full(len(place), 7, np.uint16)), 160)
    ends = [(chain.xy[0].tolist(), chain.xy[-1].tolist()) for chain in found]
    assert ends[0] == ([10.5, 60.5], [149.5, 60.5])
    assert len(found[0].xy) == 140
    assert sorted(ends[1]) == [[80.5, 20.5], [80.5, 60.5]] or ends[1][0] == ends[1][1]
    assert len(found) == 3
    nothing = EdgePixels(place[:0], np.empty(0, np.uint16))
    assert chains.follow_chains(nothing, 160) == []


# Files and the command


def test_breaklines_are_kept_in_a_file_and_with_another_name_of_theirs(tmp_path: Path) -> None:
    path = write_raster(tmp_path, data=picture(3, ROWS, COLS))
    place = shapely.transform(LINE, lambda xy: np.column_stack(NORTH_UP @ tuple(xy.T)))
    lines = tmp_path / "lines.gpkg"
    gpd.GeoSeries([place], crs=UTM).to_file(lines)
    output = tmp_path / "mesh.gpkg"
    command = ("mesh", path, "-o", output, "--json", "--skip-existing")
    run = run_program(*command, "--breaklines", lines)
    assert run.code == 0, run.err
    mesh = geomesh.read_mesh(output)
    assert_followed(mesh, LINE)
    assert mesh.provenance.breaklines.name == str(lines)
    kinds = set(mesh.node_table["kind"])
    assert {"border", "breakline", "refined"} <= kinds
    assert "breaklines" in run_program("info", output).out
    lines = lines.rename(tmp_path / "renamed.gpkg")
    assert '"skipped": true' in run_program(*command, "--breaklines", lines).out
    for other in ((), ("--breaklines", "canny")):
        refused = run_program(*command, *other)
        assert "was made with other breaklines" in refused.err
    assert '"skipped": false' in run_program(*command, "--breaklines", "canny", "--overwrite").out
    assert '"skipped": true' in run_program(*command, "--breaklines", "canny").out


def test_a_batch_uses_the_same_breaklines_for_each_raster(tmp_path: Path) -> None:
    paths = [
        write_raster(tmp_path, f"{name}.tif", picture(3, ROWS, COLS)) for name in ("one", "two")
    ]
    place = shapely.transform(LINE, lambda xy: np.column_stack(NORTH_UP @ tuple(xy.T)))
    run = run_program("mesh", *paths, "-o", tmp_path / "made", "--breaklines", place.wkt)
    assert run.code == 0, run.err
    for name in ("one", "two"):
        assert_followed(geomesh.read_mesh(tmp_path / "made" / f"{name}.gpkg"), LINE)


def test_an_output_does_not_replace_the_breaklines(tmp_path: Path) -> None:
    path, lines = write_raster(tmp_path), tmp_path / "lines.gpkg"
    gpd.GeoSeries([LINE], crs=UTM).to_file(lines)
    run = run_program("mesh", path, "-o", lines, "--breaklines", lines, "--overwrite")
    assert "is the input" in run.error()
    error = run_program("mesh", path, "-o", tmp_path / "m.gpkg", "--breaklines-layer", "x").error()
    assert "--breaklines-layer chooses a layer of --breaklines" in error


def test_samples_with_nodata_edges() -> None:
    path = SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif"
    mesh = geomesh.mesh_raster(path, breaklines="canny")
    assert mesh.certify().passed
    assert len(inner_constraints(mesh))


def test_chains_of_stripes_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.zeros((300, 200), np.uint8)
    cv2.circle(image, (100, 150), 90, 1)
    image[:, 100] = 1
    place = np.flatnonzero(image).astype(np.int64)
    edges = EdgePixels(place, np.full(len(place), 7, np.uint16))
    whole = shapely.union_all([shapely.LineString(c.xy) for c in chains.follow_chains(edges, 200)])
    monkeypatch.setattr(chains, "_AT_ONCE", 300)
    parts = chains.follow_chains(edges, 200)
    assert len(parts) > 3
    assert shapely.equals(shapely.union_all([shapely.LineString(c.xy) for c in parts]), whole)
