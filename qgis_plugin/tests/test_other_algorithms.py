"""`geomesh:meshquality`, `geomesh:stages`, and common properties of all algorithms."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from qgis.core import QgsProcessingContext, QgsProcessingException, QgsVectorLayer
from qgis.PyQt.QtGui import QImage

NAMES = ("rastertomesh", "demtotin", "contours", "volume", "exporttin", "meshquality", "stages")


@pytest.fixture(scope="module")
def mesh(provider, processing, tmp_path_factory, olinda):
    folder = tmp_path_factory.mktemp("mesh")
    given = {"INPUT": str(olinda), "OUTPUT": str(folder / "olinda.gpkg"), "NODES": 400}
    return processing.run("geomesh:rastertomesh", given)


def test_provider_offers_its_algorithms(provider):
    assert sorted(algorithm.name() for algorithm in provider.algorithms()) == sorted(NAMES)
    assert not provider.icon().isNull()


@pytest.mark.parametrize("name", NAMES)
def test_each_has_help_with_a_picture(provider, name):
    algorithm = provider.algorithm(name)
    assert algorithm.displayName()
    assert algorithm.group()
    assert algorithm.groupId()
    assert algorithm.tags()
    assert not algorithm.icon().isNull()
    (picture,) = re.findall(r'src="file://([^"]+)"', algorithm.shortHelpString())
    image = QImage(picture)
    assert 200 < image.width() <= 230  # as wide as the help panel
    assert algorithm.create().name() == name


@pytest.mark.parametrize("name", NAMES)
def test_defaults_are_enough_to_run(provider, name):
    required = [
        parameter.name()
        for parameter in provider.algorithm(name).parameterDefinitions()
        if not parameter.flags() & parameter.Flag.FlagOptional
        and parameter.defaultValue() is None
        and not parameter.isDestination()
    ]
    assert required == ["INPUT"]


def test_measures_are_fields(mesh, processing, tmp_path):
    made = processing.run(
        "geomesh:meshquality",
        {
            "INPUT": mesh["OUTPUT"],
            "OUTPUT": str(tmp_path / "measured.gpkg"),
            "REPORT": str(tmp_path / "report.html"),
        },
    )
    layer = QgsVectorLayer(made["OUTPUT"], "measured", "ogr")
    assert layer.featureCount() == mesh["TRIANGLE_COUNT"]
    kis = []
    for feature in layer.getFeatures():
        ring = feature.geometry().asPolygon()[0]
        ab, ca, bc = sorted(math.dist(*pair) / 28.5 for pair in zip(ring, ring[1:]))
        assert feature["ki"] == pytest.approx(2 * ca * bc / (ab + bc + ca), rel=1e-6)
        assert feature["edge_ratio"] == pytest.approx(bc / ab, rel=1e-6)
        kis.append(feature["ki"])
    assert made["KI_MEAN"] == pytest.approx(sum(kis) / len(kis))
    report = Path(made["REPORT"]).read_text(encoding="utf-8")
    assert f"{made['KI_MEAN']:.4g}" in report
    assert f"{mesh['TRIANGLE_COUNT']:,} triangles" in report
    assert "scaled_jacobian" in report


def test_measures_in_map_units(mesh, processing, tmp_path):
    made = processing.run(
        "geomesh:meshquality",
        {"INPUT": mesh["NODES_LAYER"], "SPACE": 1, "OUTPUT": str(tmp_path / "measured.fgb")},
    )
    layer = QgsVectorLayer(made["OUTPUT"], "measured", "ogr")
    for feature in layer.getFeatures():
        ring = feature.geometry().asPolygon()[0]
        assert feature["map_bc"] == pytest.approx(
            max(math.dist(*pair) for pair in zip(ring, ring[1:])), rel=1e-9
        )


def test_the_page_about_a_mesh_is_an_output_to_open(provider, mesh, processing, tmp_path):
    outputs = {
        each.name(): each.type() for each in provider.algorithm("meshquality").outputDefinitions()
    }
    assert outputs["PAGE"] == outputs["REPORT"] == "outputHtml"  # shown in the results viewer
    page = tmp_path / "page é.html"
    made = processing.run(
        "geomesh:meshquality",
        {
            "INPUT": mesh["OUTPUT"],
            "OUTPUT": str(tmp_path / "measured.fgb"),
            "PAGE": str(page),
        },
    )
    assert made["PAGE"] == str(page)
    text = page.read_text(encoding="utf-8")
    assert "Certified: all" in text
    assert f"{mesh['TRIANGLE_COUNT']:,} triangles" in text
    assert f"{made['MIN_ANGLE']:.2f}°" in text
    # The raster of the mesh was found: the image is beside it.
    assert text.count("data:image/png;base64,") == 5


def test_a_page_with_another_name_is_refused(provider, mesh, tmp_path):
    given = {
        "INPUT": mesh["OUTPUT"],
        "OUTPUT": str(tmp_path / "measured.gpkg"),
        "PAGE": str(tmp_path / "page.txt"),
    }
    algorithm = provider.algorithm("meshquality").create()
    passed, reason = algorithm.checkParameterValues(given, QgsProcessingContext())
    assert not passed
    assert "does not end in .html" in reason


def test_other_layers_are_refused(provider, tmp_path, project):
    layer = QgsVectorLayer("Polygon?crs=EPSG:4326", "any", "memory")
    project.addMapLayer(layer)
    context = QgsProcessingContext()
    context.setProject(project)
    given = {"INPUT": layer.id(), "OUTPUT": str(tmp_path / "measured.gpkg")}
    passed, reason = provider.algorithm("meshquality").create().checkParameterValues(given, context)
    assert not passed
    assert "GeoPackage that Raster to mesh" in reason


def test_a_geopackage_without_a_mesh_is_refused_in_one_line(processing, tmp_path, mesh):
    other = tmp_path / "other.gpkg"
    processing.run("native:extractvertices", {"INPUT": mesh["OUTPUT"], "OUTPUT": str(other)})
    given = {"INPUT": str(other), "OUTPUT": str(tmp_path / "measured.gpkg")}
    with pytest.raises(QgsProcessingException, match="has no layer nodes") as caught:
        processing.run("geomesh:meshquality", given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("extension", ["png", "svg", "pdf"])
def test_stages(processing, olinda, tmp_path, extension):
    picture = tmp_path / f"stages é.{extension}"
    made = processing.run(
        "geomesh:stages",
        {
            "INPUT": str(olinda),
            "OUTPUT": str(picture),
            "REPORT": str(tmp_path / "report.html"),
            "CANNY_LOW": 40,
        },
    )
    assert Path(made["OUTPUT"]).stat().st_size > 10_000
    report = Path(made["REPORT"]).read_text(encoding="utf-8")
    assert picture.as_uri() in report
    if extension == "png":
        image = QImage(str(picture))
        colors = {image.pixel(x, y) for x in range(0, 800, 7) for y in range(0, 800, 7)}
        assert len(colors) > 100


def test_stages_in_the_folder_of_the_process(qgis_process, olinda, tmp_path):
    """Relative paths work, as users type them."""
    import shutil

    shutil.copy(olinda, tmp_path / "scene.tif")
    qgis_process(
        "run",
        "geomesh:stages",
        "--INPUT=scene.tif",
        "--OUTPUT=fig.png",
        "--REPORT=report.html",
        cwd=tmp_path,
    )
    assert (tmp_path / "fig.png").as_uri() in (tmp_path / "report.html").read_text()
