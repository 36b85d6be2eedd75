"""Properties of a layer that its file does not have; extents and masks."""

from __future__ import annotations

import pytest
from meshing import Listener, open_layer, total_area
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsFeature,
    QgsGeometry,
    QgsProcessingFeatureSourceDefinition,
    QgsRasterLayer,
    QgsRasterRange,
    QgsVectorLayer,
)

SIDE = 28.5  # side of a pixel of the Olinda scene, in metres


def test_crs_of_the_layer_wins(run, olinda, project):
    layer = QgsRasterLayer(str(olinda), "olinda")
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32725"))
    project.addMapLayer(layer)
    assert open_layer(run(layer)["OUTPUT"]).crs().authid() == "EPSG:32725"


def test_crs_without_a_code(run, olinda, project):
    layer = QgsRasterLayer(str(olinda), "olinda")
    custom = QgsCoordinateReferenceSystem.fromProj("+proj=laea +lat_0=-8 +lon_0=-35 +ellps=GRS80")
    layer.setCrs(custom)
    project.addMapLayer(layer)
    made = run(layer, NODES=100, MESH="TEMPORARY_OUTPUT")
    found = open_layer(made["OUTPUT"]).crs()
    assert found.isValid()
    assert "+proj=laea +lat_0=-8 +lon_0=-35" in found.toProj()


@pytest.fixture
def layer_with_nodata(project):
    """Set nodata values of a raster, as in Layer Properties > Transparency."""

    def declare(path, low, high, bands=(1, 2, 3)):
        layer = QgsRasterLayer(str(path), "raster")
        for band in bands:
            layer.dataProvider().setUserNoDataValue(band, [QgsRasterRange(low, high)])
        project.addMapLayer(layer)
        return layer

    return declare


def test_nodata_of_the_layer(run, olinda, layer_with_nodata):
    """If the file has no nodata value, the value of the layer is used."""
    from geomesh_qgis.inputs import describe_raster

    layer = layer_with_nodata(olinda, 255, 255)
    assert describe_raster(layer).options == ("--nodata", "255.0")
    assert run(layer, NODATA=255)["NODE_COUNT"] > 100


def test_nodata_of_the_layer_beside_that_of_the_file(run, samples, layer_with_nodata):
    """Both are used: the nodata value of the file and the one that the user added."""
    bahamas = samples / "bahamas_landsat7_rgb_nodata_collar.tif"
    collar = total_area(open_layer(run(bahamas, "file.gpkg")["OUTPUT"]))
    feedback = Listener()
    layer = layer_with_nodata(bahamas, 255, 255)
    both = total_area(open_layer(run(layer, "both.gpkg", feedback=feedback)["OUTPUT"]))
    assert 0.8 * collar < both < collar
    assert not any("nodata values of the layer" in warning for warning in feedback.warnings)


@pytest.mark.parametrize("bands", [(1, 2, 3), (2,)])
def test_nodata_that_cannot_be_used_is_told(run, olinda, layer_with_nodata, bands):
    feedback = Listener()
    run(layer_with_nodata(olinda, 0, 9, bands), feedback=feedback, NODES=50)
    assert any("geomesh does not use them" in warning for warning in feedback.warnings)


def test_open_options_of_the_layer(run, olinda, tmp_path, project):
    """The raster keeps its palette, and the source keeps its name."""
    from osgeo import gdal

    from geomesh_qgis.provenance import read_document

    paletted = tmp_path / "paletted.tif"
    made = gdal.Translate(str(paletted), str(olinda), bandList=[1])
    colors = gdal.ColorTable()
    for level in range(256):
        colors.SetColorEntry(level, (level, 255 - level, 40))
    made.GetRasterBand(1).SetColorTable(colors)
    made.FlushCache()
    layer = QgsRasterLayer(f"{paletted}|option:NUM_THREADS=2", "paletted")
    assert layer.isValid()
    project.addMapLayer(layer)
    output = run(layer, NODES=100)["OUTPUT"]
    assert any(name.endswith("_majority") for name in open_layer(output).fields().names())
    assert read_document(output.partition("|")[0])["source"]["name"] == layer.source()


def test_raster_without_georeference_lies_where_qgis_shows_it(run, samples, project):
    layer = QgsRasterLayer(str(samples / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"), "raster")
    project.addMapLayer(layer)
    made = run(layer)
    shown, found = layer.extent(), open_layer(made["OUTPUT"]).extent()
    assert (found.xMinimum(), found.yMinimum()) == (shown.xMinimum(), shown.yMinimum())
    assert (found.xMaximum(), found.yMaximum()) == (shown.xMaximum(), shown.yMaximum())
    assert shown.yMinimum() == -layer.height()
    # The mesh is not upside down: the pixel at a triangle's centre is within the triangle's range.
    for feature in list(open_layer(made["OUTPUT"]).getFeatures())[:200]:
        if feature["count"] > 3:
            value, known = layer.dataProvider().sample(feature.geometry().centroid().asPoint(), 1)
            assert known
            assert feature["b1_min"] <= value <= feature["b1_max"]


def test_layer_that_is_no_file_is_exported(run, olinda, project):
    """The example is a virtual raster, whose pixels QGIS computes."""
    source = QgsRasterLayer(str(olinda), "olinda")
    extent = source.extent()
    uri = (
        f"?crs=EPSG:31985&extent={extent.xMinimum()},{extent.yMinimum()},{extent.xMaximum()},"
        f"{extent.yMaximum()}&width={source.width()}&height={source.height()}"
        f'&formula="olinda@1" + 1&olinda:uri={olinda}&olinda:provider=gdal'
    )
    layer = QgsRasterLayer(uri, "computed", "virtualraster")
    assert layer.isValid()
    project.addMapLayer(layer)
    feedback = Listener()
    made = run(layer, feedback=feedback)
    assert feedback.warnings == []
    triangles = open_layer(made["OUTPUT"])
    for feature in list(triangles.getFeatures())[:200]:
        if feature["count"] > 3:
            value, known = source.dataProvider().sample(feature.geometry().centroid().asPoint(), 1)
            assert known
            assert feature["b1_min"] <= value + 1 <= feature["b1_max"]
    assert triangles.crs().authid() == "EPSG:31985"
    assert total_area(triangles) == pytest.approx(extent.width() * extent.height(), rel=1e-9)


def test_raster_in_memory_is_exported(run, olinda, project):
    from osgeo import gdal

    gdal.Translate("/vsimem/olinda.tif", str(olinda)).FlushCache()
    layer = QgsRasterLayer("/vsimem/olinda.tif", "in memory")
    project.addMapLayer(layer)
    made = run(layer, NODES=100)
    assert open_layer(made["OUTPUT"]).extent().width() == pytest.approx(layer.extent().width())
    project.removeMapLayer(layer)
    gdal.Unlink("/vsimem/olinda.tif")


# Extent and mask


def test_extent_in_another_crs(run, olinda):
    made = run(olinda, EXTENT="-34.9,-34.87,-8.02,-8.0 [EPSG:4326]")
    extent = open_layer(made["OUTPUT"]).extent()
    assert 3000 < extent.width() < 3600
    assert 2000 < extent.height() < 2600


def test_mask_of_the_selected_polygons(run, olinda, project):
    raster = QgsRasterLayer(str(olinda), "olinda").extent()
    mask = QgsVectorLayer("Polygon?crs=EPSG:31985", "areas", "memory")
    for left in (1000, 5000):
        feature = QgsFeature()
        x, y = raster.xMinimum() + left, raster.yMinimum() + 2000
        ring = f"{x} {y}, {x + 2000} {y}, {x + 2000} {y + 2000}, {x} {y + 2000}, {x} {y}"
        feature.setGeometry(QgsGeometry.fromWkt(f"Polygon(({ring}))"))
        mask.dataProvider().addFeature(feature)
    project.addMapLayer(mask)
    areas = []
    both = total_area(open_layer(run(olinda, "both.gpkg", MASK=mask)["OUTPUT"]))
    mask.selectByIds([2])
    selection = QgsProcessingFeatureSourceDefinition(mask.id(), selectedFeaturesOnly=True)
    made = open_layer(run(olinda, "one.gpkg", MASK=selection)["OUTPUT"])
    areas = [both, total_area(made)]
    # A mesh follows pixels, so each side may differ by up to half a pixel.
    assert areas == pytest.approx([8e6, 4e6], rel=4 * SIDE / 2000)
    assert made.extent().xMinimum() > raster.xMinimum() + 4900


def test_mask_without_a_crs_is_taken_in_that_of_the_raster(run, olinda, project):
    raster = QgsRasterLayer(str(olinda), "olinda").extent()
    mask = QgsVectorLayer("Polygon", "area", "memory")
    mask.setCrs(QgsCoordinateReferenceSystem())
    feature = QgsFeature()
    raster.scale(0.5)
    feature.setGeometry(QgsGeometry.fromRect(raster))
    mask.dataProvider().addFeature(feature)
    project.addMapLayer(mask)
    found = open_layer(run(olinda, MASK=mask)["OUTPUT"]).extent()
    assert found.width() == pytest.approx(raster.width(), rel=0.02)
