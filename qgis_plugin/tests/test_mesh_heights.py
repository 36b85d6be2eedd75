"""Files with heights as mesh layers: PLY and UGRID, with their coordinates, CRS and data."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from qgis.core import QgsMesh, QgsMeshDatasetIndex, QgsMeshLayer

# Runs where geomesh is: writes the files, and what they should hold.
WRITE = """
import sys, warnings
import numpy as np
import geomesh
warnings.simplefilter("ignore")
source, folder = sys.argv[1:]
mesh = geomesh.mesh_raster(source, nodes=300, effort="fast", z=1)
for name in ("mesh.ply", "mesh.nc"):
    mesh.to_file(f"{folder}/{name}")
columns = mesh.attributes("triangles")
np.savez(
    f"{folder}/expected.npz",
    places=np.column_stack([mesh.map_nodes, mesh.heights]),
    triangles=mesh.triangles,
    **{name: columns[name] for name in ("slope", "area", "b1_mean", "count")},
)
"""


@pytest.fixture(scope="module")
def written(geomesh_python, samples, tmp_path_factory):
    """A folder with the sample DEM as PLY and UGRID, and what they should hold."""
    folder = tmp_path_factory.mktemp("heights")
    command = [geomesh_python, "-c", WRITE, samples / "rmnp_dem.tif", folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def values_of(layer, name):
    """Return the values of a group of data, and whether they are on vertices."""
    provider = layer.dataProvider()
    for group in range(provider.datasetGroupCount()):
        about = provider.datasetGroupMetadata(group)
        if about.name() == name:
            on_vertices = about.dataType() == about.DataType.DataOnVertices
            count = provider.vertexCount() if on_vertices else provider.faceCount()
            block = provider.datasetValues(QgsMeshDatasetIndex(group, 0), 0, count)
            return [block.value(k).scalar() for k in range(count)], on_vertices
    raise AssertionError(f"no data with the name {name}")


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.nc"])
def test_a_mesh_layer_has_the_heights(written, name):
    expected = np.load(written / "expected.npz")
    layer = QgsMeshLayer(str(written / name), "mesh", "mdal")
    assert layer.isValid(), layer.error().message()
    assert layer.crs().authid() == "EPSG:4326"
    mesh = QgsMesh()
    layer.dataProvider().populateMesh(mesh)
    found = [mesh.vertex(k) for k in range(mesh.vertexCount())]
    places = np.array([(point.x(), point.y(), point.z()) for point in found])
    assert np.array_equal(places, expected["places"])
    faces = np.array([mesh.face(k) for k in range(mesh.faceCount())])
    assert np.array_equal(faces, expected["triangles"])
    heights, on_vertices = values_of(layer, "Bed Elevation")
    assert on_vertices
    assert np.allclose(heights, expected["places"][:, 2], rtol=1e-12)
    for column in ("slope", "area", "b1_mean", "count"):
        values, on_vertices = values_of(layer, column)
        assert not on_vertices
        assert np.allclose(values, expected[column], rtol=1e-12, equal_nan=True), column


def test_a_ply_has_the_colours_and_the_band_on_its_vertices(written):
    layer = QgsMeshLayer(str(written / "mesh.ply"), "mesh", "mdal")
    band, on_vertices = values_of(layer, "b1")
    assert on_vertices
    assert np.allclose(band, np.load(written / "expected.npz")["places"][:, 2])
    for color in ("red", "green", "blue"):
        levels, on_vertices = values_of(layer, color)
        assert on_vertices
        assert 0 <= min(levels) < max(levels) <= 255
