"""`geomesh:rastertomesh` on real rasters: QGIS itself is the oracle."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from qgis.core import (
    Qgis,
    QgsCoordinateReferenceSystem,
    QgsFeature,
    QgsGeometry,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSourceDefinition,
    QgsProcessingFeedback,
    QgsRasterLayer,
    QgsRasterRange,
    QgsVectorLayer,
)

ALGORITHM = "geomesh:rastertomesh"
SIDE = 28.5  # of a pixel of the Olinda scene, in metres


class Listener(QgsProcessingFeedback):
    """Feedback that remembers, and can cancel at the first progress."""

    def __init__(self, *, cancel: bool = False) -> None:
        super().__init__(False)
        self.warnings: list[str] = []
        self.texts: list[str] = []
        self.percents: list[float] = []
        self._cancel = cancel
        self.progressChanged.connect(self._progress)

    def _progress(self, percent: float) -> None:
        self.percents.append(percent)
        if self._cancel:
            self.cancel()

    def pushWarning(self, warning: str) -> None:
        self.warnings.append(warning)

    def setProgressText(self, text: str) -> None:
        self.texts.append(text)


@pytest.fixture
def run(provider, processing, tmp_path, project):
    """Run the algorithm into a folder of the test."""

    def run(raster, output="mesh.gpkg", feedback=None, **parameters):
        given = {"INPUT": raster, "OUTPUT": str(tmp_path / output), **parameters}
        given = {name: str(v) if isinstance(v, Path) else v for name, v in given.items()}
        return processing.run(ALGORITHM, given, feedback=feedback or Listener())

    return run


@pytest.fixture(scope="module")
def olinda_mesh(provider, processing, tmp_path_factory, olinda):
    """The Olinda scene, meshed once."""
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


def open_layer(uri: str) -> QgsVectorLayer:
    layer = QgsVectorLayer(uri, "layer", "ogr")
    assert layer.isValid(), uri
    return layer


def total_area(layer: QgsVectorLayer) -> float:
    return math.fsum(feature.geometry().area() for feature in layer.getFeatures())


def test_layers_are_there_with_their_crs(olinda_mesh):
    triangles = open_layer(olinda_mesh["OUTPUT"])
    nodes = open_layer(olinda_mesh["NODES_LAYER"])
    edges = open_layer(olinda_mesh["EDGES_LAYER"])
    assert triangles.featureCount() == olinda_mesh["TRIANGLE_COUNT"] > 1000
    assert nodes.featureCount() == olinda_mesh["NODE_COUNT"] > 500
    # Euler: one component without holes.
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
    """QGIS counts pixels by their centre too; triangles with a centre on their edge may differ."""
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
        # Small ones QGIS weighs by area instead.
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
    assert [found.value() for found in nodes.renderer().categories()] == ["feature", "border"]


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


def test_progress_rises_to_the_end(run, olinda):
    feedback = Listener()
    run(olinda, feedback=feedback, MESH="TEMPORARY_OUTPUT", NODES=300)
    assert feedback.percents == sorted(feedback.percents)
    assert feedback.percents[-1] == 100
    assert "Measuring triangles" in feedback.texts


def test_node_budget_spacing_bands_and_recipe(run, olinda):
    made = run(
        olinda,
        NODES=200,
        MIN_SPACING=4,
        BANDS=[3, 1],
        CANNY_LOW=30,
        CANNY_HIGH=90,
        CANNY_L2=0,
        STRETCH=[1, 99],
        GRAY="band:3",
        SIFT_MAX_OCTAVE=1,
        MIN_HOLE=9,
        STATISTICS=[0, 3],
        DOMAIN=1,
    )
    assert made["NODE_COUNT"] <= 200
    names = open_layer(made["OUTPUT"]).fields().names()
    assert {"blue_mean", "blue_max", "red_mean"} <= set(names)
    assert not {"blue_std", "green_mean"} & set(names)
    from geomesh_qgis.provenance import read_document

    recipe = read_document(made["OUTPUT"].partition("|")[0])["recipe"]
    expected = {
        "nodes": 200,
        "min_spacing": 4,
        "canny_low": 30,
        "canny_high": 90,
        "canny_l2": False,
        "stretch": [1, 99],
        "gray": "band:3",
        "sift_max_octave": 1,
        "min_hole": 9,
        "statistics": ["mean", "max"],
        "domain": "image",
    }
    assert {name: recipe[name] for name in expected} == expected
    columns = [
        (feature["col"], feature["row"])
        for feature in open_layer(made["NODES_LAYER"]).getFeatures()
    ]
    assert len(set(columns)) == made["NODE_COUNT"]


def test_every_parameter_of_a_recipe_can_be_set(run, olinda):
    """Each advanced parameter in turn, as the widgets give it, arrives under its own name."""
    from geomesh_qgis.algorithms.recipe_parameters import SETTINGS
    from geomesh_qgis.provenance import read_document

    tried = {"whole": 3, "real": 0.5, "range": [5, 95], "flag": 1, "choice": 0, "some": [0]}
    tried |= {"gray": "mean", "size": "128 x 64"}
    told = {"range": [5, 95], "flag": True, "size": [128, 64]}
    for setting in SETTINGS:
        made = run(olinda, NODES=100, **{setting.parameter: tried[setting.kind]})
        recipe = read_document(made["OUTPUT"].partition("|")[0])["recipe"]
        expected = told.get(setting.kind, tried[setting.kind])
        if setting.kind in ("choice", "some"):
            expected = setting.choices[0] if setting.kind == "choice" else [setting.choices[0]]
        assert recipe[setting.name] == expected, setting.name


def test_what_the_dialog_says_for_not_set_is_not_set(provider):
    from geomesh_qgis.algorithms.recipe_parameters import (
        find_recipe_fault,
        recipe_options,
        recipe_parameters,
    )

    unset = {parameter.name(): None for parameter in recipe_parameters()}
    unset |= {"STRETCH": [math.nan, math.nan], "GRAY": "", "RESIZE": "", "STATISTICS": []}
    algorithm = provider.algorithm("rastertomesh").create()
    for stretch in ([math.nan, math.nan], "nan,nan", "", []):
        assert (
            recipe_options(algorithm, {**unset, "STRETCH": stretch}, QgsProcessingContext()) == []
        )
    assert find_recipe_fault(algorithm, unset, QgsProcessingContext()) == ""


def test_paper_preset(run, olinda):
    made = run(olinda, PRESET=1)
    triangles = open_layer(made["OUTPUT"])
    raster = QgsRasterLayer(str(olinda), "raster").extent()
    assert 0.8 < total_area(triangles) / (raster.width() * raster.height()) < 1  # the hull


def test_recipe_file_takes_the_place_of_the_preset(run, olinda, tmp_path):
    file = tmp_path / "recipe.json"
    file.write_text(json.dumps({"nodes": 77, "canny_low": 20.0, "canny_high": 60.0}))
    assert run(olinda, RECIPE=file)["NODE_COUNT"] == 77


@pytest.mark.parametrize("extension", ["geojson", "fgb"])
def test_other_formats_carry_triangles_and_style(run, olinda, tmp_path, extension):
    made = run(olinda, f"mesh.{extension}", NODES=300, MESH=tmp_path / "layer.nc")
    triangles = open_layer(made["OUTPUT"])
    assert triangles.featureCount() == made["TRIANGLE_COUNT"]
    assert triangles.crs().authid() == ("EPSG:4326" if extension == "geojson" else "EPSG:31985")
    assert triangles.renderer().symbol().symbolLayerCount() == 2
    assert "NODES_LAYER" not in made
    assert Path(made["MESH"]).exists()


def test_temporary_output(provider, processing, olinda):
    made = processing.run(ALGORITHM, {"INPUT": str(olinda), "OUTPUT": "TEMPORARY_OUTPUT"})
    assert open_layer(made["OUTPUT"]).featureCount() > 1000


def test_names_that_shells_stumble_over(run, olinda, tmp_path):
    folder = tmp_path / 'Olinda\'s "höhe" & $HOME; 海 (1)'
    folder.mkdir()
    raster = folder / "mapa de São João.tif"
    shutil.copy(olinda, raster)
    made = run(raster, str(folder / "malha é.gpkg"), NODES=200, MESH=folder / "malha é.nc")
    assert open_layer(made["OUTPUT"]).featureCount() > 100
    assert {path.name for path in folder.iterdir() if path.suffix != ".xml"} == {
        raster.name,
        "malha é.gpkg",
        "malha é.nc",
        "malha é.qml",
    }


# What the layer knows and the file does not


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
    """Declare values of a raster nodata, as Layer Properties > Transparency does."""

    def declare(path, low, high, bands=(1, 2, 3)):
        layer = QgsRasterLayer(str(path), "raster")
        for band in bands:
            layer.dataProvider().setUserNoDataValue(band, [QgsRasterRange(low, high)])
        project.addMapLayer(layer)
        return layer

    return declare


def test_nodata_of_the_layer(run, olinda, layer_with_nodata):
    """Without one of the file's own, the layer's takes its place."""
    from geomesh_qgis.inputs import describe_raster

    layer = layer_with_nodata(olinda, 255, 255)
    assert describe_raster(layer).options == ("--nodata", "255.0")
    assert run(layer, NODATA=255)["NODE_COUNT"] > 100


def test_nodata_of_the_layer_beside_that_of_the_file(run, samples, layer_with_nodata):
    """Both hold: the collar of the file, and what the user has added."""
    bahamas = samples / "bahamas_landsat7_rgb_nodata_collar.tif"
    collar = total_area(open_layer(run(bahamas, "file.gpkg")["OUTPUT"]))
    feedback = Listener()
    layer = layer_with_nodata(bahamas, 255, 255)
    both = total_area(open_layer(run(layer, "both.gpkg", feedback=feedback)["OUTPUT"]))
    assert 0.8 * collar < both < collar
    assert not any("nodata values of the layer" in warning for warning in feedback.warnings)


@pytest.mark.parametrize("bands", [(1, 2, 3), (2,)])
def test_nodata_that_cannot_be_heeded_is_told(run, olinda, layer_with_nodata, bands):
    feedback = Listener()
    run(layer_with_nodata(olinda, 0, 9, bands), feedback=feedback, NODES=50)
    assert any("does not heed" in warning for warning in feedback.warnings)


def test_open_options_of_the_layer(run, olinda, tmp_path, project):
    """A palette stays a palette, and the source keeps its name."""
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
    assert "green_mean" in open_layer(output).fields().names()
    assert read_document(output.partition("|")[0])["source"]["name"] == layer.source()


def test_raster_without_georeference_lies_where_qgis_shows_it(run, samples, project):
    layer = QgsRasterLayer(str(samples / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"), "raster")
    project.addMapLayer(layer)
    made = run(layer)
    shown, found = layer.extent(), open_layer(made["OUTPUT"]).extent()
    assert (found.xMinimum(), found.yMinimum()) == (shown.xMinimum(), shown.yMinimum())
    assert (found.xMaximum(), found.yMaximum()) == (shown.xMaximum(), shown.yMaximum())
    assert shown.yMinimum() == -layer.height()
    # And not upside down: the pixel below the centre of a triangle lies in its range.
    for feature in list(open_layer(made["OUTPUT"]).getFeatures())[:200]:
        if feature["count"] > 3:
            value, known = layer.dataProvider().sample(feature.geometry().centroid().asPoint(), 1)
            assert known
            assert feature["b1_min"] <= value <= feature["b1_max"]


def test_layer_that_is_no_file_is_exported(run, olinda, project):
    """A virtual raster: QGIS computes its pixels."""
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
    # A mesh follows pixels: a fringe of half a pixel at most on either side.
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


# What goes wrong


def fails(run, *arguments, **parameters) -> str:
    with pytest.raises(QgsProcessingException) as caught:
        run(*arguments, **parameters)
    return str(caught.value)


def test_cancelling_leaves_nothing(run, samples, tmp_path):
    feedback = Listener(cancel=True)
    said = fails(run, samples / "olinda_landsat7_6band_uint8.tif", feedback=feedback)
    assert "Cancelled" in said
    assert list(tmp_path.iterdir()) == []


def test_cancelling_keeps_the_old_file(run, olinda, tmp_path):
    run(olinda, NODES=100)
    before = (tmp_path / "mesh.gpkg").read_bytes()
    fails(run, olinda, feedback=Listener(cancel=True))
    assert (tmp_path / "mesh.gpkg").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.gpkg"]


def test_the_engines_own_words_reach_the_user(run, olinda, tmp_path):
    said = fails(run, olinda, NODATA=None, EXTENT="0,10,0,10 [EPSG:31985]")
    assert "\n" not in said
    assert "bounds" in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_warnings_reach_the_user(run, samples):
    feedback = Listener()
    run(samples / "bahamas_landsat7_rgb_nodata_collar.tif", feedback=feedback, MIN_HOLE=5000)
    assert any("dropped" in warning or "bridged" in warning for warning in feedback.warnings)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"NODATA": "abc"}, "Nodata value is 'abc': give a number"),
        ({"MIN_SPACING": "2,5"}, "give a number"),
        ({"NODES": "1%"}, "give a number"),
        ({"STRETCH": "50,2"}, "two rising numbers"),
        ({"OUTPUT": "/nowhere/mesh.gpkg"}, "does not exist: create it first"),
        ({"OUTPUT": "a|b.gpkg"}, "takes for the end"),
        ({"MESH": "/nowhere/mesh.nc"}, "does not exist: create it first"),
        ({"GRAY": "blue"}, "choose luma, mean, pca or band:N"),
        ({"RESIZE": "big"}, "give width and height"),
        ({"CANNY_LOW": 9, "CANNY_HIGH": 8}, "above the high one"),
        ({"STRETCH": [98, 2]}, "two rising numbers"),
        ({"STRETCH": [math.nan, 98]}, "two rising numbers"),
        ({"OUTPUT": "mesh.shp"}, "no extension that geomesh knows"),
        ({"MESH": "mesh.2dm"}, "another extension than .nc"),
        ({"OUTPUT": "mesh.fgb", "MESH": "mesh.nc"}, "would share one style file"),
    ],
)
def test_values_that_cannot_work_are_refused_at_once(provider, olinda, parameters, expected):
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg", **parameters}
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert expected in reason


def test_what_is_read_is_not_written_over(provider, run, olinda, tmp_path, project):
    """By whatever name: in a database, through a link, as a mask."""
    raster = tmp_path / "raster.gpkg"
    shutil.copy(olinda, raster)
    mask = run(olinda, NODES=50)["OUTPUT"]
    link = tmp_path / "link.gpkg"
    link.symlink_to(raster)
    algorithm = provider.algorithm("rastertomesh").create()
    for given in (
        {"INPUT": str(raster), "OUTPUT": str(raster)},
        {"INPUT": str(raster), "OUTPUT": str(link)},
        {"INPUT": str(raster), "OUTPUT": str(tmp_path / "x" / ".." / "raster.gpkg")},
        {"INPUT": str(olinda), "OUTPUT": mask.partition("|")[0], "MASK": mask},
    ):
        (tmp_path / "x").mkdir(exist_ok=True)
        passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
        assert not passed
        assert "is read by the same run" in reason
        # And where nothing is checked before, as in a batch:
        before = raster.read_bytes()
        assert not algorithm.run(given, QgsProcessingContext(), Listener())[1]
        assert raster.read_bytes() == before


def test_a_file_that_the_project_shows_is_not_replaced(provider, olinda, run, project):
    made = run(olinda, NODES=100)
    layer = QgsVectorLayer(made["OUTPUT"], "my mesh", "ogr")
    project.addMapLayer(layer)
    context = QgsProcessingContext()
    context.setProject(project)
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": made["OUTPUT"].partition("|")[0]}
    passed, reason = algorithm.checkParameterValues(given, context)
    assert not passed
    assert "open as layer 'my mesh'" in reason
    project.removeMapLayer(layer)
    assert algorithm.checkParameterValues(given, context)[0]


def test_without_geomesh_it_says_how_to_get_it(provider, olinda, monkeypatch, tmp_path):
    monkeypatch.setenv("GEOMESH_PYTHON", str(tmp_path / "nothing"))
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg"}
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert "GEOMESH_PYTHON" in reason
    assert Qgis.QGIS_VERSION_INT >= 32200
