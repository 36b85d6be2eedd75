"""DEM to TIN in the real QGIS: from the menu to the TIN in the map, and contours of it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from harness import HEIGHT, HERE, WIDTH, run_desktop
from qgis.PyQt.QtGui import QImage
from terrain import mirror

SIDE = 2000


@pytest.fixture(scope="module")
def seen(tmp_path_factory, samples, geomesh_python):
    """The report of a run of drive_terrain.py. Screenshots go to GEOMESH_SCREENSHOTS, if set."""
    folder = tmp_path_factory.mktemp("terrain")
    pictures = Path(os.environ.get("GEOMESH_SCREENSHOTS", folder / "pictures")).resolve()
    dem = mirror(samples / "colorado_dem_float32_epsg4269.tif", folder / "colorado.tif", SIDE)
    report = run_desktop(
        "drive_terrain.py",
        folder,
        timeout=390,
        GEOMESH_PYTHON=geomesh_python,
        GEOMESH_TEST_SCRIPTS=HERE,
        GEOMESH_TEST_RASTER=dem,
        GEOMESH_TEST_PICTURES=pictures,
    )
    print(f"From Run to the TIN in the map: {report.get('seconds', 0):.1f} s")
    return {**report, "pictures": pictures}


def test_the_drive_came_to_its_end(seen):
    assert seen["failure"] is None, seen["failure"]
    assert seen["exceptions"] == []
    assert seen["boxes"] == []
    assert seen["exit"] == 0, seen["qgis_log"]


def test_the_menu_has_every_algorithm(seen, provider):
    assert len(seen["menu"]) == len(provider.algorithms())
    assert [entry.replace("&", "") for entry in seen["menu"]][:2] == [
        "Raster to mesh…",
        "DEM to TIN…",
    ]


def test_the_dialog_shows_the_default_tolerance(seen):
    assert any(text.startswith("About 9.") for text in seen["shown"]), seen["shown"]


def test_run_gives_a_tin_in_the_map(seen):
    assert seen["successful"], seen["log"]
    assert 0 < seen["results"]["MAX_ERROR"] <= seen["results"]["TOLERANCE"]
    assert seen["layers"] == [
        "nodes · Colorado",
        "TIN of Colorado",
        "triangles · Colorado",
        "Colorado",
    ]
    assert seen["contours"]["LINE_COUNT"] > 100


@pytest.mark.parametrize(
    "name", ["qgis_tin_dialog", "qgis_tin_whole", "qgis_tin_map", "qgis_tin_contours"]
)
def test_picture_shows_something(seen, name):
    image = QImage(str(seen["pictures"] / f"{name}.png"))
    assert (image.width(), image.height()) == (WIDTH, HEIGHT)
    colours = {image.pixel(x, y) for x in range(0, WIDTH, 3) for y in range(0, HEIGHT, 3)}
    assert len(colours) > 200
