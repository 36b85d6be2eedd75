"""OBJ, PLY, GLB and VTU: read with trimesh, plyfile and meshio, and byte by byte."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import meshio
import numpy as np
import plyfile
import pytest
import trimesh
from pyproj import CRS

from geomesh.arrays.table import Table
from geomesh.errors import GeomeshWarning, OutputError
from geomesh.formats.document import build_document
from geomesh.formats.registry import find_format
from geomesh.formats.tin import LocalFrame
from geomesh.io.write import write_mesh
from support.meshes import two_triangles
from support.models import PLACES, US_FOOT, kept, local, mean_colors, renamed, terrain

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")

EXTENSIONS = (".obj", ".ply", ".glb", ".vtu")
HOSTILE = {"b1_mean": "近红外 mean", "b1_std": "a\"<&>'\n\x07b", "inside": "vertex_indices"}


@pytest.fixture(params=EXTENSIONS)
def extension(request):
    return request.param


@pytest.fixture(params=PLACES)
def mesh(request):
    feet = {"height": US_FOOT} if request.param == "feet" else {}
    return terrain(PLACES[request.param], voids=20, **feet)


def on_map(mesh):
    _, _, nodes = kept(mesh)
    return np.column_stack([mesh.map_nodes[nodes], mesh.heights[nodes]])


# --- what all of them have -------------------------------------------------------------


def test_the_document_is_read_back(tmp_path, extension):
    mesh = renamed(terrain(voids=20), HOSTILE)
    path = write_mesh(mesh, tmp_path / f"mesh{extension}")
    known = find_format(path)
    assert known.read_document(path) == build_document(mesh, mesh.certify())
    _, rows, _ = kept(mesh)
    assert known.count_rows(path, "triangles") == len(rows) < len(mesh.triangles)


def test_a_file_without_a_document_has_none(tmp_path, extension):
    path = write_mesh(terrain(), tmp_path / f"mesh{extension}")
    path.write_bytes(path.read_bytes().replace(b"geomesh", b"another"))
    with pytest.raises(KeyError, match="geomesh"):
        find_format(path).read_document(path)


def test_damaged_files_are_noticed(tmp_path, extension):
    path = write_mesh(terrain(), tmp_path / f"mesh{extension}")
    whole = path.read_bytes()
    count_rows = find_format(path).count_rows
    sizes = [*(int(len(whole) * share) for share in (0, 0.01, 0.3, 0.7, 0.99)), len(whole) - 1]
    for content in (*(whole[:size] for size in sizes), whole[:-900] + whole[-800:]):
        path.write_bytes(content)
        with pytest.raises(OSError, match=f"the {extension[1:].upper()} file is damaged") as caught:
            count_rows(path, "triangles")
        assert "\n" not in str(caught.value)


def test_corners_that_do_not_exist_are_noticed(tmp_path, extension):
    path = write_mesh(two_heights(), tmp_path / f"mesh{extension}")
    right, wrong = (forms_of([[0, last, 1], [1, last, 2]])[extension] for last in (3, 4))
    whole = path.read_bytes()
    assert whole.count(right) == 1
    path.write_bytes(whole.replace(right, wrong))
    with pytest.raises(OSError, match=r"damaged: it has .* without"):
        find_format(path).count_rows(path, "triangles")


def forms_of(corners):
    """Return how each format writes two triangles."""
    numbers = np.array(corners, "<i4")
    lines = "".join(f"f {a} {b} {c}\n" for a, b, c in numbers + 1)
    return {
        ".obj": lines.encode(),
        ".ply": numbers[0].tobytes(),
        ".glb": numbers.tobytes(),
        ".vtu": base64.b64encode(np.array([24], "<u8").tobytes() + numbers.tobytes()),
    }


def two_heights():
    mesh = two_triangles()
    return replace(mesh, node_table=terrain(count=4).node_table, height=terrain().height)


def test_a_mesh_without_heights_is_refused(tmp_path, extension):
    with pytest.raises(OutputError, match=r"needs heights, and the mesh has none: .* `z=1`"):
        write_mesh(two_triangles(), tmp_path / f"mesh{extension}")
    with pytest.raises(OutputError, match="no triangle of the mesh has any"):
        write_mesh(terrain(voids=200), tmp_path / f"mesh{extension}")
    assert list(tmp_path.iterdir()) == []


def test_other_layers_are_refused(tmp_path, extension):
    with pytest.raises(OutputError, match="can store triangles, not nodes"):
        write_mesh(terrain(), tmp_path / f"mesh{extension}", layers=["nodes"])


def test_notes_tell_of_origin_voids_and_degrees(tmp_path, extension):
    path = tmp_path / f"mesh{extension}"
    with pytest.warns(GeomeshWarning) as told:
        write_mesh(terrain(PLACES["geographic"], voids=20), path)
    first, second = (str(warning.message) for warning in told)
    if extension in (".obj", ".glb"):
        assert "holds metres east and north of x -43.748, y -22.201 (EPSG:4326)" in first
        assert ("rounded to" in first) == (extension == ".glb")
    else:
        assert "holds x and y as angles and heights as lengths, so" in first
    assert "triangles have no heights and are left out" in second


def test_notes_tell_that_units_are_taken_for_metres(tmp_path):
    with pytest.warns(GeomeshWarning, match=r"\(no CRS\), one unit taken for a metre"):
        write_mesh(terrain(PLACES["no CRS"]), tmp_path / "mesh.glb")


def test_a_mesh_without_colours_gets_none(tmp_path):
    plain = replace(terrain(), triangle_table=Table({}))
    odd = replace(plain, triangle_table=Table({"color": np.full(len(plain.triangles), "red")}))
    for mesh in (plain, odd):
        for extension in EXTENSIONS:
            write_mesh(mesh, tmp_path / f"mesh{extension}", overwrite=True)
        assert "color" not in meshio.read(tmp_path / "mesh.vtu").cell_data
        found = plyfile.PlyData.read(tmp_path / "mesh.ply")["vertex"]
        assert [each.name for each in found.properties] == ["x", "y", "z", "b1"]
        assert len((tmp_path / "mesh.obj").read_text().split("\nv ")[1].split("\n")[0].split()) == 3
        content, _ = read_glb(tmp_path / "mesh.glb")
        attributes = content["meshes"][0]["primitives"][0]["attributes"]
        assert sorted(attributes) == ["NORMAL", "POSITION"]


# --- OBJ -------------------------------------------------------------------------------


def test_trimesh_reads_obj(tmp_path, mesh):
    path = write_mesh(mesh, tmp_path / "mesh.obj")
    found = trimesh.load(path, process=False)
    triangles, _, _ = kept(mesh)
    assert np.array_equal(found.faces, triangles)
    assert np.allclose(found.vertices, local(mesh), rtol=0, atol=5.1e-7)
    assert np.abs(found.visual.vertex_colors[:, :3] - mean_colors(mesh)).max() <= 1


def test_comments_of_obj_say_what_it_is(tmp_path):
    mesh = terrain(PLACES["feet"], height=US_FOOT)
    text = write_mesh(mesh, tmp_path / "mesh.obj").read_text(encoding="ascii")
    lines = [line for line in text.splitlines() if line.startswith("#")]
    assert lines[:2] == [
        "# metres east and north of x 600000, y 200000 (EPSG:2263), "
        "heights in metres (from US survey foot)",
        "# z is up",
    ]
    assert CRS(lines[2].removeprefix("# CRS: ")) == mesh.grid.crs
    assert all(len(line) < 255 for line in lines[3:])
    assert "-0.0 " not in text


# --- PLY -------------------------------------------------------------------------------


def test_plyfile_and_trimesh_read_ply(tmp_path, mesh):
    path = write_mesh(mesh, tmp_path / "mesh.ply")
    triangles, rows, _ = kept(mesh)
    found = plyfile.PlyData.read(path)
    vertex, face = found["vertex"], found["face"]
    assert np.array_equal(np.column_stack([vertex[axis] for axis in "xyz"]), on_map(mesh))
    assert np.array_equal(np.vstack(face["vertex_indices"]), triangles)
    assert face.properties[0].name == "vertex_indices"  # MDAL wants it first
    colors = np.column_stack([vertex[name] for name in ("red", "green", "blue")])
    assert colors.dtype == np.uint8
    assert np.abs(colors - mean_colors(mesh)).max() <= 0.5
    assert np.array_equal(vertex["b1"], on_map(mesh)[:, 2])
    columns = mesh.attributes("triangles")
    numbers = [name for name, col in columns.items() if col.dtype.kind in "biuf"][4:]
    assert [each.name for each in face.properties] == ["vertex_indices", *numbers]
    for name in numbers:
        expected = columns[name][rows].astype(np.float64)
        assert np.array_equal(np.asarray(face[name], np.float64), expected, equal_nan=True)
    again = trimesh.load(path, process=False)
    assert np.array_equal(again.faces, triangles)
    assert np.array_equal(again.vertices, on_map(mesh))


def test_comments_of_ply_say_what_it_is(tmp_path):
    mesh = terrain(PLACES["feet"], height=US_FOOT)
    crs, about, *_ = plyfile.PlyData.read(write_mesh(mesh, tmp_path / "mesh.ply")).comments
    assert CRS(crs.removeprefix("crs: ")).equals(mesh.grid.crs, ignore_axis_order=True)
    assert about == "geomesh, x and y on the map: EPSG:2263, heights in: US survey foot"


def test_hostile_names_are_legal_in_ply_and_told(tmp_path):
    mesh = renamed(terrain(), HOSTILE)
    band = {"red": mesh.node_table["b1"], **mesh.node_table}
    source = replace(mesh.provenance.source, bands=(source_band("red"),))
    mesh = replace(mesh, node_table=Table(band), provenance=replace(mesh.provenance, source=source))
    found = plyfile.PlyData.read(write_mesh(mesh, tmp_path / "mesh.ply"))
    names = [each.name for each in found["face"].properties]
    assert {"u8fd1u7ea2u5916_mean", "a_______b", "vertex_indices_2"} <= set(names)
    assert "the property u8fd1u7ea2u5916_mean is \\u8fd1\\u7ea2\\u5916 mean" in found.comments
    assert np.array_equal(found["vertex"]["red_2"], mesh.node_table["red"])
    assert found["vertex"]["red"].dtype == np.uint8


def source_band(name):
    from geomesh.mesh.provenance import SourceBand

    return SourceBand(name, 1, None)


# --- GLB -------------------------------------------------------------------------------


def read_glb(path):
    data = path.read_bytes()
    assert data[:4] == b"glTF"
    version, total, length = np.frombuffer(data, "<u4", 3, 4)
    assert (version, total) == (2, len(data))
    assert data[16:20] == b"JSON"
    start = 20 + int(length)
    assert start % 4 == 0
    assert data[start + 4 : start + 8] == b"BIN\0"
    assert int.from_bytes(data[start : start + 4], "little") == len(data) - start - 8
    return json.loads(data[20:start]), data[start + 8 :]


def test_trimesh_reads_glb(tmp_path, mesh):
    path = write_mesh(mesh, tmp_path / "mesh.glb")
    (found,) = trimesh.load(path, process=False).geometry.values()
    triangles, _, _ = kept(mesh)
    east, north, up = local(mesh).T
    assert np.array_equal(found.faces, triangles)
    expected = np.column_stack([east, up, -north]).astype(np.float32)
    assert np.array_equal(found.vertices, expected)
    # Light is linear in glTF; rounding it to 8 bits costs dark colours a few levels.
    srgb = np.rint(mean_colors(mesh)) / 255
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    colors = found.visual.vertex_attributes["color"]
    assert np.abs(colors[:, :3] - 255 * light).max() <= 1.5
    assert (colors[:, 3] == 255).all()
    assert (found.vertex_normals[:, 1] > 0).all()


def test_glb_follows_the_rules_of_gltf(tmp_path, mesh):
    content, binary = read_glb(write_mesh(mesh, tmp_path / "mesh.glb"))
    assert content["asset"]["version"] == "2.0"
    assert content["buffers"] == [{"byteLength": len(binary)}]
    (primitive,) = content["meshes"][0]["primitives"]
    sizes = {5121: 1, 5125: 4, 5126: 4}
    counts = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        element = sizes[accessor["componentType"]] * counts[accessor["type"]]
        assert view["byteOffset"] % 4 == element % 4 == 0
        assert view["byteLength"] == accessor["count"] * element
    last = content["bufferViews"][-1]
    assert last["byteOffset"] + last["byteLength"] == len(binary)
    position = content["accessors"][primitive["attributes"]["POSITION"]]
    places = np.frombuffer(binary, "<f4", 3 * position["count"]).reshape(-1, 3)
    assert position["min"] == places.min(axis=0).tolist()
    assert position["max"] == places.max(axis=0).tolist()
    normal = content["accessors"][primitive["attributes"]["NORMAL"]]
    start = content["bufferViews"][normal["bufferView"]]["byteOffset"]
    normals = np.frombuffer(binary, "<f4", 3 * normal["count"], start).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert content["accessors"][primitive["attributes"]["COLOR_0"]]["normalized"] is True
    assert content["accessors"][primitive["indices"]]["componentType"] == 5125


def test_extras_of_glb_say_where_it_is(tmp_path):
    mesh = terrain(PLACES["feet"], height=US_FOOT)
    content, _ = read_glb(write_mesh(mesh, tmp_path / "mesh.glb"))
    extras = content["nodes"][0]["extras"]
    frame = LocalFrame.of(mesh)
    assert extras["origin"] == [*frame.origin, 0.0]
    assert extras["metres_per_unit"] == pytest.approx([1200 / 3937] * 3, rel=1e-12)
    assert CRS(extras["crs"]) == mesh.grid.crs
    assert extras["unit"] == "metre"
    assert "heights in metres (from US survey foot)" in extras["about"]


# --- VTU -------------------------------------------------------------------------------


def test_meshio_reads_vtu(tmp_path, mesh):
    found = meshio.read(write_mesh(mesh, tmp_path / "mesh.vtu"))
    triangles, rows, nodes = kept(mesh)
    assert np.array_equal(found.points, on_map(mesh))
    assert [block.type for block in found.cells] == ["triangle"]
    assert np.array_equal(found.cells[0].data, triangles)
    for layer, data, chosen in (
        ("triangles", {name: parts[0] for name, parts in found.cell_data.items()}, rows),
        ("nodes", found.point_data, nodes),
    ):
        columns = mesh.attributes(layer)
        names = [
            name
            for name, values in columns.items()
            if values.dtype.kind in "biuf" and name not in ("id", "n0", "n1", "n2")
        ]
        assert set(data) - {"color"} == set(names)
        for name in names:
            expected = columns[name][chosen]
            assert np.array_equal(data[name], expected, equal_nan=expected.dtype.kind == "f")
    colors = [list(bytes.fromhex(text[1:])) for text in mesh.triangle_table["color"][rows]]
    assert found.cell_data["color"][0].tolist() == colors
    texts = {name: bytes(values).decode() for name, values in found.field_data.items()}
    assert texts["unit of heights"] == mesh.height.unit
    if mesh.grid.crs is None:
        assert "CRS" not in texts
    else:
        assert CRS(texts["CRS"]) == mesh.grid.crs


def test_hostile_names_are_kept_in_vtu(tmp_path):
    mesh = renamed(terrain(), HOSTILE)
    found = meshio.read(write_mesh(mesh, tmp_path / "mesh.vtu"))
    names = {name.replace("\n", "_").replace("\x07", "_") for name in HOSTILE.values()}
    assert names <= set(found.cell_data)
