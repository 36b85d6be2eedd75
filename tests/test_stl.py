"""STL files: surfaces and closed solids, read with trimesh."""

from __future__ import annotations

import re
import struct
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from affine import Affine

import geomesh
from geomesh.errors import GeomeshWarning, OutputError
from geomesh.formats.format import PLAIN, WriteOptions
from geomesh.formats.solid import closed_solid
from geomesh.formats.stl import FORMAT as STL
from geomesh.io.write import write_mesh
from geomesh.mesh.height import Height
from geomesh.raster.grid import Grid
from support.meshes import GEOREFERENCES, two_triangles
from support.models import PLACES, US_FOOT, kept, local, terrain
from support.samples import SAMPLES

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")


def cells(mask: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return points and triangles of the cells that a mask has, two for each."""
    rows, cols = mask.shape
    y, x = np.mgrid[: rows + 1, : cols + 1]
    z = np.random.default_rng(seed).integers(1, 9, x.shape)
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(float)
    row, col = np.nonzero(mask)
    a = row * (cols + 1) + col
    b, d = a + 1, a + cols + 1
    triangles = np.concatenate([np.column_stack([a, b, d]), np.column_stack([b, d + 1, d])])
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3).astype(np.int32)


def prism_volume(points: np.ndarray, triangles: np.ndarray, base: float) -> float:
    corners = points[triangles]
    sides = corners[:, 1:, :2] - corners[:, :1, :2]
    return float((np.linalg.det(sides) / 2 * (corners[..., 2].mean(axis=1) - base)).sum())


DOMAINS = {
    "one cell": [[1]],
    "hole": [[1, 1, 1], [1, 0, 1], [1, 1, 1]],
    "two parts": [[1, 0, 1]],
    "touching parts": [[1, 0], [0, 1]],
    "a hole that touches the outline": [[1, 1, 1], [1, 0, 1], [1, 1, 0]],
    "holes that touch": [[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 0, 1], [1, 1, 1, 1]],
    "part in a hole": np.pad(np.pad([[1]], 1), 1, constant_values=1),
    "chess board": np.indices((7, 8)).sum(axis=0) % 2,
}
DOMAINS |= {f"random {k}": np.random.default_rng(k).random((12, 15)) < 0.6 for k in range(4)}


@pytest.mark.parametrize("mask", DOMAINS.values(), ids=list(DOMAINS))
def test_each_edge_of_a_solid_is_in_two_triangles_of_opposite_direction(mask):
    points, triangles = cells(np.asarray(mask, bool))
    solid = closed_solid(points, triangles, -2.0)
    directed = Counter(
        (int(face[k]), int(face[(k + 1) % 3])) for face in solid.triangles for k in range(3)
    )
    assert set(directed.values()) == {1}
    assert all((stop, start) in directed for start, stop in directed)
    found = trimesh.Trimesh(solid.points, solid.triangles)
    assert found.is_watertight
    assert found.is_winding_consistent
    assert (found.area_faces > 0).all()
    assert len(found.vertices) == len(solid.points)
    expected = prism_volume(points, triangles, -2.0)
    assert found.volume == pytest.approx(expected, rel=1e-12)
    assert np.array_equal(solid.triangles[: len(triangles)], triangles)


def test_three_parts_of_a_node_have_points_of_their_own():
    angles = np.arange(6) * np.pi / 3
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(6)])
    points = np.concatenate([[[0, 0, 3.0]], rim])
    triangles = np.array([[0, 1, 2], [0, 3, 4], [0, 5, 6]], np.int32)
    solid = closed_solid(points, triangles, 0.0)
    assert solid.points[14:].tolist() == [[0, 0, 1], [0, 0, 2]]
    found = trimesh.Trimesh(solid.points, solid.triangles)
    assert found.is_watertight
    assert found.volume == pytest.approx(prism_volume(points, triangles, 0.0), rel=1e-12)


def write(mesh, path, solid=None):
    return write_mesh(mesh, path, options=WriteOptions(solid), overwrite=True)


@pytest.mark.parametrize("grid", PLACES.values(), ids=list(PLACES))
def test_trimesh_finds_the_surface(tmp_path, grid):
    mesh = terrain(grid)
    triangles, _, _ = kept(mesh)
    found = trimesh.load(write(mesh, tmp_path / "mesh.stl"), process=False)
    expected = local(mesh).astype(np.float32)[triangles]
    assert np.array_equal(found.triangles, expected)
    assert len(found.triangles) == STL.count_rows(tmp_path / "mesh.stl", "triangles")
    assert np.allclose(found.face_normals, trimesh.triangles.normals(expected)[0], atol=1e-5)


@pytest.mark.parametrize("grid", PLACES.values(), ids=list(PLACES))
@pytest.mark.parametrize("voids", [0, 40])
def test_solids_of_every_place_are_closed(tmp_path, grid, voids):
    height = US_FOOT if grid is PLACES["feet"] else Height("b1")
    mesh = terrain(grid, voids=voids, height=height)
    found = trimesh.load(write(mesh, tmp_path / "mesh.stl", 990.0))
    triangles, rows, _ = kept(mesh)
    assert (len(rows) < len(mesh.triangles)) == bool(voids)
    assert found.is_watertight
    assert found.is_winding_consistent
    expected = prism_volume(local(mesh), triangles, 990.0 * height.metres)
    assert found.volume == pytest.approx(expected, rel=1e-5)
    assert STL.count_rows(tmp_path / "mesh.stl", "triangles") == len(rows)


@pytest.mark.parametrize("name", ["colorado_dem_float32_epsg4269.tif", "rmnp_dem.tif"])
def test_solids_of_the_samples_are_closed(tmp_path, name):
    mesh = geomesh.mesh_raster(SAMPLES / name, nodes=1500, effort="fast", z=1)
    base = float(np.floor(np.nanmin(mesh.heights)) - 50)
    found = trimesh.load(write(mesh, tmp_path / "mesh.stl", base))
    assert found.is_watertight
    assert found.is_winding_consistent
    triangles, rows, _ = kept(mesh)
    volume = prism_volume(local(mesh), triangles, base)
    assert found.volume == pytest.approx(volume, rel=1e-6)
    assert np.count_nonzero(found.face_normals[:, 2] > 1e-6) == len(rows)


def test_the_header_and_the_notes_say_where_the_origin_is(tmp_path):
    path = tmp_path / "mesh.stl"
    with pytest.warns(GeomeshWarning) as told:
        write(terrain(PLACES["feet"], height=US_FOOT, voids=5), path)
    texts = [str(warning.message) for warning in told]
    assert re.fullmatch(
        r"STL holds metres east and north of x 600000, y 200000 \(EPSG:2263\), heights in metres "
        r"\(from US survey foot\), rounded to 2e-05 m",
        texts[0],
    )
    assert re.fullmatch(r"\d+ of \d+ triangles have no heights and are left out", texts[1])
    with pytest.warns(GeomeshWarning, match="metres east and north of x 500000, y 7000000 "):
        write(terrain(), path)
    header = path.read_bytes()[:80]
    assert header.startswith(b"geomesh STL: metres from x 500000 y 7000000 EPSG:32723, z up ")
    with pytest.raises(KeyError, match="no room"):
        STL.read_document(path)


@pytest.mark.parametrize("base", [1001.0, 1500.0, float("nan"), float("inf"), float("-inf")])
def test_a_base_that_is_not_below_is_refused_with_the_lowest_height(tmp_path, base):
    mesh = terrain()
    lowest = f"lowest height is {np.nanmin(mesh.heights):.10g} \\(in metre\\)"
    with pytest.raises(OutputError, match=lowest) as caught:
        write(mesh, tmp_path / "mesh.stl", base)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_base_that_rounding_raises_to_the_surface_is_refused(tmp_path):
    mesh = terrain()
    lowest = float(np.nanmin(mesh.heights))
    with pytest.raises(OutputError, match="choose a lower `solid`"):
        write(mesh, tmp_path / "mesh.stl", np.nextafter(lowest, 0))


def test_triangles_that_would_vanish_are_refused(tmp_path):
    far = Grid(50, 40, Affine(1e-3, 0, 1e6, 0, -1e-3, 1e6), GEOREFERENCES["north-up"].crs)
    small = replace(terrain(far), grid=far)
    write(small, tmp_path / "near.stl")  # around its own origin, at 1000 km, rounding is enough
    mesh = two_triangles()
    nodes = np.array([[0, 0], [1e-6, 0], [1e7, 1e7], [0, 1e7]])
    wide = replace(mesh, nodes=nodes, height=Height("b1"))
    wide = replace(wide, node_table=terrain(count=4).node_table)
    with pytest.raises(OutputError, match=r"would vanish or turn over .* write \.ply"):
        STL.write(*prepared(wide, tmp_path / "wide.stl"))


def prepared(mesh, path):
    from queue import SimpleQueue

    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.format import LayerFile

    file = LayerFile(mesh, "triangles", path, STL, "{}")
    return STL.layer(mesh, "triangles", PLAIN), file, BatchStream(SimpleQueue()), None


def test_a_mesh_without_heights_is_refused(tmp_path):
    with pytest.raises(OutputError, match="STL needs heights, and the mesh has none"):
        write(two_triangles(), tmp_path / "mesh.stl")
    with pytest.raises(OutputError, match="no triangle of the mesh has any"):
        write(terrain(voids=200), tmp_path / "mesh.stl", 5.0)


def test_damaged_files_are_noticed(tmp_path):
    path = write(terrain(), tmp_path / "mesh.stl", 900.0)
    whole = path.read_bytes()
    for content in (whole[:-1], whole[: len(whole) // 2], whole[:83], b"", whole + b"x"):
        path.write_bytes(content)
        with pytest.raises(OSError, match="damaged"):
            STL.count_rows(path, "triangles")
    path.write_bytes(whole[:96] + struct.pack("<f", np.nan) + whole[100:])
    with pytest.raises(OSError, match="without a place"):
        STL.count_rows(path, "triangles")
