"""2DM files: read with py2dm. qgis_plugin/tests opens them in QGIS."""

from __future__ import annotations

import numpy as np
import py2dm
import pytest

from geomesh.errors import OutputError
from geomesh.formats.document import build_document
from geomesh.formats.mesh_2dm import FORMAT as MESH_2DM
from support.meshes import GEOREFERENCES, ORIENTATIONS, frame_mesh, provenance
from support.terrain import (
    HOSTILE,
    expected,
    is_counter_clockwise,
    small_tin,
    utm_tin,
    with_voids,
    write,
)


def read(path):
    """Return the corners of the triangles, (T, 3, 3), as py2dm finds them."""
    with py2dm.Reader(str(path), materials=1) as mesh:
        nodes = list(mesh.nodes)
        elements = list(mesh.elements)
    assert [node.id for node in nodes] == list(range(1, len(nodes) + 1))
    assert [element.id for element in elements] == list(range(1, len(elements) + 1))
    assert {(element.card, element.materials) for element in elements} == {("E3T", (1,))}
    points = np.array([node.pos for node in nodes])
    return points[np.array([element.nodes for element in elements]) - 1]


def test_the_surface_of_a_dem_is_read_back_to_the_last_bit(tmp_path):
    mesh = utm_tin()
    path, told = write(mesh, tmp_path / "mesh.2dm")
    wanted = expected(mesh)
    corners = read(path)
    assert np.array_equal(corners, wanted.corners)
    assert is_counter_clockwise(corners)
    lines = path.read_text("utf-8").splitlines()
    assert lines[0] == "MESH2D"
    assert (
        lines[2]
        == "# x and y in metre: EPSG:26913, NAD83 / UTM zone 13N; heights in metre (assumed)"
    )
    assert told == []
    assert MESH_2DM.count_rows(path, "triangles") == len(wanted.corners)
    assert MESH_2DM.read_document(path) == build_document(mesh, mesh.certify())


@pytest.mark.parametrize("grid", [*ORIENTATIONS, *GEOREFERENCES])
def test_meshes_of_every_grid(tmp_path, grid):
    frame = frame_mesh((ORIENTATIONS | GEOREFERENCES)[grid], height=small_tin().height)
    path, told = write(frame, tmp_path / "mesh.2dm")
    assert told == []
    assert np.array_equal(read(path), expected(frame).corners)


def test_voids_and_units(tmp_path):
    mesh = with_voids(small_tin("EPSG:2232", "foot"), [0, 7])
    path, told = write(mesh, tmp_path / "mesh.2dm")
    assert np.array_equal(read(path), expected(mesh).corners)
    about = path.read_text("utf-8").splitlines()[2]
    assert about.startswith("# x and y in US survey foot: EPSG:2232, ")
    assert about.endswith("; heights in foot")
    assert len(told) == 1
    with pytest.raises(OutputError, match="2DM needs heights, and the mesh has none"):
        write(frame_mesh(GEOREFERENCES["north-up"]), tmp_path / "flat.2dm")


def test_any_name_is_a_comment(tmp_path):
    mesh = small_tin(provenance=provenance(name=HOSTILE, warnings=(HOSTILE, "\nE3T 1 1 1 1 1\n")))
    path, _ = write(mesh, tmp_path / "mesh.2dm")
    assert path.read_text("utf-8").splitlines()[1] == "# <&>\"'北京__--.tif"
    assert len(read(path)) == 52
    assert MESH_2DM.read_document(path) == build_document(mesh, mesh.certify())


def test_damage_is_noticed(tmp_path):
    path, _ = write(small_tin(), tmp_path / "mesh.2dm")
    whole = path.read_bytes()
    end = whole.rindex(b"# end")
    parts = [whole[: int(kept * len(whole))] for kept in (0.0, 0.3, 0.7, 0.999)]
    parts += [whole[:end], whole[: whole.rindex(b"E3T")] + whole[end:]]
    parts += [whole.replace(b"E3T 5 ", b"E3T 5 99"), whole.replace(b"ND 3 ", b"ND 3 x")]
    for part in parts:
        path.write_bytes(part)
        with pytest.raises(OSError, match="damaged"):
            MESH_2DM.count_rows(path, "triangles")
    path.write_bytes(b"MESH2D\n")
    with pytest.raises(KeyError):
        MESH_2DM.read_document(path)
