"""The plugin in the real QGIS, with its windows, under Xvfb."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from harness import HEIGHT, HERE, WIDTH, desktop, run_desktop
from qgis.PyQt.QtGui import QImage


@pytest.fixture(scope="module")
def seen(tmp_path_factory, olinda, geomesh_python):
    """The report of a run of drive.py. Screenshots go to GEOMESH_SCREENSHOTS, if it is set."""
    folder = tmp_path_factory.mktemp("desktop")
    pictures = Path(os.environ.get("GEOMESH_SCREENSHOTS", folder / "pictures")).resolve()
    report = run_desktop(
        "drive.py",
        folder,
        timeout=300,
        GEOMESH_PYTHON=geomesh_python,
        GEOMESH_TEST_SCRIPTS=HERE,
        GEOMESH_TEST_RASTER=olinda,
        GEOMESH_TEST_PICTURES=pictures,
    )
    return {**report, "pictures": pictures}


def test_the_drive_came_to_its_end(seen):
    assert seen["failure"] is None, seen["failure"]
    assert seen["exceptions"] == []
    assert seen["boxes"] == []
    assert seen["exit"] == 0, seen["qgis_log"]


def test_button_is_there_and_knows_when_it_can_work(seen):
    assert seen["loaded"]
    assert seen["in_toolbar"]
    assert seen["in_raster_menu"]
    assert not seen["enabled_without_layer"]
    assert not seen["enabled_with_vector"]
    assert seen["enabled_with_raster"]


def test_run_gives_layers(seen):
    # Newer versions of QGIS show "Create - Raster to Mesh".
    assert seen["dialog"].lower().endswith("raster to mesh")
    assert seen["successful"], seen["log"]
    # QGIS tells of the end of a task that took longer than a few seconds.
    assert [text for text in seen["messages"] if "Task complete" not in text] == []
    assert all(layer["valid"] for layer in seen["layers"])
    assert {layer["crs"] for layer in seen["layers"]} == {"EPSG:31985"}
    (triangles,) = (layer for layer in seen["layers"] if "n0" in layer.get("fields", ()))
    assert triangles["features"] == seen["results"]["TRIANGLE_COUNT"] > 1000


def test_layers_have_their_style(seen):
    # The desktop loads results in a different way than processing.run.
    (triangles,) = (layer for layer in seen["layers"] if "n0" in layer.get("fields", ()))
    (nodes,) = (layer for layer in seen["layers"] if "scale" in layer.get("fields", ()))
    assert 'name="fillColor"' in triangles["style"]
    assert 'type="categorizedSymbol"' in nodes["style"]


@pytest.mark.parametrize("name", ["qgis_dialog", "qgis_finished", "qgis_map", "qgis_map_near"])
def test_picture_shows_something(seen, name):
    image = QImage(str(seen["pictures"] / f"{name}.png"))
    assert (image.width(), image.height()) == (WIDTH, HEIGHT)
    colours = {image.pixel(x, y) for x in range(0, WIDTH, 3) for y in range(0, HEIGHT, 3)}
    assert len(colours) > 200


def find_children(pid: int) -> list[int]:
    """Return the child processes of a process, and their children."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except OSError:
                continue
            parents[int(entry.name)] = int(stat.rpartition(")")[2].split()[1])
    found, todo = [], [pid]
    while todo:
        parent = todo.pop()
        children = [child for child, its in parents.items() if its == parent]
        found += children
        todo += children
    return found


def is_running(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def is_geomesh(pid: int) -> bool:
    try:
        return b"rastertomesh" not in (line := Path(f"/proc/{pid}/cmdline").read_bytes()) and (
            b"mesh" in line.split(b"\0")
        )
    except OSError:
        return False


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while not (value := condition()) and time.monotonic() < end:
        time.sleep(0.2)
    return value


def test_geomesh_ends_when_qgis_is_killed(tmp_path, olinda, geomesh_python):
    from osgeo import gdal

    # The run must be long: the same scene, with 40 times as many pixels on each side.
    large = tmp_path / "large.tif"
    gdal.Translate(
        str(large),
        str(olinda),
        widthPct=4000,
        heightPct=4000,
        resampleAlg="cubic",
        creationOptions=["COMPRESS=ZSTD", "TILED=YES"],
    )
    place = tmp_path / "place"
    place.mkdir()
    with desktop(
        "drive_orphan.py",
        tmp_path / "desktop",
        GEOMESH_PYTHON=geomesh_python,
        GEOMESH_TEST_SCRIPTS=HERE,
        GEOMESH_TEST_REPORT=tmp_path / "report.json",
        GEOMESH_TEST_RASTER=large,
        GEOMESH_TEST_OUTPUT=place / "large.gpkg",
    ) as process:
        wait_for(
            lambda: process.poll() is not None or any(map(is_geomesh, find_children(process.pid))),
            90,
        )
        at_work = list(filter(is_geomesh, find_children(process.pid)))
        log = (tmp_path / "desktop/qgis.log").read_text(errors="replace")[-3000:]
        assert at_work, log
        time.sleep(5)  # time to start the work
        at_work = list(filter(is_geomesh, find_children(process.pid)))
        assert at_work, "geomesh ended too soon for this test"
        os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=20)
        ended = wait_for(lambda: not any(map(is_running, at_work)), 10)
        for pid in filter(is_running, at_work):
            os.kill(pid, signal.SIGKILL)
        assert ended, "geomesh outlived QGIS"
    assert list(place.iterdir()) == []
