"""A TIN in the formats for terrain, as QGIS itself opens it: 2DM as a mesh, DXF as vectors."""

from __future__ import annotations

import subprocess

import pytest
from qgis.core import QgsMesh, QgsMeshDatasetIndex, QgsMeshLayer, QgsVectorLayer, QgsWkbTypes

# Writes a TIN, with a void, to files, and prints its points and triangles.
WRITE = """
import json, sys, warnings
import numpy as np
from affine import Affine
import geomesh
warnings.simplefilter("ignore")
y, x = np.mgrid[0:40, 0:50]
heights = (1500 + 40 * np.sin(x / 7) + 30 * np.cos(y / 5)).astype(np.float64)
heights[10:20, 10:25] = np.nan
source = (heights[None], Affine(30, 0, 482315.25, 0, -30, 4400123.5), "EPSG:32613")
mesh = geomesh.mesh_raster(source, preset="adaptive", max_error=2, z=1)
for path in sys.argv[1:]:
    mesh.to_file(path)
kept = np.isfinite(mesh.heights[mesh.triangles]).all(axis=1)
places = np.column_stack([mesh.map_nodes, mesh.heights])
print(json.dumps(places[mesh.triangles[kept]].tolist()))
"""


@pytest.fixture(scope="module")
def tin(geomesh_python, tmp_path_factory):
    """The folder of the files, and the corners of the triangles."""
    import json

    folder = tmp_path_factory.mktemp("tin")
    paths = [str(folder / name) for name in ("tin.2dm", "tin.dxf")]
    done = subprocess.run(
        [str(geomesh_python), "-c", WRITE, *paths],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def test_2dm_is_a_mesh_layer_with_heights(tin, project):
    folder, corners = tin
    layer = QgsMeshLayer(str(folder / "tin.2dm"), "tin", "mdal")
    assert layer.isValid()
    provider = layer.dataProvider()
    mesh = QgsMesh()
    provider.populateMesh(mesh)
    assert mesh.faceCount() == len(corners)
    found = [
        [
            [point.x(), point.y(), point.z()]
            for point in (mesh.vertex(node) for node in mesh.face(row))
        ]
        for row in range(mesh.faceCount())
    ]
    assert found == corners
    # Colours come from the group of heights, which is the only one.
    assert provider.datasetGroupCount() == 1
    assert provider.datasetGroupMetadata(0).name() == "Bed Elevation"
    values = provider.datasetValues(QgsMeshDatasetIndex(0, 0), 0, mesh.vertexCount())
    heights = [mesh.vertex(node).z() for node in range(mesh.vertexCount())]
    assert [values.value(node).scalar() for node in range(mesh.vertexCount())] == heights


def test_dxf_is_a_vector_layer_with_heights(tin, project):
    folder, corners = tin
    layer = QgsVectorLayer(f"{folder / 'tin.dxf'}|layername=entities", "tin", "ogr")
    assert layer.isValid()
    found, lines = [], 0
    for feature in layer.getFeatures():
        if feature["Layer"] != "TIN":
            assert feature["Layer"] == "OUTLINE"
            lines += 1
            continue
        geometry = feature.geometry()
        assert QgsWkbTypes.hasZ(geometry.wkbType())
        found.append([[point.x(), point.y(), point.z()] for point in geometry.vertices()][:3])
    assert found == corners
    assert lines == 2  # the outer ring, and that around the void
