"""The published packages: their content is complete, and they work without the checkout."""

from __future__ import annotations

import configparser
import email
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile

import pytest

import geomesh
from support.samples import OLINDA, ROOT

BIN = "Scripts" if os.name == "nt" else "bin"

# The same worker runs all these tests, so the packages are built only once.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("packaging")]


def run(*command, cwd, code=0):
    """Run a program without settings of the checkout; return what it printed."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    settings = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """The folder with the sdist and the wheel. The wheel is built only from the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(dist):
    (path,) = dist.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_bytes(archive.read(name))


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    assert wheel.name == f"geomesh_toolkit-{geomesh.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    about = {name for name in inside if ".dist-info/" in name}
    sources = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "geomesh"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert inside - about == set(sources.stdout.split())
    assert "geomesh/py.typed" in inside
    assert any(name.endswith("licenses/LICENSE") for name in about)


def test_the_sdist_holds_what_the_wheel_is_built_from(dist):
    (path,) = dist.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        inside = {name.split("/")[1] for name in archive.getnames() if "/" in name}
    papers = {"README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "PKG-INFO"}
    assert inside == {"geomesh", "pyproject.toml", ".gitignore"} | papers


def test_commands_are_registered_with_the_shell_and_with_rasterio(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("entry_points.txt"))
        told = configparser.ConfigParser()
        told.read_string(archive.read(name).decode())
    assert {group: dict(told[group]) for group in told.sections()} == {
        "console_scripts": {"geomesh": "geomesh.cli:main"},
        "rasterio.rio_plugins": {"geomesh": "geomesh.cli:cli"},
    }


def test_the_metadata_are_complete(metadata):
    assert metadata["Name"] == "geomesh-toolkit"
    assert metadata["Version"] == geomesh.__version__
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["License-Expression"] == "MIT"
    assert metadata["License-File"] == "LICENSE"
    assert metadata["Summary"]
    assert metadata["Author"]
    assert metadata["Keywords"]
    assert metadata["Description-Content-Type"] == "text/markdown"
    extras = set(metadata.get_all("Provides-Extra"))
    assert extras == {
        "dask",
        "evaluate",
        "exact",
        "figures",
        "graph",
        "terrain",
        "xarray",
    }
    # There is no public address yet. No address is better than one that does not work.
    assert metadata.get_all("Project-URL") is None


def test_the_description_has_no_dead_links(metadata):
    text = metadata.get_payload(decode=True).decode()
    assert text.startswith("# geomesh\n")
    assert len(text) > 0.8 * len((ROOT / "README.md").read_text(encoding="utf-8"))
    assert re.findall(r"!?\[[^\]]*\]\((?!https?:)[^)]*\)", text) == []
    assert "Getting started and a tutorial from image to map" in text


def test_every_message_about_a_missing_extra_names_one_that_exists(metadata):
    told = {
        extra
        for path in (ROOT / "geomesh").rglob("*.py")
        for extra in re.findall(r"geomesh-toolkit\[(\w+)\]", path.read_text(encoding="utf-8"))
    }
    assert told
    assert told <= set(metadata.get_all("Provides-Extra"))


LOOK = """
import pathlib, sys, geomesh
assert pathlib.Path(sys.prefix) in pathlib.Path(geomesh.__file__).parents, geomesh.__file__
mesh = geomesh.read_mesh("mesh.gpkg")
assert mesh.certify().passed
assert mesh._repr_html_().startswith("<div")
mesh.plot(path="plot.png")
again = geomesh.mesh_raster("scene.tif", nodes=300)
assert (again.triangles == mesh.triangles).all()
assert mesh.explore()._repr_html_().startswith("<iframe")
try:
    mesh.to_graph("networkx")
except geomesh.GeomeshError as error:
    print(error)
"""


@pytest.fixture
def bare(wheel, tmp_path):
    """The programs of an environment with only the wheel and its dependencies."""
    place = tmp_path / "bare"
    run(sys.executable, "-m", "venv", place, cwd=tmp_path)
    python = place / BIN / "python"
    pinned = ("--quiet", "--disable-pip-version-check", "--constraint", ROOT / "constraints.txt")
    run(python, "-m", "pip", "install", *pinned, f"{wheel}[figures]", cwd=tmp_path)
    yield place / BIN
    shutil.rmtree(place)  # it is more than 1 GB, and pytest keeps the folders of three runs


def test_the_demo_runs_from_the_wheel_alone(bare, tmp_path):
    python, command, rio = (bare / name for name in ("python", "geomesh", "rio"))
    folder = tmp_path / "work"
    folder.mkdir()
    run(python, "-m", "pip", "check", cwd=folder)
    shutil.copy(OLINDA, folder / "scene.tif")
    told, _ = run(command, "mesh", "scene.tif", "-o", "mesh.gpkg", "--nodes", 300, cwd=folder)
    count = len(geomesh.mesh_raster(OLINDA, nodes=300).triangles)
    assert told == f"mesh.gpkg: 300 nodes, {count} triangles, certified\n"
    run(command, "stages", "scene.tif", "-o", "stages.png", "--nodes", 300, cwd=folder)
    told, _ = run(command, "quality", "mesh.gpkg", "--json", cwd=folder)
    assert json.loads(told)["triangles"] == count
    told, _ = run(command, "--version", cwd=folder)
    assert told.startswith(f"geomesh, version {geomesh.__version__}\n")
    assert "cannot be imported" not in told

    told, _ = run(rio, "--help", cwd=folder)
    assert re.search(r"^  geomesh +Turn georeferenced rasters", told, re.MULTILINE)
    told, _ = run(rio, "geomesh", "--help", cwd=folder)
    assert told.startswith("Usage: rio geomesh ")
    run(rio, "geomesh", "mesh", "scene.tif", "-o", "rio.gpkg", "--nodes", 300, cwd=folder)
    told = run(rio, "geomesh", "mesh", "none.tif", "-o", "none.gpkg", cwd=folder, code=1)
    assert told == ("", "Error: none.tif: no such file; check the path\n")

    told, _ = run(python, "-c", LOOK, cwd=folder)
    assert told == "networkx is not installed: pip install 'geomesh-toolkit[graph]'\n"
    assert {path.name for path in folder.iterdir()} == {
        *("scene.tif", "mesh.gpkg", "stages.png", "rio.gpkg", "plot.png"),
    }
    mine = geomesh.mesh_raster(OLINDA, nodes=300)
    for name in ("mesh.gpkg", "rio.gpkg"):
        made = geomesh.read_mesh(folder / name)
        assert (made.nodes == mine.nodes).all()
        assert (made.triangles == mine.triangles).all()
