"""What the documents say is so: examples run, and every column is listed."""

import doctest
import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import SAMPLES

import geomesh

ROOT = Path(__file__).parent.parent


def test_the_readme_example_runs(tmp_path, monkeypatch):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    shutil.copy(SAMPLES / "olinda_landsat7_rgb_uint8.tif", tmp_path / "scene.tif")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names = {}
    exec(code, names)
    assert (names["again"].nodes == names["mesh"].nodes).all()
    assert names["graph"].shape == (len(names["mesh"].nodes),) * 2


def test_the_cluster_example_runs(tmp_path):
    (code,) = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / "large-rasters.md").read_text(), re.DOTALL
    )
    scene = shutil.copy(SAMPLES / "olinda_landsat7_rgb_uint8.tif", tmp_path / "scene.tif")
    # A file of its own: the workers' processes import it.
    (tmp_path / "example.py").write_text(code)
    subprocess.run([sys.executable, "example.py"], cwd=tmp_path, check=True, timeout=300)
    made = geomesh.read_mesh(tmp_path / "mesh.gpkg")
    assert (made.triangles == geomesh.mesh_raster(scene).triangles).all()


def test_links_between_documents_lead_somewhere():
    for document in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md")):
        for target in re.findall(r"\]\(([^)#:]+)\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_docstring_examples_run(monkeypatch):
    monkeypatch.chdir(ROOT)
    attempted = 0
    for found in pkgutil.walk_packages(geomesh.__path__, "geomesh."):
        outcome = doctest.testmod(importlib.import_module(found.name))
        assert outcome.failed == 0
        attempted += outcome.attempted
    assert attempted > 0


@pytest.mark.parametrize("layer", ["triangles", "nodes", "edges"])
def test_every_column_is_documented_in_order(layer):
    text = (ROOT / "docs" / "formats.md").read_text()
    section = text.split(f"\n## {layer}\n")[1].split("\n## ")[0]
    told = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    names = [name for cell in told for name in re.findall(r"`([^`]+)`", cell)]
    mesh = geomesh.mesh_raster(SAMPLES / "colorado_dem_float32_epsg4269.tif")
    expected = list(mesh.attributes(layer))
    if layer == "triangles":
        names[names.index("_std") : names.index("_max") + 1] = [
            "<band>_std",
            "<band>_min",
            "<band>_max",
        ]
    assert names == [re.sub(r"^b1", "<band>", name) for name in expected]
