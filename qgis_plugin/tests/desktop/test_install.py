"""From the zip to the first mesh in the real QGIS, with the buttons that a new user presses."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import pytest
from harness import HERE, run_desktop
from support import build


@pytest.fixture(scope="module")
def seen(tmp_path_factory, olinda, geomesh_python):
    """The report of a run of drive_install.py. It downloads the packages from the index."""
    folder = tmp_path_factory.mktemp("install")
    pictures = Path(os.environ.get("GEOMESH_SCREENSHOTS", folder / "pictures")).resolve()
    zipped, _ = build(geomesh_python, folder / "dist")
    with zipfile.ZipFile(zipped) as archive:
        archive.extractall(folder / "plugins")
    desktop = folder / "desktop"
    desktop.mkdir()
    report = run_desktop(
        "drive_install.py",
        desktop,
        timeout=900,
        plugins=folder / "plugins",
        GEOMESH_PYTHON="",
        GEOMESH_TEST_SCRIPTS=HERE,
        GEOMESH_TEST_RASTER=olinda,
        GEOMESH_TEST_PICTURES=pictures,
    )
    return {**report, "profile": desktop / "profile"}


def test_the_drive_came_to_its_end(seen):
    assert seen["failure"] is None, seen["failure"]
    assert seen["exceptions"] == []
    assert seen["boxes"] == []
    assert seen["exit"] == 0, seen["qgis_log"]


def test_the_page_says_what_there_is_before_and_after(seen):
    assert "press Install geomesh" in seen["before"]
    assert not seen["verify_before"]
    assert seen["status"].startswith("geomesh ")
    assert "is installed" in seen["status"]
    assert seen["again"] == "Reinstall"
    assert seen["version"] in seen["status"]
    assert "works" in seen["verified"]


def test_the_button_leads_to_the_page_where_geomesh_can_be_installed(seen):
    assert not seen["dialog_without_geomesh"]


def test_progress_is_shown_meanwhile(seen):
    assert 30 <= seen["half_way"] < 100
    assert seen["status_half_way"]


def test_the_engine_is_in_the_profile_and_meshes(seen):
    folder = next(seen["profile"].rglob("geomesh/environment"))
    assert (folder / "pyvenv.cfg").is_file()
    assert seen["successful"]
    assert seen["results"]["TRIANGLE_COUNT"] > 1000
