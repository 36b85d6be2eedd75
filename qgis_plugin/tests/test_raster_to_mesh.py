"""`geomesh:rastertomesh` on a real raster. QGIS itself computes the expected values."""

from __future__ import annotations

import pytest
from meshing import ALGORITHM, Listener, open_layer, total_area
from qgis.core import (
    QgsRasterLayer,
)


@pytest.fixture(scope="module")
def olinda_mesh(provider, processing, tmp_path_factory, olinda):
    """A mesh of the Olinda scene, made once."""
    folder = tmp_path_factory.mktemp("olinda")
    return processing.run(
        ALGORITHM,
        {
            "INPUT": str(olinda),
            "OUTPUT": str(folder / "olinda.gpkg"),
            "MESH": str(folder / "olinda.nc"),
        },
        feedback=Listener(),
    )


def test_layers_are_there_with_their_crs(olinda_mesh):
    triangles = open_layer(olinda_mesh["OUTPUT"])
    nodes = open_layer(olinda_mesh["NODES_LAYER"])
    edges = open_layer(olinda_mesh["EDGES_LAYER"])
    assert triangles.featureCount() == olinda_mesh["TRIANGLE_COUNT"] > 1000
    assert nodes.featureCount() == olinda_mesh["NODE_COUNT"] > 500
    # Euler's formula for one component without holes.
    assert nodes.featureCount() - edges.featureCount() + triangles.featureCount() == 1
    for layer in (triangles, nodes, edges):
        assert layer.crs().authid() == "EPSG:31985"


def test_triangles_cover_the_raster_exactly(olinda_mesh, olinda):
    raster = QgsRasterLayer(str(olinda), "raster")
    triangles = open_layer(olinda_mesh["OUTPUT"])
    extent = raster.extent()
    assert total_area(triangles) == pytest.approx(extent.width() * extent.height(), rel=1e-9)
    assert triangles.extent().xMinimum() == pytest.approx(extent.xMinimum(), abs=1e-6)
    assert triangles.extent().yMaximum() == pytest.approx(extent.yMaximum(), abs=1e-6)


def test_statistics_are_those_of_qgis(olinda_mesh, olinda, processing):
    """QGIS also counts pixels by their centre. Centres on an edge may make a difference."""
    found = processing.run(
        "native:zonalstatisticsfb",
        {
            "INPUT": olinda_mesh["OUTPUT"],
            "INPUT_RASTER": str(olinda),
            "RASTER_BAND": 1,
            "COLUMN_PREFIX": "q_",
            "STATISTICS": [0, 2],
            "OUTPUT": "TEMPORARY_OUTPUT",
        },
    )["OUTPUT"]
    compared = 0
    for feature in found.getFeatures():
        # For small triangles, QGIS weights pixels by area instead.
        if feature["count"] == feature["q_count"] and feature["count"] > 5:
            assert feature["red_mean"] == pytest.approx(feature["q_mean"], abs=1e-9)
            compared += 1
    assert compared > 0.9 * sum(feature["count"] > 5 for feature in found.getFeatures())


def test_style_travels_with_the_geopackage(olinda_mesh):
    triangles = open_layer(olinda_mesh["OUTPUT"])
    symbol = triangles.renderer().symbol()
    properties = symbol.symbolLayer(0).dataDefinedProperties()
    from qgis.core import QgsSymbolLayer

    fill = properties.property(QgsSymbolLayer.Property.PropertyFillColor)
    assert fill.field() == "color"
    nodes = open_layer(olinda_mesh["NODES_LAYER"])
    assert nodes.renderer().classAttribute() == "kind"
    assert [found.value() for found in nodes.renderer().categories()] == ["refined", "border"]


def test_every_edge_and_node_has_a_category(olinda_mesh):
    from qgis.core import QgsRenderContext

    for name in ("NODES_LAYER", "EDGES_LAYER"):
        layer = open_layer(olinda_mesh[name])
        context = QgsRenderContext()
        renderer = layer.renderer().clone()
        context.expressionContext().appendScopes(_scopes(layer))
        renderer.startRender(context, layer.fields())
        seen = set()
        for feature in layer.getFeatures():
            context.expressionContext().setFeature(feature)
            assert renderer.willRenderFeature(feature, context)
            seen |= renderer.legendKeysForFeature(feature, context)
        renderer.stopRender(context)
        assert len(seen) == 2


def _scopes(layer):
    from qgis.core import QgsExpressionContextUtils

    return QgsExpressionContextUtils.globalProjectLayerScopes(layer)


def test_capitals_in_an_extension(run, olinda):
    made = run(olinda, "CAP.GPKG", NODES=80)
    assert open_layer(made["OUTPUT"]).renderer().symbol().symbolLayerCount() == 2
    nodes = open_layer(made["NODES_LAYER"])
    assert nodes.renderer().classAttribute() == "kind"


def test_mesh_layer_has_faces_crs_and_flat_colours(olinda_mesh):
    from qgis.core import (
        QgsColorRampShader,
        QgsMeshDatasetIndex,
        QgsMeshLayer,
        QgsMeshRendererScalarSettings,
    )

    layer = QgsMeshLayer(olinda_mesh["MESH"], "mesh", "mdal")
    assert layer.isValid()
    assert layer.crs().authid() == "EPSG:31985"
    assert layer.dataProvider().faceCount() == olinda_mesh["TRIANGLE_COUNT"]
    assert layer.dataProvider().vertexCount() == olinda_mesh["NODE_COUNT"]
    assert layer.loadDefaultStyle()[1]
    settings = layer.rendererSettings()
    group = settings.activeScalarDatasetGroup()
    assert layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0)).name() == "color"
    scalar = settings.scalarSettings(group)
    assert scalar.dataResamplingMethod() == QgsMeshRendererScalarSettings.DataResamplingMethod(0)
    shader = scalar.colorRampShader()
    assert shader.colorRampType() == QgsColorRampShader.Type.Exact
    for item in shader.colorRampItemList():
        assert item.label == item.color.name()
        assert int(item.label[1:], 16) == item.value


def test_mesh_layer_says_what_the_triangles_say(olinda_mesh):
    from qgis.core import QgsMeshDatasetIndex, QgsMeshLayer

    layer = QgsMeshLayer(olinda_mesh["MESH"], "mesh", "mdal")
    provider = layer.dataProvider()
    names = {
        layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0)).name(): group
        for group in layer.datasetGroupsIndexes()
    }
    for name in ("area", "red_mean", "count"):
        block = provider.datasetValues(QgsMeshDatasetIndex(names[name], 0), 0, provider.faceCount())
        expected = {
            feature["id"]: feature[name]
            for feature in open_layer(olinda_mesh["OUTPUT"]).getFeatures()
        }
        for row, value in expected.items():
            assert block.value(row).scalar() == pytest.approx(value, rel=1e-12)
