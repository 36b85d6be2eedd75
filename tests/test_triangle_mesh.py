"""Mesh: an immutable value, and its layers on the map."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import FrozenInstanceError, replace
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from pyproj import CRS, Geod
from scipy import sparse

from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.errors import MissingExtraError
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.provenance import PixelCounts
from geomesh.parameters import LAYERS
from geomesh.raster.grid import Grid
from support.meshes import HEIGHT, ORIENTATIONS, WIDTH, frame_mesh, provenance

TRIANGLE_COLUMNS = [
    *("id", "n0", "n1", "n2", "area", "ab", "bc", "ca", "ki", "min_angle", "shape", "count"),
    *("b1_mean", "b1_std", "b1_min", "b1_max", "color"),
]
NODE_COLUMNS = ["id", "kind", "col", "row", "scale", "response", "octave", "angle", "b1"]
EDGE_COLUMNS = ["id", "n0", "n1", "left", "right", "length", "constrained"]


@pytest.fixture
def mesh() -> Mesh:
    return frame_mesh(ORIENTATIONS["north-up"])


@pytest.fixture(params=ORIENTATIONS, ids=str)
def placed(request: pytest.FixtureRequest) -> Mesh:
    """A mesh on each kind of grid."""
    return frame_mesh(ORIENTATIONS[request.param])


def arrays_of(mesh: Mesh) -> dict[str, np.ndarray]:
    tables = {"node": mesh.node_table, "triangle": mesh.triangle_table}
    return {
        "nodes": mesh.nodes,
        "triangles": mesh.triangles,
        "constraints": mesh.constraints,
        "plane_nodes": mesh.plane_nodes,
        "map_nodes": mesh.map_nodes,
        **mesh.edges._asdict(),
        **{f"{kind} {name}": t[name] for kind, t in tables.items() for name in t},
    }


# Immutability


@pytest.mark.parametrize("name", ["nodes", "triangles", "grid", "metadata", "provenance", "new"])
def test_a_mesh_refuses_new_values(name: str, mesh: Mesh) -> None:
    with pytest.raises(FrozenInstanceError):
        setattr(mesh, name, None)


def test_the_arrays_of_a_mesh_refuse_writes(mesh: Mesh) -> None:
    for name, array in arrays_of(mesh).items():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[1]
        assert not array.flags.writeable, name


def test_the_metadata_of_a_mesh_refuse_writes(mesh: Mesh) -> None:
    with pytest.raises(TypeError):
        mesh.metadata["recipe"] = {}  # type: ignore[index]


def test_a_mesh_does_not_change_with_the_callers_arrays() -> None:
    nodes = np.array([(0, 0), (40, 0), (0, 30)], float)
    triangles = np.array([[0, 2, 1]], np.int32)
    versions = {"geomesh": "0"}
    mesh = Mesh(nodes, triangles, ORIENTATIONS["north-up"], DomainFacts("hull", 600, 1, 0, 600),
                provenance=provenance(versions=versions))  # fmt: skip
    nodes[0], triangles[0], versions["geomesh"] = 99, 0, "1"
    assert mesh.nodes[0].tolist() == [0, 0]
    assert mesh.triangles.tolist() == [[0, 2, 1]]
    assert mesh.metadata["versions"] == {"geomesh": "0"}


def test_arrays_have_the_types_of_the_design() -> None:
    grid = ORIENTATIONS["north-up"]
    mesh = Mesh([(0, 0), (40, 0), (0, 30)], [[0, 2, 1]], grid, DomainFacts("hull", 600, 1, 0, 600))
    assert mesh.nodes.dtype == np.float64
    assert mesh.triangles.dtype == np.int32
    assert mesh.constraints.shape == (0, 2)
    assert mesh.plane_size == (WIDTH, HEIGHT)


@pytest.mark.parametrize("table", ["node_table", "triangle_table"])
def test_a_table_of_another_length_is_refused(table: str, mesh: Mesh) -> None:
    with pytest.raises(ValueError, match="a table has 3 rows"):
        replace(mesh, **{table: Table({"a": [1, 2, 3]})})


@pytest.mark.parametrize("again", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
@pytest.mark.parametrize("used", [False, True], ids=["fresh", "with derived arrays"])
def test_a_copied_mesh_is_the_same_mesh(again, used: bool, mesh: Mesh) -> None:
    if used:
        assert mesh.edges is not None
        assert mesh.quality() is not None
        assert mesh.map_nodes is not None
    other = again(mesh)
    theirs = arrays_of(other)
    for name, array in arrays_of(mesh).items():
        np.testing.assert_array_equal(theirs[name], array)
        assert theirs[name].dtype == array.dtype
    assert (other.grid, other.domain, other.plane_size) == (mesh.grid, mesh.domain, mesh.plane_size)
    assert dict(other.metadata) == dict(mesh.metadata)
    assert list(other.attributes("triangles")) == list(mesh.attributes("triangles"))
    with pytest.raises(TypeError):
        other.metadata["recipe"] = {}


@pytest.mark.parametrize("again", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
@pytest.mark.parametrize("used", [False, True], ids=["fresh", "with derived arrays"])
def test_a_copied_mesh_still_refuses_writes(again, used: bool, mesh: Mesh) -> None:
    if used:
        assert mesh.map_nodes is not None
    writable = [name for name, array in arrays_of(again(mesh)).items() if array.flags.writeable]
    assert writable == []


@pytest.mark.parametrize("name", ["plane_nodes", "map_nodes", "edges"])
def test_a_derived_array_is_made_once(name: str, mesh: Mesh) -> None:
    assert getattr(mesh, name) is getattr(mesh, name)
    assert mesh.quality() is mesh.quality()


def test_a_replaced_mesh_derives_its_own_arrays(mesh: Mesh) -> None:
    before = mesh.map_nodes
    moved = replace(mesh, grid=ORIENTATIONS["rotated"])
    np.testing.assert_array_equal(moved.map_nodes, ORIENTATIONS["rotated"].to_map(mesh.nodes))
    assert mesh.map_nodes is before


@pytest.mark.parametrize(
    ("grid", "expected"),
    [("north-up", "EPSG:32618"), ("no georeference", "no CRS")],
)
def test_a_mesh_says_in_one_line_what_it_is(grid: str, expected: str) -> None:
    mesh = frame_mesh(ORIENTATIONS[grid])
    assert repr(mesh) == f"<Mesh: 29 nodes, {len(mesh.triangles)} triangles, {expected}>"


def test_nodes_lie_in_the_plane_that_the_pipeline_worked_on() -> None:
    mesh = frame_mesh(ORIENTATIONS["north-up"], plane_size=(256, 256))
    np.testing.assert_allclose(mesh.plane_nodes, mesh.nodes * np.array([256 / 40, 256 / 30]))
    assert mesh.plane_scale == (256 / 40, 256 / 30)
    corners = mesh.plane_nodes[mesh.triangles]
    sides = np.roll(corners, 1, axis=1) - corners
    longest = np.hypot(sides[..., 0], sides[..., 1]).max(axis=1)
    np.testing.assert_allclose(mesh.quality().table["bc"], longest)


def test_a_mesh_certifies_itself_on_every_grid(placed: Mesh) -> None:
    placed.certify().require()


def test_a_mesh_turned_the_wrong_way_fails_on_every_grid(placed: Mesh) -> None:
    assert not replace(placed, triangles=placed.triangles[:, ::-1]).certify().passed


def test_pixel_counts_of_the_metadata_are_certified(mesh: Mesh) -> None:
    pixels = WIDTH * HEIGHT
    right = replace(mesh, provenance=provenance(pixels=PixelCounts(pixels, pixels)))
    wrong = replace(mesh, provenance=provenance(pixels=PixelCounts(pixels - 1, pixels - 1)))
    assert right.certify().passed
    assert not wrong.certify().passed


# Attributes


@pytest.mark.parametrize(
    ("layer", "columns"),
    [("triangles", TRIANGLE_COLUMNS), ("nodes", NODE_COLUMNS), ("edges", EDGE_COLUMNS)],
)
def test_columns_are_in_the_order_of_the_design(layer: Any, columns: list[str], mesh: Mesh) -> None:
    assert list(mesh.attributes(layer)) == columns
    assert list(mesh.to_geodataframe(layer).columns) == [*columns, "geometry"]


@pytest.mark.parametrize("layer", LAYERS)
def test_ids_count_from_zero(layer: Any, mesh: Mesh) -> None:
    ids = mesh.attributes(layer)["id"]
    assert ids.tolist() == list(range(len(ids)))
    assert ids.dtype == np.int32


def test_triangle_columns_are_the_corners_and_the_measures(mesh: Mesh) -> None:
    table = mesh.attributes("triangles")
    corners = np.column_stack([table["n0"], table["n1"], table["n2"]])
    np.testing.assert_array_equal(corners, mesh.triangles)
    for name in ("ab", "bc", "ca", "ki", "min_angle", "shape"):
        np.testing.assert_array_equal(table[name], mesh.quality().table[name])
    assert (table["ab"] <= table["ca"]).all()
    assert (table["ca"] <= table["bc"]).all()


def test_node_columns_are_places_in_pixels(mesh: Mesh) -> None:
    table = mesh.attributes("nodes")
    np.testing.assert_array_equal(np.column_stack([table["col"], table["row"]]), mesh.nodes)


def test_only_the_outline_is_constrained(mesh: Mesh) -> None:
    table = mesh.attributes("edges")
    marked = np.column_stack([table["n0"], table["n1"]])[table["constrained"]]
    assert marked.tolist() == [[25, 26], [25, 28], [26, 27], [27, 28]]
    outside = (table["left"] == -1) | (table["right"] == -1)
    np.testing.assert_array_equal(outside, table["constrained"])


@pytest.mark.parametrize("ask", ["attributes", "to_geodataframe"])
@pytest.mark.parametrize("layer", ["triangle", "faces", "", None])
def test_an_unknown_layer_is_refused(ask: str, layer: Any, mesh: Mesh) -> None:
    with pytest.raises(ValueError, match="triangles"):
        getattr(mesh, ask)(layer)


# On the map


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_knows_its_crs(layer: Any, placed: Mesh) -> None:
    frame = placed.to_geodataframe(layer)
    assert isinstance(frame, gpd.GeoDataFrame)
    assert frame.crs == placed.grid.crs


def test_triangles_on_the_map_are_valid_and_counter_clockwise(placed: Mesh) -> None:
    shapes = placed.to_geodataframe("triangles").geometry
    assert (shapes.geom_type == "Polygon").all()
    assert shapes.is_valid.all()
    assert shapely.is_ccw(shapely.get_exterior_ring(shapes.values)).all()


def test_triangles_on_the_map_tile_the_raster(placed: Mesh) -> None:
    grid = placed.grid
    corners = [(0, 0), (grid.width, 0), (grid.width, grid.height), (0, grid.height)]
    raster = shapely.Polygon(grid.to_map(corners))
    shapes = placed.to_geodataframe("triangles").geometry
    assert shapes.union_all().symmetric_difference(raster).area < 1e-6 * raster.area
    assert shapes.area.sum() == pytest.approx(raster.area, rel=1e-9)


def test_areas_are_those_of_geopandas(placed: Mesh) -> None:
    frame = placed.to_geodataframe("triangles")
    np.testing.assert_allclose(frame["area"], frame.geometry.area, rtol=1e-7)


def test_areas_in_feet_are_square_metres() -> None:
    frame = frame_mesh(replace(ORIENTATIONS["rotated"], crs=CRS(2263))).to_geodataframe("triangles")
    np.testing.assert_allclose(frame["area"], frame.geometry.area * (1200 / 3937) ** 2, rtol=1e-7)


def test_geographic_areas_are_geodesic() -> None:
    grid = Grid(WIDTH, HEIGHT, Affine(1 / 3600, 0, -105.5, 0, -1 / 3600, 40.5), CRS(4269))
    frame = frame_mesh(grid).to_geodataframe("triangles")
    geod = Geod(ellps="GRS80")
    expected = [abs(geod.geometry_area_perimeter(shape)[0]) for shape in frame.geometry]
    np.testing.assert_allclose(frame["area"], expected, rtol=1e-5)


@pytest.mark.parametrize("name", ["no georeference", "north-up"])
def test_edge_lengths_are_taken_in_the_plane_of_the_image(name: str) -> None:
    mesh = frame_mesh(ORIENTATIONS[name])
    frame = mesh.to_geodataframe("edges")
    pixel = 30 if mesh.grid.crs else 1
    np.testing.assert_allclose(frame["length"], frame.geometry.length / pixel, rtol=1e-6)


def test_edges_run_between_their_nodes(placed: Mesh) -> None:
    frame, nodes = placed.to_geodataframe("edges"), placed.to_geodataframe("nodes").geometry
    for end, which in (("n0", 0), ("n1", -1)):
        ends = shapely.get_point(frame.geometry.values, which)
        assert shapely.equals(ends, nodes.values[frame[end]]).all()


def test_the_left_triangle_is_on_the_left_hand_on_the_map(placed: Mesh) -> None:
    edges = placed.to_geodataframe("edges")
    triangles = placed.to_geodataframe("triangles").geometry
    for edge in edges.itertuples():
        middle = np.array(edge.geometry.interpolate(0.5, normalized=True).coords[0])
        start, stop = np.array(edge.geometry.coords)
        left = np.array([start[1] - stop[1], stop[0] - start[0]]) * 1e-4
        for side, step in ((edge.left, left), (edge.right, -left)):
            touched = triangles.index[triangles.intersects(shapely.Point(middle + step))]
            assert touched.tolist() == ([] if side == -1 else [side])


def test_nodes_on_the_map_are_at_their_pixels(placed: Mesh) -> None:
    frame = placed.to_geodataframe("nodes")
    t = placed.grid.transform
    x = t.a * frame["col"] + t.b * frame["row"] + t.c
    y = t.d * frame["col"] + t.e * frame["row"] + t.f
    np.testing.assert_allclose(frame.geometry.x, x, rtol=1e-12)
    np.testing.assert_allclose(frame.geometry.y, y, rtol=1e-12)


def test_a_geodataframe_may_be_changed_without_changing_the_mesh(mesh: Mesh) -> None:
    frame = mesh.to_geodataframe("triangles")
    frame.loc[0, "area"] = -1
    frame["ki"] *= 2
    again = mesh.to_geodataframe("triangles")
    assert again.loc[0, "area"] > 0
    np.testing.assert_array_equal(again["ki"] * 2, frame["ki"])


@pytest.mark.parametrize("layer", LAYERS)
def test_a_mesh_without_triangles_has_empty_layers(layer: Any) -> None:
    empty = Mesh(np.empty((0, 2)), np.empty((0, 3)), ORIENTATIONS["north-up"],
                 DomainFacts("hull", 0, 0, 0, 0))  # fmt: skip
    frame = empty.to_geodataframe(layer)
    assert len(frame) == 0
    assert frame.crs == CRS(32618)


# Graphs


def brute_force_lengths(mesh: Mesh) -> dict[tuple[int, int], float]:
    """Return the map length of each edge of a triangle, in both directions."""
    places = [(node.x, node.y) for node in mesh.to_geodataframe("nodes").geometry]
    return {
        (int(a), int(b)): math.dist(places[a], places[b])
        for triangle in mesh.triangles
        for a in triangle
        for b in triangle
        if a != b
    }


def test_the_sparse_graph_holds_map_lengths_both_ways(placed: Mesh) -> None:
    graph = placed.to_graph()
    assert isinstance(graph, sparse.csr_array)
    assert graph.shape == (29, 29)
    expected = brute_force_lengths(placed)
    entries = graph.tocoo()
    found = dict(zip(zip(*map(np.ndarray.tolist, entries.coords), strict=True), entries.data,
                     strict=True))  # fmt: skip
    assert found.keys() == expected.keys()
    assert all(found[pair] == pytest.approx(expected[pair], rel=1e-9) for pair in expected)


def test_the_networkx_graph_is_the_sparse_one(mesh: Mesh) -> None:
    networkx = pytest.importorskip("networkx")
    graph = mesh.to_graph("networkx")
    assert isinstance(graph, networkx.Graph)
    assert sorted(graph.nodes) == list(range(29))
    assert {tuple(sorted(pair)) for pair in graph.edges} == set(map(tuple, mesh.edges.nodes))
    found = networkx.to_scipy_sparse_array(graph, nodelist=range(29), weight="weight")
    np.testing.assert_allclose(found.toarray(), mesh.to_graph().toarray())


def test_the_libpysal_graph_is_the_sparse_one(mesh: Mesh) -> None:
    libpysal = pytest.importorskip("libpysal.graph")
    graph = mesh.to_graph("libpysal")
    assert isinstance(graph, libpysal.Graph)
    assert graph.unique_ids.tolist() == list(range(29))
    np.testing.assert_allclose(graph.sparse.toarray(), mesh.to_graph().toarray())
    assert len(graph.isolates) == 0


@pytest.mark.parametrize("library", ["networkx", "libpysal"])
def test_a_library_that_is_not_installed_is_named(library: Any, mesh: Mesh, monkeypatch) -> None:
    for name in ("networkx", "libpysal", "libpysal.graph"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    with pytest.raises(MissingExtraError, match=rf"{library} is not installed: pip install"):
        mesh.to_graph(library)


def test_an_unknown_graph_library_is_refused(mesh: Mesh) -> None:
    with pytest.raises(ValueError, match="igraph"):
        mesh.to_graph("igraph")  # type: ignore[arg-type]


# Quality


def test_quality_on_the_map_is_that_of_the_map_geometry(placed: Mesh) -> None:
    quality = placed.quality(space="map").table
    frame = placed.to_geodataframe("triangles")
    np.testing.assert_allclose(quality["area"], frame.geometry.area, rtol=1e-7)
    np.testing.assert_allclose(
        quality["ab"] + quality["bc"] + quality["ca"], frame.geometry.length, rtol=1e-9
    )


def test_quality_on_the_map_scales_with_square_pixels(mesh: Mesh) -> None:
    image, on_map = mesh.quality().table, mesh.quality(space="map").table
    for name, power in (("ab", 1), ("bc", 1), ("ki", 1), ("area", 2), ("shape", 0)):
        np.testing.assert_allclose(on_map[name], image[name] * 30.0**power, rtol=1e-6)


@pytest.mark.parametrize("name", ["north-up", "south-up", "rotated", "rotated, south-up"])
def test_normalised_ki_is_the_same_on_the_map_where_pixels_are_square(name: str) -> None:
    mesh = frame_mesh(ORIENTATIONS[name])
    image, on_map = mesh.quality().summary(), mesh.quality(space="map").summary()
    assert on_map["ki_normalised"] == pytest.approx(image["ki_normalised"], rel=1e-6)


@pytest.mark.parametrize("name", ["north-up", "rotated", "sheared"])
def test_quality_on_the_map_tells_the_rasters_sides_in_map_units(name: str) -> None:
    mesh = frame_mesh(ORIENTATIONS[name])
    left_top, right_top, left_bottom = mesh.grid.to_map([(0, 0), (WIDTH, 0), (0, HEIGHT)])
    sides = [math.dist(left_top, right_top), math.dist(left_top, left_bottom)]
    assert mesh.quality(space="map").summary()["size"] == pytest.approx(sides)


def test_an_unknown_space_is_refused(mesh: Mesh) -> None:
    with pytest.raises(ValueError, match="pixels"):
        mesh.quality(space="pixels")  # type: ignore[arg-type]
