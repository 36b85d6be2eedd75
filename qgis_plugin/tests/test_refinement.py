"""The preset adaptive in `geomesh:rastertomesh`: goals, limits, breaklines, and their faults."""

from __future__ import annotations

import pytest
from meshing import Listener, open_layer
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsFeature,
    QgsGeometry,
    QgsProcessingContext,
    QgsProcessingFeatureSourceDefinition,
    QgsProject,
    QgsVectorLayer,
)

ADAPTIVE = 2
NODES, LARGEST, RMSE = range(3)  # goals
LINEAR, CONSTANT = range(2)
FAST, NORMAL, BEST = range(3)


def document(made) -> dict:
    from geomesh_qgis.provenance import read_document

    return read_document(made["OUTPUT"].partition("|")[0])


def test_presets_keep_their_places():
    """Models and scripts of users know a preset by its place in the list."""
    from geomesh_qgis.algorithms.base import DEFAULT_PRESET, PRESETS

    assert list(PRESETS) == ["features", "paper", "adaptive"]
    assert DEFAULT_PRESET in PRESETS


def test_exactly_so_many_nodes(run, olinda):
    feedback = Listener()
    made = run(olinda, feedback=feedback, PRESET=ADAPTIVE, NODES=300)
    assert made["NODE_COUNT"] == 300
    assert open_layer(made["NODES_LAYER"]).featureCount() == 300
    assert {"red", "green", "blue"} <= set(open_layer(made["NODES_LAYER"]).fields().names())
    assert "red_rmse" in open_layer(made["OUTPUT"]).fields().names()
    found = document(made)
    assert found["recipe"]["preset"] == "adaptive"
    assert found["refinement"]["goal"] == "nodes"
    assert found["certificate"]["passed"]


def test_every_parameter_reaches_the_recipe(run, olinda):
    made = run(
        olinda,
        PRESET=ADAPTIVE,
        NODES_PERCENT=0.25,
        MIN_ANGLE=15,
        MODEL=CONSTANT,
        EFFORT=FAST,
        KEEP_FEATURES=True,
        TIME_LIMIT=300,
        CANNY_BREAKLINES=True,
    )
    found = document(made)
    expected = {
        "nodes": "0.25%",
        "min_angle": 15,
        "model": "constant",
        "effort": "fast",
        "keep_features": True,
    }
    assert {name: found["recipe"][name] for name in expected} == expected
    assert made["NODE_COUNT"] == round(0.0025 * 349 * 352)
    assert found["breaklines"]["name"] == "canny"
    triangles = open_layer(made["OUTPUT"])
    smallest = triangles.minimumValue(triangles.fields().indexOf("min_angle"))
    assert smallest >= 15 - 0.001


def test_a_mean_error_with_a_limit(run, samples):
    """With too few nodes allowed, the mesh is the best of so many, and the log says so."""
    feedback = Listener()
    dem = samples / "rmnp_dem.tif"
    made = run(dem, feedback=feedback, PRESET=ADAPTIVE, GOAL=RMSE, ERROR="0.5", NODES=150)
    found = document(made)
    assert made["NODE_COUNT"] <= 150
    assert found["recipe"]["rmse"] == 0.5
    assert not found["refinement"]["reached"]
    assert any("rmse" in warning for warning in feedback.warnings)


def test_a_mean_error_for_each_band(run, olinda):
    made = run(olinda, PRESET=ADAPTIVE, GOAL=RMSE, ERROR="15, 12, 11", EFFORT=FAST)
    found = document(made)
    assert found["recipe"]["rmse"] == [15, 12, 11]
    assert found["refinement"]["reached"]
    for band, limit in zip(found["refinement"]["bands"], (15, 12, 11)):
        assert band["rmse"] <= limit


def test_a_largest_error(run, samples):
    dem = samples / "rmnp_dem.tif"
    made = run(dem, PRESET=ADAPTIVE, GOAL=LARGEST, ERROR=60, EFFORT=FAST)
    found = document(made)
    assert found["recipe"]["max_error"] == 60
    assert found["refinement"]["reached"]
    triangles = open_layer(made["OUTPUT"])
    (field,) = (name for name in triangles.fields().names() if name.endswith("_max_error"))
    assert triangles.maximumValue(triangles.fields().indexOf(field)) <= 60


def test_options_of_each_goal(provider, samples):
    from geomesh_qgis.algorithms.refinement_parameters import read_wanted, refinement_options

    algorithm = provider.algorithm("rastertomesh").create()
    context = QgsProcessingContext()
    for given, expected in (
        ({}, []),
        ({"NODES": 300}, ["--nodes", "300"]),
        ({"NODES_PERCENT": 2}, ["--nodes", "2.0%"]),
        ({"GOAL": LARGEST, "ERROR": "2.5"}, ["--max-error", "2.5"]),
        ({"GOAL": LARGEST, "ERROR": 3}, ["--max-error", "3.0"]),
        ({"GOAL": RMSE, "ERROR": "5; 5;8"}, ["--rmse", "5.0,5.0,8.0"]),
        ({"GOAL": RMSE, "ERROR": [5, 8]}, ["--rmse", "5.0,8.0"]),
        ({"GOAL": RMSE, "ERROR": "5", "NODES": 9}, ["--nodes", "9", "--rmse", "5.0"]),
        ({"MODEL": LINEAR, "EFFORT": BEST}, ["--model", "linear", "--effort", "best"]),
        ({"MODEL": None, "EFFORT": None, "ERROR": "", "TIME_LIMIT": None}, []),
        ({"KEEP_FEATURES": False, "CANNY_BREAKLINES": False}, []),
    ):
        assert refinement_options(read_wanted(algorithm, given, context)) == expected


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"NODES": 100, "NODES_PERCENT": 1}, "set twice, as a number and as a percentage"),
        ({"NODES_PERCENT": 0}, "give a number above 0"),
        ({"TIME_LIMIT": 0}, "give a number above 0"),
        ({"MIN_ANGLE": "nan"}, "give a number from 0 to 25"),
        ({"GOAL": LARGEST}, "The goal is the largest error: also set"),
        ({"GOAL": RMSE}, "The goal is the root mean square error: also set"),
        ({"ERROR": "5"}, "is set, but the goal is the number of nodes"),
        ({"GOAL": RMSE, "ERROR": "much"}, "is 'much': give a number such as 2.5"),
        ({"GOAL": RMSE, "ERROR": "5,,8"}, "give a number such as 2.5"),
        ({"GOAL": RMSE, "ERROR": "0"}, "above 0"),
        ({"GOAL": RMSE, "ERROR": "0,5"}, "Write decimals with a point"),
        ({"GOAL": RMSE, "ERROR": "-1"}, "above 0"),
        ({"GOAL": RMSE, "ERROR": "nan"}, "above 0"),
        ({"GOAL": LARGEST, "ERROR": "inf"}, "above 0"),
        ({"GOAL": RMSE, "ERROR": "5,8", "BANDS": [1, 2, 3]}, "has 2 numbers for 3 bands"),
        ({"RESIZE": "64, 64"}, "cannot resize the raster"),
        ({"DOMAIN": 2}, "covers the valid data or the whole image"),
        ({"PRESET": 0, "GOAL": RMSE, "ERROR": "5"}, "Only the preset adaptive can reach"),
        ({"PRESET": 1, "GOAL": LARGEST, "ERROR": "5"}, "Only the preset adaptive can reach"),
        ({"PRESET": 0, "MIN_ANGLE": 15}, "Smallest angle (degrees) is for the preset adaptive"),
        ({"PRESET": 0, "MODEL": LINEAR}, "Surface is for the preset adaptive"),
        ({"PRESET": 0, "EFFORT": BEST}, "Effort is for the preset adaptive"),
        ({"PRESET": 0, "KEEP_FEATURES": True}, "is for the preset adaptive"),
        ({"PRESET": 0, "TIME_LIMIT": 9}, "is for the preset adaptive"),
        ({"PRESET": 1, "CANNY_BREAKLINES": True}, "Breaklines need a mesh that follows"),
        ({"PRESET": 0, "RESIZE": "9,9", "CANNY_BREAKLINES": True}, "Breaklines need a mesh"),
    ],
)
def test_what_cannot_work_is_refused_at_once(provider, olinda, parameters, expected):
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg", "PRESET": ADAPTIVE, **parameters}
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert expected in reason
    assert "\n" not in reason


def test_numbers_out_of_their_range_are_refused(provider, olinda):
    algorithm = provider.algorithm("rastertomesh").create()
    for bad in ({"MIN_ANGLE": 26}, {"MIN_ANGLE": -1}, {"NODES": 0}, {"NODES_PERCENT": 101}):
        given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg", "PRESET": ADAPTIVE, **bad}
        assert not algorithm.checkParameterValues(given, QgsProcessingContext())[0], bad


def test_what_a_recipe_file_says_is_left_to_it(provider, olinda, tmp_path):
    """The file may be adaptive, whatever the preset beside it is."""
    file = tmp_path / "recipe.json"
    file.write_text('{"preset": "adaptive", "refine": true}')
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg", "RECIPE": str(file)}
    for more in ({"MIN_ANGLE": 20}, {"GOAL": RMSE, "ERROR": "5"}, {"MODEL": CONSTANT}):
        passed, reason = algorithm.checkParameterValues({**given, **more}, QgsProcessingContext())
        assert passed, reason


# Breaklines


@pytest.fixture
def road(olinda, project):
    """A layer in longitude and latitude, with a line across the scene and one far away."""
    layer = QgsVectorLayer("LineString?crs=EPSG:4326", 'Road "PE-1": é', "memory")
    transform = QgsCoordinateTransform(
        QgsCoordinateReferenceSystem("EPSG:31985"), layer.crs(), QgsProject.instance()
    )
    for wkt in (
        "LineString(289000 9111000, 294000 9114500, 296500 9119500)",
        "LineString(389000 9111000, 394000 9114500)",
    ):
        geometry = QgsGeometry.fromWkt(wkt)
        geometry.transform(transform)
        feature = QgsFeature()
        feature.setGeometry(geometry)
        layer.dataProvider().addFeature(feature)
    project.addMapLayer(layer)
    return layer


def breaklines(made) -> QgsGeometry:
    """Return the edges of a mesh that are breaklines."""
    edges = open_layer(made["EDGES_LAYER"])
    edges.setSubsetString('"constrained" = 1 AND "left" >= 0 AND "right" >= 0')
    return QgsGeometry.collectGeometry([each.geometry() for each in edges.getFeatures()])


@pytest.mark.parametrize("preset", [0, ADAPTIVE])
def test_breaklines_of_a_layer_in_another_crs(run, olinda, road, preset):
    made = run(olinda, PRESET=preset, NODES=300, BREAKLINES=road)
    line = QgsGeometry.fromWkt("LineString(289000 9111000, 294000 9114500, 296500 9119500)")
    edges = breaklines(made)
    assert edges.length() == pytest.approx(line.length(), rel=0.02)
    side = 28.5  # of a pixel, in metres
    assert line.buffer(2 * side, 8).contains(edges)
    nodes = open_layer(made["NODES_LAYER"])
    assert "breakline" in nodes.uniqueValues(nodes.fields().indexOf("kind"))
    assert document(made)["breaklines"]["name"].endswith("Road _PE-1__ é.gpkg")
    # The style shows the new kinds.
    categories = [each.value() for each in nodes.renderer().categories()]
    assert categories == (
        ["refined", "breakline", "border"]
        if preset == ADAPTIVE
        else ["feature", "breakline", "border"]
    )
    edges_layer = open_layer(made["EDGES_LAYER"])
    labels = [each.label() for each in edges_layer.renderer().categories()]
    assert labels == ["inner edge", "outline", "breakline"]


def test_breaklines_of_the_selected_features(run, olinda, road):
    feedback = Listener()
    road.selectByIds([2])
    selection = QgsProcessingFeatureSourceDefinition(road.id(), selectedFeaturesOnly=True)
    made = run(olinda, feedback=feedback, NODES=100, BREAKLINES=selection)
    assert breaklines(made).isEmpty()
    assert any("no breakline is inside" in warning for warning in feedback.warnings)


def test_breaklines_of_polygons(run, olinda, project):
    layer = QgsVectorLayer("Polygon?crs=EPSG:31985", "fields", "memory")
    feature = QgsFeature()
    feature.setGeometry(
        QgsGeometry.fromWkt(
            "Polygon((291000 9113000, 294000 9113000, 294000 9116000, 291000 9116000, "
            "291000 9113000))"
        )
    )
    layer.dataProvider().addFeature(feature)
    project.addMapLayer(layer)
    made = run(olinda, PRESET=ADAPTIVE, NODES=200, BREAKLINES=layer)
    assert breaklines(made).length() == pytest.approx(12000, rel=0.02)


def test_breaklines_of_curves(run, olinda, project):
    layer = QgsVectorLayer("CompoundCurve?crs=EPSG:31985", "curve", "memory")
    feature = QgsFeature()
    arc = QgsGeometry.fromWkt(
        "CompoundCurve(CircularString(290000 9114000, 292000 9116000, 294000 9114000))"
    )
    feature.setGeometry(arc)
    layer.dataProvider().addFeature(feature)
    project.addMapLayer(layer)
    made = run(olinda, NODES=100, BREAKLINES=layer)
    assert breaklines(made).length() == pytest.approx(arc.length(), rel=0.03)


def test_breaklines_given_twice_or_unreadable_are_refused(provider, olinda, road, tmp_path):
    algorithm = provider.algorithm("rastertomesh").create()
    context = QgsProcessingContext()
    context.setProject(QgsProject.instance())
    given = {"INPUT": str(olinda), "OUTPUT": "mesh.gpkg", "BREAKLINES": road.id()}
    passed, reason = algorithm.checkParameterValues({**given, "CANNY_BREAKLINES": True}, context)
    assert not passed
    assert "Breaklines are set twice" in reason
    missing = {**given, "BREAKLINES": str(tmp_path / "none.gpkg")}
    assert not algorithm.checkParameterValues(missing, context)[0]


def test_a_layer_of_breaklines_is_not_written_over(provider, olinda, run, tmp_path, project):
    lines = run(olinda, NODES=50)["EDGES_LAYER"]
    algorithm = provider.algorithm("rastertomesh").create()
    given = {"INPUT": str(olinda), "OUTPUT": lines.partition("|")[0], "BREAKLINES": lines}
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert "is an input of the same run" in reason
