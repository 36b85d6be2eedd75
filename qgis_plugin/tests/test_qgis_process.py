"""The plugin without a desktop: complete runs of `qgis_process` on a real scene."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from qgis.core import QgsVectorLayer
from support import find_program


def test_lists_and_explains(qgis_process):
    listing = qgis_process("list").stdout
    assert "geomesh:rastertomesh" in listing
    described = qgis_process("help", "geomesh:rastertomesh").stdout
    for word in ("Raster", "Node budget", "MIN_SPACING", "NODE_COUNT"):
        assert word in described


def test_end_to_end(qgis_process, olinda, tmp_path):
    output = tmp_path / "olinda mesh.gpkg"
    result = qgis_process(
        "run", "geomesh:rastertomesh", f"--INPUT={olinda}", f"--OUTPUT={output}", "--NODES=500"
    )
    assert "500 nodes" in result.stdout
    assert "100" in result.stdout  # progress
    for name, count in (("triangles", 900), ("nodes", 500), ("edges", 1300)):
        layer = QgsVectorLayer(f"{output}|layername={name}", name, "ogr")
        assert layer.isValid()
        assert layer.crs().authid() == "EPSG:31985"
        assert layer.featureCount() == pytest.approx(count, rel=0.12)
    assert [path.name for path in tmp_path.iterdir()] == [output.name]


def test_json(qgis_process, olinda, tmp_path):
    output = tmp_path / "mesh.gpkg"
    result = qgis_process(
        "--json",
        "run",
        "geomesh:rastertomesh",
        f"--INPUT={olinda}",
        f"--OUTPUT={output}",
        "--NODES=100",
    )
    told = json.loads(result.stdout)
    assert told["results"]["NODE_COUNT"] == 100
    assert told["results"]["OUTPUT"].startswith(str(output))


def test_an_adaptive_mesh(qgis_process, olinda, tmp_path):
    output = tmp_path / "mesh.gpkg"
    given = ["--PRESET=2", "--GOAL=2", "--ERROR=15,12,11", "--EFFORT=0", "--NODES=400"]
    where = [f"--INPUT={olinda}", f"--OUTPUT={output}", f"--MESH={tmp_path / 'mesh.nc'}"]
    result = qgis_process("run", "geomesh:rastertomesh", *where, *given)
    assert "accuracy of red: greatest error" in result.stdout
    layer = QgsVectorLayer(f"{output}|layername=nodes", "nodes", "ogr")
    assert 10 < layer.featureCount() <= 400
    assert {path.name for path in tmp_path.iterdir()} == {"mesh.gpkg", "mesh.nc", "mesh.qml"}


def test_failure_is_an_exit_code_and_one_line(qgis_process, tmp_path):
    output = tmp_path / "mesh.gpkg"
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"II*\0 not really")
    result = qgis_process(
        "run", "geomesh:rastertomesh", f"--INPUT={bad}", f"--OUTPUT={output}", check=False
    )
    assert result.returncode != 0
    assert "Traceback" not in result.stdout + result.stderr
    assert not output.exists()


def test_interrupt_cancels(qgis_environment, tmp_path, samples, geomesh_python):
    """Ctrl-C stops a long run. It leaves no file, no hidden folder and no child process."""
    profile = tmp_path / "profile"
    environment = qgis_environment(profile)
    big = tmp_path / "big.vrt"
    enlarge(samples / "olinda_landsat7_6band_uint8.tif", big)
    folder = tmp_path / "out"
    folder.mkdir()
    program = find_program("qgis_process")
    subprocess.run([program, "plugins", "enable", "geomesh_qgis"], env=environment, check=True)
    process = subprocess.Popen(
        [
            program,
            "run",
            "geomesh:rastertomesh",
            f"--INPUT={big}",
            f"--OUTPUT={folder / 'mesh.gpkg'}",
        ],
        env=environment,
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not children(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    (child,) = children(process.pid)
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode != 0, said
    deadline = time.monotonic() + 20
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not Path(f"/proc/{child}").exists()
    assert list(folder.iterdir()) == []


def children(pid: int) -> list[int]:
    """Return the children of `pid` that have geomesh in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            command = (entry / "cmdline").read_bytes()
        except (OSError, ValueError, IndexError):
            continue
        if parent == pid and b"geomesh" in command and os.getpgid(int(entry.name)):
            found.append(int(entry.name))
    return found


def enlarge(raster: Path, path: Path) -> None:
    """Make a VRT of 6000 x 6000 pixels, which uses almost no disk space."""
    from osgeo import gdal

    gdal.Translate(str(path), str(raster), format="VRT", width=6000, height=6000)
