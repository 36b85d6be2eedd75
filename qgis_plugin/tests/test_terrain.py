"""Contours, volumes and exports of a TIN, from any layer that shows it."""

from __future__ import annotations

from pathlib import Path

import pytest
from meshing import Listener, open_layer
from qgis.core import (
    QgsMeshLayer,
    QgsProcessingContext,
    QgsProcessingException,
    QgsRasterLayer,
    QgsRuleBasedRenderer,
    QgsVectorLayer,
)
from terrain import write_dem


@pytest.fixture(scope="module")
def made(provider, processing, tmp_path_factory):
    """A TIN of an even slope: 60 by 60 pixels of 10 m, from 0 to 59 m high."""
    folder = tmp_path_factory.mktemp("slope")
    dem = write_dem(folder / "slope.tif", lambda x, _: x)
    places = {"OUTPUT": str(folder / "slope.nc"), "VECTORS": str(folder / "slope.gpkg")}
    found = processing.run("geomesh:demtotin", {"INPUT": str(dem), "TOLERANCE": 0.1, **places})
    return {**found, "DEM": str(dem), "GPKG": str(folder / "slope.gpkg")}


@pytest.fixture
def shown(made, project):
    """The mesh layer of the TIN, as DEM to TIN loads it."""
    from geomesh_qgis.meshes import remember_mesh

    layer = QgsMeshLayer(made["OUTPUT"], "TIN of slope", "mdal")
    remember_mesh(layer, made["GPKG"])
    project.addMapLayer(layer)
    return layer


def fault(provider, name, project, **parameters) -> str:
    context = QgsProcessingContext()
    context.setProject(project)
    passed, reason = provider.algorithm(name).create().checkParameterValues(parameters, context)
    assert not passed
    assert "\n" not in reason
    return reason


# Contours


def test_contours_are_lines_at_levels_with_labels_on_every_fifth(
    processing, shown, tmp_path, project
):
    output = str(tmp_path / "contours.gpkg")
    given = {"INPUT": shown, "INTERVAL": 5, "BASE": 0, "INDEX": 5, "OUTPUT": output}
    processing.runAndLoadResults("geomesh:contours", given)
    (layer,) = project.mapLayersByName("Contours of slope")
    assert isinstance(layer, QgsVectorLayer)
    assert layer.crs().authid() == "EPSG:32613"
    lengths = dict.fromkeys(range(5, 60, 5), 0.0)
    for feature in layer.getFeatures():
        level, box = feature["level"], feature.geometry().boundingBox()
        assert bool(feature["index"]) == (level % 25 == 0)
        if level in lengths:
            # The middle of column x is x + 0.5 pixels of 10 m from the edge.
            x = 500000 + 10 * (level + 0.5)
            assert (box.xMinimum(), box.xMaximum()) == (pytest.approx(x, abs=6),) * 2
            lengths[level] += box.height()
    assert list(lengths.values()) == [pytest.approx(600, rel=0.02)] * len(lengths)
    renderer = layer.renderer()
    assert isinstance(renderer, QgsRuleBasedRenderer)
    thin, thick = (rule.symbol().width() for rule in renderer.rootRule().children())
    assert thick > 2 * thin
    assert layer.labelsEnabled()
    assert "level" in layer.labeling().settings().fieldName
    # The style is in the file.
    again = open_layer(output)
    assert again.labelsEnabled()
    assert again.renderer().rootRule().children()[1].filterExpression() == '"index"'


def test_the_interval_is_chosen_if_none_is_set(processing, made, tmp_path):
    found = processing.run(
        "geomesh:contours", {"INPUT": made["GPKG"], "OUTPUT": str(tmp_path / "c.fgb")}
    )
    assert found["INTERVAL"] in (2, 5)
    assert found["LINE_COUNT"] == open_layer(found["OUTPUT"]).featureCount()
    assert 10 <= found["LEVEL_COUNT"] <= 20


def test_no_level_between_the_heights_is_said(processing, made, tmp_path):
    feedback = Listener()
    given = {"INPUT": made["GPKG"], "BASE": 500, "INTERVAL": 1000}
    found = processing.run(
        "geomesh:contours", {**given, "OUTPUT": str(tmp_path / "c.gpkg")}, feedback=feedback
    )
    assert found["LINE_COUNT"] == 0
    assert open_layer(found["OUTPUT"]).featureCount() == 0
    assert any("no level lies between" in warning for warning in feedback.warnings)


@pytest.mark.parametrize("value", [0, -1, "close"])
def test_an_interval_is_above_zero(provider, project, made, value):
    said = fault(
        provider, "contours", project, INPUT=made["GPKG"], INTERVAL=value, OUTPUT="contours.gpkg"
    )
    assert "give a" in said


# Volume


def test_volume_over_a_level(processing, shown, tmp_path):
    report = tmp_path / "report.html"
    found = processing.run("geomesh:volume", {"INPUT": shown, "LEVEL": 29.5, "REPORT": str(report)})
    # An even slope: two equal wedges.
    assert found["CUT"] == pytest.approx(found["FILL"], rel=0.01)
    assert found["CUT"] == pytest.approx(600 * 300 * 30 / 2, rel=0.05)
    assert found["NET"] == pytest.approx(found["CUT"] - found["FILL"])
    assert found["CUT_AREA"] + found["FILL_AREA"] == pytest.approx(600 * 600)
    page = report.read_text(encoding="utf-8")
    assert "Volume of slope" in page
    assert "Over level 29.5" in page
    assert f"{found['CUT']:,.1f} m³" in page


def test_volume_over_surfaces(processing, shown, made):
    over_itself = processing.run("geomesh:volume", {"INPUT": shown, "BASE": made["VECTORS"]})
    assert over_itself["CUT"] == pytest.approx(over_itself["FILL"], abs=1e-6)
    feedback = Listener()
    raster = QgsRasterLayer(made["DEM"], "dem")
    over_dem = processing.run("geomesh:volume", {"INPUT": shown, "BASE": raster}, feedback=feedback)
    assert over_dem["CUT"] + over_dem["FILL"] < 0.5 * 600 * 600
    assert over_dem["MISSING_AREA"] == 0
    assert feedback.warnings == []


def test_one_base_only(provider, project, made):
    said = fault(
        provider, "volume", project, INPUT=made["GPKG"], LEVEL=1, BASE=made["GPKG"], REPORT=None
    )
    assert "The base is set twice" in said


# Export


@pytest.mark.parametrize("extension", ["xml", "2dm"])
def test_export(processing, made, tmp_path, extension):
    output = tmp_path / f"slope.{extension}"
    found = processing.run("geomesh:exporttin", {"INPUT": made["VECTORS"], "OUTPUT": str(output)})
    assert found["OUTPUT"] == str(output)
    assert output.stat().st_size > 1000
    if extension == "2dm":
        layer = QgsMeshLayer(str(output), "again", "mdal")
        assert layer.dataProvider().faceCount() == made["TRIANGLE_COUNT"]


def test_export_of_a_solid(processing, shown, tmp_path):
    sizes = []
    for solid in (None, -10):
        feedback = Listener()
        output = tmp_path / f"slope{solid}.stl"
        given = {"INPUT": shown, "SOLID": solid, "OUTPUT": str(output)}
        processing.run("geomesh:exporttin", given, feedback=feedback)
        sizes.append(output.stat().st_size)
        assert any("holds metres east and north of" in each for each in feedback.warnings)
    assert sizes[1] > 2 * sizes[0] - 84


def test_what_cannot_be_exported_is_refused_at_once(provider, project, made, shown, tmp_path):
    for given, expected in (
        ({"OUTPUT": "slope.shp"}, "no extension of a format"),
        ({"OUTPUT": "slope.obj", "SOLID": 0}, "Base of a solid is for STL"),
        ({"OUTPUT": "/nowhere/slope.obj"}, "does not exist: create it first"),
    ):
        said = fault(provider, "exporttin", project, INPUT=made["GPKG"], **given)
        assert expected in said
    shown.setCustomProperty("geomesh/mesh", str(tmp_path / "gone.gpkg"))
    said = fault(provider, "exporttin", project, INPUT=shown.id(), OUTPUT="slope.obj")
    assert "There is no GeoPackage of TIN of slope" in said


@pytest.fixture(scope="module")
def flat(provider, processing, tmp_path_factory, olinda):
    """A mesh without heights."""
    place = tmp_path_factory.mktemp("flat") / "flat.gpkg"
    given = {"INPUT": str(olinda), "PRESET": 0, "NODES": 60, "OUTPUT": str(place)}
    return str(processing.run("geomesh:rastertomesh", given)["OUTPUT"])


def test_a_mesh_without_heights_says_what_to_set(processing, flat, tmp_path):
    with pytest.raises(QgsProcessingException, match="Band of heights"):
        processing.run("geomesh:exporttin", {"INPUT": flat, "OUTPUT": str(tmp_path / "flat.obj")})


def test_a_missing_package_is_named_with_the_button_that_installs_it(
    processing, made, tmp_path, monkeypatch
):
    from geomesh_qgis.engine import runner

    def fail(*_, **__):
        raise runner.RunError("missing-extra", "ezdxf is not installed: pip install 'x'")

    monkeypatch.setattr(runner, "run", fail)
    with pytest.raises(QgsProcessingException, match=r"pip install 'x', or press Reinstall in Set"):
        processing.run(
            "geomesh:exporttin", {"INPUT": made["GPKG"], "OUTPUT": str(tmp_path / "slope.dxf")}
        )


def test_on_the_command_line(qgis_process, made, tmp_path):
    output = Path(tmp_path / "tin.nc")
    done = qgis_process(
        "run", "geomesh:demtotin", f"--INPUT={made['DEM']}", "--TOLERANCE=1", f"--OUTPUT={output}"
    )
    assert "MAX_ERROR" in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tin.nc", "tin.qml"]
