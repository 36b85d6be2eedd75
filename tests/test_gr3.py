"""gr3 and fort.14 files, read as SCHISM and ADCIRC do: line by line, by the numbers that they tell.

The packages that read them (adcircpy, pyschism) need versions of libraries that geomesh does not.
"""

from __future__ import annotations

import numpy as np
import pytest

from geomesh.errors import OutputError
from geomesh.formats.document import build_document
from geomesh.formats.gr3 import FORMAT as GR3
from support.meshes import GEOREFERENCES, frame_mesh, provenance
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
    """What a model reads of a file; its depths are given back as heights."""

    def __init__(self, path):
        lines = iter(path.read_text("utf-8").split("\n"))
        self.title = next(lines)
        triangles, nodes = map(int, next(lines).split())
        table = [next(lines).split() for _ in range(nodes)]
        assert [int(row[0]) for row in table] == list(range(1, nodes + 1))
        assert {len(row) for row in table} == {4}
        self.points = np.array([row[1:] for row in table], float) * (1, 1, -1)
        table = [next(lines).split() for _ in range(triangles)]
        assert [row[:2] for row in table] == [[str(k), "3"] for k in range(1, triangles + 1)]
        assert {len(row) for row in table} == {5}
        self.corners = self.points[np.array([row[2:] for row in table], int) - 1]
        assert [int(next(lines).split()[0]) for _ in range(2)] == [0, 0]
        count, total = (int(next(lines).split()[0]) for _ in range(2))
        self.rings = []
        for _ in range(count):
            length, kind = map(int, next(lines).split()[:2])
            nodes_of_ring = [int(next(lines)) for _ in range(length)]
            self.rings.append((kind, self.points[np.array(nodes_of_ring) - 1]))
            total -= length
        assert total == 0
        assert all(line.startswith("! ") for line in [*lines][:-1])

    def edges(self):
        outer = [ring for kind, ring in self.rings if kind == 0]
        islands = [ring for kind, ring in self.rings if kind == 1]
        return edges_of(outer) + edges_of(islands, closed=True)


def area(ring):
    x, y = ring[:, :2].T - ring[0, :2, None]
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("name", ["mesh.gr3", "fort.14"])
def test_the_surface_of_a_dem_is_read_back_to_the_last_bit(tmp_path, name):
    mesh = utm_tin()
    path, told = write(mesh, tmp_path / name)
    read, wanted = Read(path), expected(mesh)
    assert np.array_equal(read.corners, wanted.corners)
    assert is_counter_clockwise(read.corners)
    assert len(read.edges()) == len(wanted.outline)
    assert set(read.edges()) == wanted.outline
    assert told == ["the third number of a node is the depth, positive down: minus the height"]
    assert GR3.count_rows(path, "triangles") == len(wanted.corners)
    assert GR3.read_document(path) == build_document(mesh, mesh.certify())


def test_the_mesh_is_to_the_left_of_its_boundaries(tmp_path):
    mesh = with_voids(small_tin(), [0, 7])
    read, wanted = Read(write(mesh, tmp_path / "mesh.gr3")[0]), expected(mesh)
    assert np.array_equal(read.corners, wanted.corners)
    kinds = [kind for kind, _ in read.rings]
    assert kinds[0] == 0
    assert 1 in kinds
    for kind, ring in read.rings:
        assert (area(ring) > 0) == (kind == 0)
        assert np.array_equal(ring[0], ring[-1]) == (kind == 0)
    assert set(read.edges()) == wanted.outline
    inside = sum(area(ring) for _, ring in read.rings)
    one, other = (wanted.corners[:, k] - wanted.corners[:, 0] for k in (1, 2))
    assert inside == pytest.approx(np.cross(one, other)[:, 2].sum() / 2)


def test_depths_are_in_metres(tmp_path):
    mesh = small_tin("EPSG:2232", "US survey foot")
    path, told = write(mesh, tmp_path / "mesh.gr3")
    heights = mesh.heights[mesh.triangles]
    assert Read(path).corners[:, :, 2] == pytest.approx(heights * 1200 / 3937, rel=1e-14)
    assert "minus the height, converted from US survey foot to metre" in told[0]
    assert told[1].startswith("x and y are in US survey foot, but ADCIRC and SCHISM expect metres")
    assert "; heights in US survey foot; in this file depths in metre, positive down" in (
        path.read_text("utf-8")
    )


@pytest.mark.parametrize("grid", ["geographic", "no CRS", "flipped", "rotated"])
def test_degrees_and_pixels_are_written_as_they_are(tmp_path, grid):
    mesh = frame_mesh(GEOREFERENCES[grid], height=small_tin().height)
    path, told = write(mesh, tmp_path / "mesh.gr3")
    assert np.array_equal(Read(path).corners, expected(mesh).corners)
    assert "-0.0\n" not in path.read_text("utf-8")
    assert len(told) == 1


def test_a_mesh_without_heights_is_refused(tmp_path):
    with pytest.raises(OutputError, match="gr3 needs heights, and the mesh has none"):
        write(frame_mesh(GEOREFERENCES["north-up"]), tmp_path / "mesh.gr3")
    assert list(tmp_path.iterdir()) == []


def test_any_name_is_a_title(tmp_path):
    mesh = small_tin(provenance=provenance(name=HOSTILE + "a" * 300, warnings=(HOSTILE,)))
    path, _ = write(mesh, tmp_path / "mesh.gr3")
    assert Read(path).title == "<&>\"'北京__--.tif".ljust(80, "a")
    assert GR3.read_document(path) == build_document(mesh, mesh.certify())


def test_damage_is_noticed(tmp_path):
    path, _ = write(small_tin(), tmp_path / "mesh.gr3")
    whole = path.read_bytes()
    parts = [whole[: int(kept * len(whole))] for kept in (0.0, 0.1, 0.2, 0.3, 0.5, 0.999)]
    parts += [whole.replace(b"\n5 3 ", b"\n5 3 99", 1), whole.replace(b"\n3 48", b"\n3 x48", 1)]
    parts += [whole.replace(b"\n5 = Total", b"\n6 = Total", 1)]
    for part in parts:
        assert part != whole
        path.write_bytes(part)
        with pytest.raises(OSError, match="damaged"):
            GR3.count_rows(path, "triangles")
    path.write_bytes(b"title\n0 0\n")
    with pytest.raises(KeyError):
        GR3.read_document(path)
