"""The zip that users install: its content, and that QGIS accepts it."""

from __future__ import annotations

import configparser
import hashlib
import re
import shutil
import subprocess
import zipfile

import pytest
from support import PLUGINS, ROOT, build, find_program

PLUGIN = PLUGINS / "geomesh_qgis"


@pytest.fixture(scope="session")
def package(geomesh_python, tmp_path_factory):
    """Build the zip as `make plugin` does; return its path and the printed text."""
    return build(geomesh_python, tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="session")
def metadata():
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(PLUGIN / "metadata.txt", encoding="utf-8")
    return parser["general"]


def test_metadata_has_what_qgis_and_its_repository_ask_for(metadata):
    fixed = {
        "name": "geomesh",
        "qgisMinimumVersion": "3.22",
        "qgisMaximumVersion": "4.99",
        "supportsQt6": "True",
        "hasProcessingProvider": "yes",
        "license": "GPL-2.0-or-later",
    }
    assert {key: metadata.get(key) for key in fixed} == fixed
    for key in ("description", "about", "author", "email", "tags", "category", "icon", "changelog"):
        assert metadata.get(key, "").strip(), key
    assert "\n" not in metadata["description"]
    assert (PLUGIN / metadata["icon"]).is_file()


def test_version_is_that_of_the_library(metadata):
    library = (ROOT / "geomesh/_version.py").read_text()
    assert f'"{metadata["version"]}"' in library


def test_zip_holds_the_plugin_and_the_wheel_and_nothing_else(package, metadata):
    path, _ = package
    version = metadata["version"]
    assert path.name == f"geomesh_qgis-{version}.zip"
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        assert names == sorted(names)
        wheel = f"geomesh_qgis/wheel/geomesh_toolkit-{version}-py3-none-any.whl"
        assert wheel in names
        plugin = {name.removeprefix("geomesh_qgis/") for name in names} - {wheel[13:]}
        with archive.open(wheel) as inner, zipfile.ZipFile(inner) as package_of_wheel:
            inside = package_of_wheel.namelist()
    for name in ("__init__.py", "metadata.txt", "LICENSE", "icon.svg"):
        assert name in plugin
    assert not [name for name in names if "__pycache__" in name or "/tests/" in name]
    assert plugin == {
        file.relative_to(PLUGIN).as_posix()
        for file in PLUGIN.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert "geomesh/cli/mesh.py" in inside
    assert not [name for name in inside if not re.match(r"geomesh(_toolkit)?[-/\w.]*$", name)]
    assert not [name for name in inside if name.endswith((".nbi", ".nbc", ".pyc"))]


def test_same_sources_give_the_same_zip(package, geomesh_python, tmp_path):
    path, printed = package
    again, _ = build(geomesh_python, tmp_path)
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(path.read_bytes()).digest()
    assert "Install from ZIP" in printed


def refusal(python, folder):
    """Return the error message of a build that stops, in a folder's copy of the plugin."""
    result = subprocess.run(
        [python, folder / "qgis_plugin/build.py", "--out", folder / "dist"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode != 0
    return result.stderr


def test_two_versions_stop_the_build(geomesh_python, tmp_path):
    copy = tmp_path / "qgis_plugin"
    shutil.copytree(PLUGINS, copy, ignore=shutil.ignore_patterns("tests", ".*"))
    (tmp_path / "geomesh").mkdir()
    (tmp_path / "geomesh/_version.py").write_text('"""Of another time."""\n__version__ = "9.9"\n')
    assert "9.9" in refusal(geomesh_python, tmp_path)
    assert not (tmp_path / "dist").exists()


def test_leftover_stops_the_build(geomesh_python, tmp_path):
    copy = tmp_path / "qgis_plugin"
    shutil.copytree(PLUGINS, copy, ignore=shutil.ignore_patterns("tests", ".*"))
    shutil.copytree(ROOT / "geomesh", tmp_path / "geomesh")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    (copy / "geomesh_qgis/plugin.py.orig").write_text("")
    assert "plugin.py.orig" in refusal(geomesh_python, tmp_path)


def test_qgis_takes_the_zip(package, qgis_environment, tmp_path):
    # "Install from ZIP" does the same: unpack into the profile, then enable.
    profile = tmp_path / "profile"
    with zipfile.ZipFile(package[0]) as archive:
        archive.extractall(profile / "profiles/default/python/plugins")
    environment = qgis_environment(profile, plugins=None)

    def run(*arguments):
        return subprocess.run(
            [find_program("qgis_process"), *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=300,
            check=True,
        ).stdout

    assert "geomesh_qgis" in run("plugins")
    run("plugins", "enable", "geomesh_qgis")
    listed = run("list")
    for algorithm in ("geomesh:rastertomesh", "geomesh:meshquality"):
        assert algorithm in listed
    assert "INPUT" in run("help", "geomesh:rastertomesh")
