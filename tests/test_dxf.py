"""DXF files: read and audited by ezdxf."""

from __future__ import annotations

import builtins
import sys

import ezdxf
import numpy as np
import pytest

from geomesh.errors import GeoreferenceError, MissingExtraError, OutputError
from geomesh.formats import dxf
from geomesh.formats.document import build_document
from geomesh.formats.dxf import FORMAT as DXF
from geomesh.formats.format import PLAIN
from geomesh.io.write import write_mesh
from support.meshes import GEOREFERENCES, frame_mesh, lattice_mesh, provenance
from support.terrain import (
    HOSTILE,
    edges_of,
    expected,
    is_counter_clockwise,
    small_tin,
    utm_tin,
    with_voids,
    write,
)


class Read:
    """What ezdxf finds in a file, which its audit must not complain about."""

    def __init__(self, path):
        self.drawing = ezdxf.readfile(path)
        audit = self.drawing.audit()
        assert (audit.errors, audit.fixes) == ([], [])
        space = self.drawing.modelspace()
        faces = [[list(corner) for corner in face.wcs_vertices()] for face in space.query("3DFACE")]
        assert {face.dxf.layer for face in space.query("3DFACE")} == {"TIN"}
        corners = [
            [list(face.dxf.get(f"vtx{k}")) for k in range(4)] for face in space.query("3DFACE")
        ]
        assert len(faces) == len(corners)
        self.corners = np.array(corners)
        assert np.array_equal(self.corners[:, 2], self.corners[:, 3])
        self.corners = self.corners[:, :3]

    def lines(self, layer, *, closed):
        found = [
            line for line in self.drawing.modelspace().query("POLYLINE") if line.dxf.layer == layer
        ]
        assert all(line.is_3d_polyline and line.is_closed == closed for line in found)
        return [np.array([list(vertex.dxf.location) for vertex in line.vertices]) for line in found]

    @property
    def crs(self):
        return dict(self.drawing.header.custom_vars)["CRS"]


def test_the_surface_of_a_dem_is_read_back_to_the_last_bit(tmp_path):
    mesh = utm_tin()
    path, told = write(mesh, tmp_path / "mesh.dxf")
    read, wanted = Read(path), expected(mesh)
    assert np.array_equal(read.corners, wanted.corners)
    assert is_counter_clockwise(read.corners)
    breaklines = read.lines("BREAKLINES", closed=False)
    assert len(breaklines) == 1
    assert set(edges_of(breaklines)) == wanted.breaklines
    assert set(edges_of(read.lines("OUTLINE", closed=True), closed=True)) == wanted.outline
    assert read.drawing.header["$INSUNITS"] == 6
    assert read.drawing.header["$MEASUREMENT"] == 1
    assert read.drawing.header["$EXTMAX"] == tuple(wanted.corners.max(axis=(0, 1)))
    about = "x and y in metre: EPSG:26913, NAD83 / UTM zone 13N; heights in metre (assumed)"
    assert read.crs == about
    assert told == [f"DXF stores no CRS: comments and properties of the drawing say {about!r}"]
    assert path.read_text("utf-8").splitlines()[1].endswith(about)
    assert DXF.count_rows(path, "triangles") == len(wanted.corners)
    assert DXF.read_document(path) == build_document(mesh, mesh.certify())


def test_handles_are_unique_and_the_next_is_free(tmp_path):
    path, _ = write(small_tin(), tmp_path / "mesh.dxf")
    lines = path.read_text("utf-8").splitlines()
    tags = list(zip(lines[::2], lines[1::2], strict=True))
    seed = tags.index(("  9", "$HANDSEED")) + 1
    handles = [int(value, 16) for code, value in tags[seed + 1 :] if code in ("  5", "105")]
    assert len(set(handles)) == len(handles)
    assert int(tags[seed][1], 16) == max(handles) + 1


@pytest.mark.parametrize(
    ("crs", "unit", "code", "factor"),
    [
        ("EPSG:2232", "US survey foot", 21, None),
        ("EPSG:2232", "metre", 21, 3937 / 1200),
        ("EPSG:2223", "metre", 2, 1 / 0.3048),
        ("EPSG:32613", "foot", 6, 0.3048),
        ("EPSG:27291", "metre", 0, 1 / 0.9143984146160287),
        (None, "foot", 0, None),
    ],
)
def test_heights_are_in_the_unit_of_the_drawing(tmp_path, crs, unit, code, factor):
    mesh = small_tin(crs, unit)
    path, told = write(mesh, tmp_path / "mesh.dxf")
    read = Read(path)
    assert read.drawing.header["$INSUNITS"] == code
    assert read.drawing.header["$MEASUREMENT"] == int(code in (0, 6))
    heights = mesh.heights[mesh.triangles]
    assert read.corners[:, :, 2] == pytest.approx(heights * (factor or 1), rel=1e-6)
    assert np.array_equal(read.corners[:, :, 2], heights) == (factor is None)
    assert any("converted" in text for text in told) == (factor is not None)
    assert any("has no code for the unit 'British yard" in text for text in told) == (
        crs == "EPSG:27291"
    )
    assert read.crs.startswith("x and y: no CRS" if crs is None else "x and y in ")


def test_voids_are_left_out_and_outlined(tmp_path):
    mesh = with_voids(small_tin(), [0, 7])
    read, wanted = Read(write(mesh, tmp_path / "mesh.dxf")[0]), expected(mesh)
    assert np.array_equal(read.corners, wanted.corners)
    rings = read.lines("OUTLINE", closed=True)
    assert len(rings) > 1
    assert set(edges_of(rings, closed=True)) == wanted.outline


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(OutputError, match="DXF needs heights, and the mesh has none"):
        write(frame_mesh(GEOREFERENCES["north-up"]), tmp_path / "mesh.dxf")
    geographic = GEOREFERENCES["geographic"]
    mesh = frame_mesh(geographic, height=small_tin().height)
    with pytest.raises(GeoreferenceError, match=r"DXF needs x and y in .*-t_srs EPSG:327\d\d"):
        write(mesh, tmp_path / "mesh.dxf")
    assert list(tmp_path.iterdir()) == []


def test_any_name_is_a_comment(tmp_path):
    mesh = small_tin(provenance=provenance(name=HOSTILE, warnings=(HOSTILE, "  0\nEOF\n")))
    path, _ = write(mesh, tmp_path / "mesh.dxf")
    assert path.read_text("utf-8").splitlines()[1].startswith("<&>\"'北京__--.tif: x and y in")
    assert max(map(len, path.read_text("utf-8").splitlines()[:40])) <= 255
    assert len(Read(path).corners) == 52
    assert DXF.read_document(path) == build_document(mesh, mesh.certify())


def test_a_large_file_is_said_before(tmp_path, monkeypatch):
    monkeypatch.setattr(dxf, "_FACES_OF_LARGE_FILE", 20_000)
    lattice = lattice_mesh("EPSG:32613", small_tin().grid.transform, 110, 100)
    heights = {"b1": np.linspace(1, 3000, len(lattice.nodes))}
    table = small_tin().node_table.__class__(heights)
    mesh = lattice.__class__(
        *(lattice.nodes, lattice.triangles, lattice.grid, lattice.domain),
        node_table=table,
        height=small_tin().height,
    )
    (told,) = [text for text in DXF.notes(mesh, None) if "faces" in text]
    layer = DXF.layer(mesh, "triangles", PLAIN)
    assert told.startswith("the file will have 22000 faces and about ")
    size = float(told.split()[-2])
    faces = b"".join(dxf._faces(np.zeros((1, 3)), np.zeros((0, 3), int), 1, "17"))
    assert faces == b""
    real = sum(
        len(text)
        for text in dxf._faces(
            np.column_stack([mesh.map_nodes, mesh.heights]), mesh.triangles, 48, "17"
        )
    )
    assert size == pytest.approx(real / 1e6, abs=0.6)
    assert len(layer) == 22_000


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name.partition(".")[0] == "ezdxf":
            raise ImportError(name)
        return real(name, *arguments, **options)

    for name in [name for name in sys.modules if name.partition(".")[0] == "ezdxf"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"ezdxf is not installed: .*\[terrain\]"):
        write_mesh(small_tin(), tmp_path / "mesh.dxf")


def test_damage_is_noticed(tmp_path):
    path, _ = write(small_tin(), tmp_path / "mesh.dxf")
    whole = path.read_bytes()
    for kept in (0.0, 0.3, 0.7, 0.999):
        path.write_bytes(whole[: int(kept * len(whole))])
        with pytest.raises(OSError, match="damaged"):
            DXF.count_rows(path, "triangles")
    path.write_bytes(whole.replace(b"\n 33\n", b"\n 33\nx", 1))
    with pytest.raises(OSError, match="damaged"):
        DXF.count_rows(path, "triangles")
    path.write_bytes(b"  0\nEOF\n")
    with pytest.raises(KeyError):
        DXF.read_document(path)
