"""Errors are reported early and in one line, and no data is lost."""

from __future__ import annotations

import math
import shutil

import pytest
from meshing import Listener
from qgis.core import (
    Qgis,
    QgsProcessingContext,
    QgsProcessingException,
    QgsVectorLayer,
)


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
        ({"OUTPUT": "a|b.gpkg"}, "takes for the end of the name"),
        ({"MESH": "/nowhere/mesh.nc"}, "does not exist: create it first"),
        ({"GRAY": "blue"}, "choose luma, mean, pca or band:N"),
        ({"RESIZE": "big"}, "give width and height"),
        ({"CANNY_LOW": 9, "CANNY_HIGH": 8}, "above the high one"),
        ({"STRETCH": [98, 2]}, "two rising numbers"),
        ({"STRETCH": [math.nan, 98]}, "two rising numbers"),
        ({"OUTPUT": "mesh.shp"}, "no extension that geomesh knows"),
        ({"MESH": "mesh.2dm"}, "does not end in .nc"),
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
    """This works for any name of the file: in a database, through a link, as a mask."""
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
        assert "is an input of the same run" in reason
        # A batch does not check values first. The run itself must refuse them:
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
