"""Results in the project: loaded, in order, with styles and how they were made."""

from __future__ import annotations

import json

import pytest
from painting import difference, paint
from qgis.core import (
    QgsMapLayerType,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterRasterLayer,
    QgsProject,
    QgsRasterLayer,
    QgsVectorLayer,
)
from qgis.PyQt.QtGui import QColor, QImage

FEATURES = 0  # the place of the preset


def test_layers_are_named_after_the_raster_and_ordered(loaded, project, tmp_path):
    layers = loaded(PRESET=FEATURES, LAYERS=[0, 1, 2], MESH=str(tmp_path / "mesh.nc"))
    name = "olinda_landsat7_rgb_uint8"
    tree = [node.name() for node in project.layerTreeRoot().findLayers()]
    assert tree == [f"{part} · {name}" for part in ("nodes", "edges", "triangles", "mesh")]
    assert set(tree) == set(layers)
    assert all(layer.isValid() for layer in layers.values())
    assert layers[f"mesh · {name}"].type() == QgsMapLayerType.MeshLayer


def test_only_the_layers_asked_for(loaded):
    assert [name.partition(" ")[0] for name in loaded(LAYERS=[2], NODES=100)] == ["nodes"]


def test_recipe_and_certificate_are_in_the_layer_properties(loaded):
    layer = next(layer for name, layer in loaded(NODES=150).items() if name.startswith("triangles"))
    metadata = layer.metadata()
    assert "150 nodes" in metadata.abstract()
    assert "canny_low: not set\n" in metadata.abstract()
    assert "Canny's low threshold that was used: 1" in metadata.abstract()
    assert "<" not in metadata.abstract()
    assert "the mesh has the number of nodes that was wanted" in metadata.abstract()
    assert metadata.crs().authid() == "EPSG:31985"
    assert any("olinda_landsat7_rgb_uint8.tif" in line for line in metadata.history())
    assert json.loads(layer.customProperty("geomesh/recipe"))["nodes"] == 150


def test_without_a_crs_edges_and_nodes_always_show(loaded, samples):
    """Without a CRS, the scale of the map has no meaning."""
    raster = samples / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
    for layer in loaded(INPUT=str(raster)).values():
        assert not layer.crs().isValid()
        assert not layer.hasScaleBasedVisibility()


def test_project_keeps_layers_style_and_recipe(loaded, project, tmp_path):
    loaded(NODES=200, MESH=str(tmp_path / "mesh.nc"))
    file = str(tmp_path / "project.qgz")
    assert project.write(file)
    project.clear()
    assert QgsProject.instance().read(file)
    layers = {layer.name().partition(" ")[0]: layer for layer in project.mapLayers().values()}
    assert set(layers) == {"triangles", "nodes", "mesh"}
    assert layers["triangles"].crs().authid() == "EPSG:31985"
    assert layers["triangles"].renderer().symbol().symbolLayerCount() == 2
    assert json.loads(layers["nodes"].customProperty("geomesh/recipe"))["nodes"] == 200
    assert layers["mesh"].rendererSettings().activeScalarDatasetGroup() >= 0


def test_quality_of_a_loaded_mesh(loaded, tmp_path):
    layers = loaded(NODES=200)
    nodes = next(layer for name, layer in layers.items() if name.startswith("nodes"))
    layers = loaded(
        "geomesh:meshquality", INPUT=nodes.id(), OUTPUT=str(tmp_path / "measured.gpkg"), SPACE=1
    )
    layer = layers["triangles · mesh, measured"]
    assert {"ki", "map_ki", "map_radius_ratio", "color"} <= set(layer.fields().names())
    renderer = layer.renderer()
    assert renderer.classAttribute() == "map_min_angle"
    assert [found.upperValue() for found in renderer.ranges()] == [10, 20, 30, 45, 60]


# A model: the next algorithm gets the results, and only the model's outputs are loaded


@pytest.fixture
def model(provider):
    return make_model()


def make_model(preset=None):
    model = QgsProcessingModelAlgorithm("mesh and measure", "tests")
    raster = QgsProcessingModelParameter("raster")
    model.addModelParameter(QgsProcessingParameterRasterLayer("raster", "Raster"), raster)
    source = QgsProcessingModelChildParameterSource
    meshing = QgsProcessingModelChildAlgorithm("geomesh:rastertomesh")
    meshing.setChildId("mesh")
    meshing.addParameterSources("INPUT", [source.fromModelParameter("raster")])
    for name, value in (("NODES", 120), *(preset or {}).items()):
        meshing.addParameterSources(name, [source.fromStaticValue(value)])
    model.addChildAlgorithm(meshing)
    measuring = QgsProcessingModelChildAlgorithm("geomesh:meshquality")
    measuring.setChildId("measure")
    measuring.addParameterSources("INPUT", [source.fromChildOutput("mesh", "OUTPUT")])
    output = QgsProcessingModelOutput("measured", "Measured mesh")
    output.setChildId("measure")
    output.setChildOutputName("OUTPUT")
    measuring.setModelOutputs({"measured": output})
    model.addChildAlgorithm(measuring)
    return model


def test_model(model, olinda, project):
    context = QgsProcessingContext()
    context.setProject(project)
    feedback = QgsProcessingFeedback(False)
    (output,) = (found.name() for found in model.destinationParameterDefinitions())
    given = {"raster": str(olinda), output: "TEMPORARY_OUTPUT"}
    assert model.checkParameterValues(given, context) == (True, "")
    results, passed = model.run(given, context, feedback, {}, False)
    assert passed
    layer = QgsVectorLayer(results[output], "measured", "ogr")
    assert layer.isValid()
    assert "radius_ratio" in layer.fields().names()
    assert results["CHILD_RESULTS"]["mesh"]["NODE_COUNT"] <= 120
    assert context.layersToLoadOnCompletion() == {}


def test_model_with_an_adaptive_mesh(provider, olinda, project):
    model = make_model({"PRESET": 2, "GOAL": 2, "ERROR": "30", "EFFORT": 0, "MIN_ANGLE": 5})
    context = QgsProcessingContext()
    context.setProject(project)
    (output,) = (found.name() for found in model.destinationParameterDefinitions())
    given = {"raster": str(olinda), output: "TEMPORARY_OUTPUT"}
    results, passed = model.run(given, context, QgsProcessingFeedback(False), {}, False)
    assert passed
    layer = QgsVectorLayer(results[output], "measured", "ogr")
    assert "red_rmse" in layer.fields().names()
    assert results["CHILD_RESULTS"]["measure"]["MIN_ANGLE"] >= 5


def test_model_loads_what_it_calls_its_output(model, olinda, project, processing):
    (output,) = (found.name() for found in model.destinationParameterDefinitions())
    processing.runAndLoadResults(model, {"raster": str(olinda), output: "TEMPORARY_OUTPUT"})
    (name,) = (layer.name() for layer in project.mapLayers().values())
    assert name in ("measured", "Measured mesh")


# Appearance of the map


@pytest.mark.parametrize("sample", ["olinda_landsat7_rgb_uint8", "rmnp_rgb"])
def test_the_map_looks_like_the_image(loaded, samples, project, sample):
    raster = QgsRasterLayer(str(samples / f"{sample}.tif"), "raster")
    layers = loaded(INPUT=str(samples / f"{sample}.tif"))
    seen = {name.partition(" ")[0]: layer for name, layer in layers.items()}
    expected = paint([raster], raster.extent())
    triangles = paint([seen["triangles"]], raster.extent())
    blank = QImage(300, 300, QImage.Format.Format_RGB32)
    blank.fill(QColor("gray"))
    assert difference(expected, blank) > 25  # a wrong image is detected
    assert difference(expected, triangles) < 20  # edges are drawn over the colours
    near = raster.extent()
    near.scale(0.2)
    both = paint([seen["nodes"], seen["triangles"]], near)
    assert difference(paint([seen["triangles"]], near), both) > 0  # the nodes are visible


@pytest.mark.parametrize("sample", ["olinda_landsat7_rgb_uint8", "rmnp_rgb"])
def test_a_mesh_layer_of_features_looks_like_the_image(loaded, samples, tmp_path, project, sample):
    """For the layers of a linear surface see test_surface.py."""
    raster = QgsRasterLayer(str(samples / f"{sample}.tif"), "raster")
    given = {"INPUT": str(samples / f"{sample}.tif"), "MESH": str(tmp_path / "mesh.nc")}
    layers = loaded(PRESET=FEATURES, **given)
    (mesh,) = (layer for name, layer in layers.items() if name.startswith("mesh "))
    expected = paint([raster], raster.extent())
    assert difference(expected, paint([mesh], raster.extent())) < 6


def test_from_afar_neither_edges_nor_nodes_hide_the_image(loaded, olinda):
    layers = loaded()
    seen = {name.partition(" ")[0]: layer for name, layer in layers.items()}
    extent = seen["triangles"].extent()
    extent.scale(60)
    small = paint([seen["nodes"], seen["triangles"]], extent)
    alone = paint([seen["triangles"]], extent)
    assert small == alone
    assert seen["nodes"].minimumScale() > 0
