"""`geomesh:demtotin`: the TIN stays within its tolerance of the DEM, and QGIS shows its heights."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from meshing import Listener, open_layer
from painting import paint
from qgis.core import (
    QgsColorRampShader,
    QgsCoordinateReferenceSystem,
    QgsFeature,
    QgsGeometry,
    QgsMeshLayer,
    QgsPointXY,
    QgsProcessingContext,
    QgsProcessingException,
    QgsRasterLayer,
    QgsVectorLayer,
    QgsWkbTypes,
)
from terrain import write_dem

TIN = "geomesh:demtotin"


class Logger(Listener):
    """Feedback that also records the log."""

    def __init__(self, **options) -> None:
        super().__init__(**options)
        self.infos: list[str] = []

    def pushInfo(self, info: str) -> None:
        self.infos.append(info)


@pytest.fixture
def tin(provider, processing, tmp_path, project):
    """Make a TIN in the temporary folder of the test; return results and feedback."""

    def make(dem, feedback=None, **parameters):
        feedback = feedback or Logger()
        places = {"OUTPUT": str(tmp_path / "tin.nc"), "VECTORS": str(tmp_path / "tin.gpkg")}
        given = {"INPUT": str(dem) if isinstance(dem, Path) else dem, **places, **parameters}
        return processing.run(TIN, given, feedback=feedback), feedback

    return make


@pytest.fixture
def dem(tmp_path):
    return write_dem(tmp_path / "dem.tif")


def fault(provider, dem, **parameters) -> str:
    given = {"INPUT": str(dem), "OUTPUT": "tin.nc", "VECTORS": "tin.gpkg", **parameters}
    algorithm = provider.algorithm("demtotin").create()
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert "\n" not in reason
    return reason


def test_no_pixel_is_farther_than_the_tolerance(tin, samples):
    """QGIS itself reads the heights of nodes and pixels."""
    dem = samples / "colorado_dem_float32_epsg4269.tif"
    made, feedback = tin(dem)
    raster = QgsRasterLayer(str(dem), "dem")
    low, high = 2849.35, 3825.49
    assert made["TOLERANCE"] == pytest.approx((high - low) / 100, rel=1e-3)
    assert 0 < made["MAX_ERROR"] <= made["TOLERANCE"]
    told = next(info for info in feedback.infos if info.startswith("Tolerance"))
    assert "9.76, a hundredth of the range of heights (2849.35 to 3825.49)" in told
    assert any("greatest error 9.7" in info for info in feedback.infos)
    assert any("metres, which is assumed" in info for info in feedback.infos)
    layer = QgsMeshLayer(made["OUTPUT"], "tin", "mdal")
    assert layer.crs().authid() == "EPSG:4269"
    assert layer.dataProvider().faceCount() == made["TRIANGLE_COUNT"] > 1000
    assert layer.dataProvider().vertexCount() == made["NODE_COUNT"]
    extent = raster.extent()
    compared = 0
    triangles = open_layer(made["VECTORS"])
    assert QgsWkbTypes.hasZ(triangles.wkbType())
    for feature in triangles.getFeatures():
        (a, b, c, _) = feature.geometry().constGet().exteriorRing().points()
        x, y = (sum(getattr(p, axis)() for p in (a, b, c)) / 3 for axis in "xy")
        # The pixel whose centre is nearest; the surface is computed at that centre.
        size = raster.rasterUnitsPerPixelX()
        column, row = int((x - extent.xMinimum()) / size), int((extent.yMaximum() - y) / size)
        x, y = extent.xMinimum() + (column + 0.5) * size, extent.yMaximum() - (row + 0.5) * size
        if not feature.geometry().contains(QgsPointXY(x, y)):
            continue
        area = (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y())
        u = ((x - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (y - a.y())) / area
        v = ((b.x() - a.x()) * (y - a.y()) - (x - a.x()) * (b.y() - a.y())) / area
        surface = a.z() + u * (b.z() - a.z()) + v * (c.z() - a.z())
        pixel, _ = raster.dataProvider().sample(QgsPointXY(x, y), 1)
        assert abs(surface - pixel) <= made["TOLERANCE"] + 1e-6
        compared += 1
    assert compared > 1000


def test_most_nodes_come_before_the_tolerance(tin, dem):
    made, feedback = tin(dem, TOLERANCE=0.01, NODES=40, VECTORS=None)
    assert 30 < made["NODE_COUNT"] <= 40
    assert made["TOLERANCE"] == 0.01 < made["MAX_ERROR"]
    assert "VECTORS" not in made
    assert any("more than the 40 allowed" in warning for warning in feedback.warnings)


def test_breaklines_boundary_and_factor(tin, dem):
    def layer(kind, wkt):
        made = QgsVectorLayer(f"{kind}?crs=EPSG:32613", kind, "memory")
        feature = QgsFeature()
        feature.setGeometry(QgsGeometry.fromWkt(wkt))
        made.dataProvider().addFeature(feature)
        return made

    line = layer("LineString", "LineString(500100 4299900, 500500 4299500)")
    box = layer(
        "Polygon",
        "Polygon((500050 4299950, 500550 4299950, 500550 4299450, 500050 4299450, 500050 4299950))",
    )
    made, feedback = tin(
        dem, TOLERANCE=2, BREAKLINES=line, BOUNDARY=box, Z_FACTOR=1 / 0.3048, MIN_ANGLE=0
    )
    triangles, nodes = open_layer(made["VECTORS"]), open_layer(made["NODES_LAYER"])
    assert triangles.extent().width() == pytest.approx(500)
    assert "breakline" in nodes.uniqueValues(nodes.fields().indexOf("kind"))
    heights = [each.geometry().constGet().z() for each in nodes.getFeatures()]
    assert min(heights) > 80 / 0.3048 - 7
    assert any("in feet" in info for info in feedback.infos)
    far = layer("LineString", "LineString(0 0, 10 10)")
    _, feedback = tin(dem, BREAKLINES=far, OUTPUT="TEMPORARY_OUTPUT", VECTORS=None)
    assert any("no breakline is inside" in warning for warning in feedback.warnings)


def test_the_map_shows_bands_of_heights_between_round_levels(
    provider, processing, dem, tmp_path, project
):
    processing.runAndLoadResults(
        TIN,
        {"INPUT": str(dem), "OUTPUT": str(tmp_path / "tin.nc"), "VECTORS": "TEMPORARY_OUTPUT"},
    )
    layers = [node.layer() for node in project.layerTreeRoot().findLayers()]
    assert [layer.name() for layer in layers] == ["nodes · dem", "TIN of dem", "triangles · dem"]
    tin = layers[1]
    settings = tin.rendererSettings()
    scalar = settings.scalarSettings(settings.activeScalarDatasetGroup())
    shader = scalar.colorRampShader()
    assert shader.colorRampType() == QgsColorRampShader.Type.Discrete
    levels = [item.value for item in shader.colorRampItemList()]
    steps = {round(b - a, 9) for a, b in zip(levels, levels[1:])}
    assert steps == {5}
    assert len(levels) == 12
    lightness = [item.color.lightness() for item in shader.colorRampItemList()]
    assert lightness[0] < lightness[-1]
    colors = {
        image.pixel(x, y)
        for image in [paint([tin], tin.extent())]
        for x in range(0, 300, 3)
        for y in range(0, 300, 3)
    }
    assert 8 < len(colors) < 60  # bands; few more at their borders
    # The style is beside the file, and the layer knows the GeoPackage of its mesh.
    again = QgsMeshLayer(str(tmp_path / "tin.nc"), "again", "mdal")
    assert again.loadDefaultStyle()[1]
    from geomesh_qgis.meshes import find_mesh, name_of_mesh

    assert find_mesh(tin) == layers[2].source().partition("|")[0]
    assert {name_of_mesh(layer) for layer in layers} == {"dem"}


@pytest.mark.parametrize(
    ("change", "tolerance", "said"),
    [
        ({"height": lambda *_: 7.0, "crs": None}, 0.01, ""),
        (
            {"height": lambda x, y: math.nan if 20 < x < 40 > y > 20 else x, "unit": "us-ft"},
            0.59,
            "heights: in US survey feet",
        ),
    ],
    ids=["constant, without a CRS", "voids, in feet"],
)
def test_unusual_dems(tin, tmp_path, change, tolerance, said):
    dem = write_dem(tmp_path / "dem.tif", **change)
    made, feedback = tin(dem)
    assert made["TOLERANCE"] == pytest.approx(tolerance, abs=0.006)
    assert made["MAX_ERROR"] <= made["TOLERANCE"]
    assert any(said in info for info in feedback.infos)
    layer = QgsMeshLayer(made["OUTPUT"], "tin", "mdal")
    assert layer.isValid()
    assert layer.loadDefaultStyle()[1]
    area = math.fsum(each.geometry().area() for each in open_layer(made["VECTORS"]).getFeatures())
    voids = 19 * 19 * 100 if tolerance == 0.59 else 0
    assert area == pytest.approx(600 * 600 - voids, rel=1e-6)


def test_what_the_layer_says_counts(tin, tmp_path, project):
    """A nodata value and a CRS from the layer properties, and a scale in the file."""
    from osgeo import gdal
    from qgis.core import QgsRasterRange

    path = write_dem(tmp_path / "dem.tif", lambda x, _: -1 if x < 10 else x, crs=None)
    dataset = gdal.Open(str(path), gdal.GA_Update)
    dataset.GetRasterBand(1).SetScale(0.5)
    dataset.GetRasterBand(1).DeleteNoDataValue()
    del dataset
    layer = QgsRasterLayer(str(path), "scaled")
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32613"))
    layer.dataProvider().setUserNoDataValue(1, [QgsRasterRange(-1, -1)])
    made, _ = tin(layer)
    assert made["TOLERANCE"] == pytest.approx((59 - 10) * 0.5 / 100)
    assert open_layer(made["VECTORS"]).crs().authid() == "EPSG:32613"


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"TOLERANCE": 0}, "Tolerance is 0: give a height above 0"),
        ({"TOLERANCE": -5}, "Tolerance is -5: give a height above 0"),
        ({"TOLERANCE": "wide"}, "give a number"),
        ({"Z_FACTOR": 0}, "Z factor is 0"),
        ({"BAND": 2}, "has no band 2"),
        ({"OUTPUT": "tin.2dm"}, "does not end in .nc"),
        ({"OUTPUT": "/nowhere/tin.nc"}, "does not exist: create it first"),
        ({"VECTORS": "tin.fgb"}, "does not end in .gpkg"),
        ({"VECTORS": "/nowhere/tin.gpkg"}, "does not exist: create it first"),
    ],
)
def test_values_that_cannot_work_are_refused_at_once(provider, dem, parameters, expected):
    assert expected in fault(provider, dem, **parameters)


def test_classes_are_no_heights(provider, tmp_path):
    from osgeo import gdal

    path = tmp_path / "classes.tif"
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), 8, 8, 1)
    table = gdal.ColorTable()
    table.SetColorEntry(1, (255, 0, 0, 255))
    dataset.GetRasterBand(1).SetColorTable(table)
    del dataset
    assert "has classes, which are no heights" in fault(provider, path)


def test_cancelling_leaves_nothing(tin, dem, tmp_path):
    with pytest.raises(QgsProcessingException, match="Cancelled"):
        tin(dem, Logger(cancel=True))
    assert [path.name for path in tmp_path.iterdir()] == ["dem.tif"]


def test_an_empty_dem_is_refused(tin, tmp_path):
    dem = write_dem(tmp_path / "empty.tif", lambda *_: math.nan)
    with pytest.raises(QgsProcessingException) as caught:
        tin(dem)
    assert "\n" not in str(caught.value)
