"""Fixtures for the tests of the plugin. They run in the Python of QGIS: make test-qgis."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support import PLUGINS, SAMPLES, find_program

sys.path.insert(0, str(PLUGINS))

# QGIS computes statistics of each raster that it opens. GDAL would save them beside the samples.
os.environ["GDAL_PAM_ENABLED"] = "NO"


def pytest_collection_modifyitems(items):
    # test_plugin.py runs last: it unloads the plugin, which removes the provider of other tests.
    items.sort(key=lambda item: item.path.name == "test_plugin.py")


@pytest.fixture(autouse=True)
def no_message_box(monkeypatch):
    """Fail a test that opens a message box, with the box's text: nobody could close the box."""
    from qgis.PyQt.QtWidgets import QMessageBox

    def refuse(_parent, title, text, *_, **__):
        raise AssertionError(f"message box: {title}: {text}")

    for kind in ("critical", "warning", "information", "question"):
        monkeypatch.setattr(QMessageBox, kind, refuse)
    for run in {"exec", "exec_"} & set(dir(QMessageBox)):
        monkeypatch.setattr(
            QMessageBox, run, lambda box: refuse(box, box.windowTitle(), box.text())
        )


@pytest.fixture(scope="session")
def samples() -> Path:
    """The folder of sample rasters."""
    return SAMPLES


@pytest.fixture(scope="session")
def olinda() -> Path:
    """Three bands of Landsat 7, 349 by 352 pixels, UTM 25S."""
    return SAMPLES / "olinda_landsat7_rgb_uint8.tif"


@pytest.fixture(scope="session", autouse=True)
def geomesh_python() -> Path:
    """The Python of the environment that contains geomesh. The plugin finds it the same way."""
    python = os.environ.get("GEOMESH_PYTHON", "")
    if not python or not Path(python).exists():
        pytest.exit("GEOMESH_PYTHON has to name a Python with geomesh: use make test-qgis", 2)
    return Path(python)


@pytest.fixture(scope="session")
def processing(qgis_processing):
    """The module `processing`, initialized."""
    import processing

    return processing


@pytest.fixture(scope="session", autouse=True)
def clean_end(qgis_app):
    """Free the objects of failed tests before QGIS ends. Later, this would crash, unreported."""
    yield
    for name in ("last_exc", "last_type", "last_value", "last_traceback"):
        vars(sys).pop(name, None)
    gc.collect()


@pytest.fixture(scope="session", autouse=True)
def layer_tree(qgis_iface, qgis_parent):
    """A layer tree view for the QGIS interface stub: QGIS 3.44 adds results to it."""
    from qgis.core import QgsLayerTreeModel, QgsProject
    from qgis.gui import QgsLayerTreeView

    view = QgsLayerTreeView(qgis_parent)
    view.setModel(QgsLayerTreeModel(QgsProject.instance().layerTreeRoot(), view))
    qgis_iface.layerTreeView = lambda: view


@pytest.fixture(scope="session")
def provider(qgis_app, processing):
    """The provider of geomesh, registered for the whole test session."""
    from geomesh_qgis.provider import GeomeshProvider

    registry = qgis_app.processingRegistry()
    # The plugin may have registered it. A second provider with the same id would delete the first.
    known = registry.providerById(GeomeshProvider.ID)
    if known is not None:
        yield known
        return
    provider = GeomeshProvider()
    assert registry.addProvider(provider)
    yield provider
    # A test may have removed the provider. This also deletes it.
    if registry.providerById(GeomeshProvider.ID) is not None:
        registry.removeProvider(GeomeshProvider.ID)


@pytest.fixture
def project(qgis_new_project):
    """An empty project, cleared after the test: layers that still exist at the end crash QGIS."""
    from qgis.core import QgsProject

    yield QgsProject.instance()
    QgsProject.instance().clear()


@pytest.fixture
def run(provider, processing, tmp_path, project):
    """Run `geomesh:rastertomesh` with an output in the temporary folder of the test."""
    from meshing import ALGORITHM, Listener

    def run(raster, output="mesh.gpkg", feedback=None, **parameters):
        given = {"INPUT": raster, "OUTPUT": str(tmp_path / output), **parameters}
        given = {name: str(v) if isinstance(v, Path) else v for name, v in given.items()}
        return processing.run(ALGORITHM, given, feedback=feedback or Listener())

    return run


@pytest.fixture
def loaded(provider, processing, olinda, tmp_path, project):
    """Run an algorithm as the dialog does, and load all results into the project."""

    def load(algorithm="geomesh:rastertomesh", **parameters):
        given = {"INPUT": str(olinda), "OUTPUT": str(tmp_path / "mesh.gpkg"), **parameters}
        processing.runAndLoadResults(algorithm, given)
        return {layer.name(): layer for layer in project.mapLayers().values()}

    return load


@pytest.fixture(scope="session")
def qgis_environment(tmp_path_factory):
    """Make the environment of a QGIS process that is separate from the user's profile."""

    def make(profile: Path, plugins: Path | None = PLUGINS) -> dict[str, str]:
        runtime = tmp_path_factory.mktemp("runtime")
        runtime.chmod(0o700)  # Qt requires this mode
        environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("QGIS_", "PYTEST_", "PYTHON", "VIRTUAL_ENV", "XDG_"))
        }
        environment.update(
            XDG_RUNTIME_DIR=str(runtime),
            QGIS_CUSTOM_CONFIG_PATH=str(profile),
            QT_QPA_PLATFORM="offscreen",
            LC_ALL="C.UTF-8",
        )
        if plugins:
            environment["QGIS_PLUGINPATH"] = str(plugins)
        return environment

    return make


@pytest.fixture(scope="session")
def qgis_process(tmp_path_factory, qgis_environment):
    """Run `qgis_process` with the plugin enabled, in a profile for the test session."""
    profile = tmp_path_factory.mktemp("profile")
    environment = qgis_environment(profile)

    def run(*arguments, check=True, timeout=300, cwd=None, **more):
        result = subprocess.run(
            [find_program("qgis_process"), *map(str, arguments)],
            env={**environment, **more},
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
        if check:
            assert result.returncode == 0, result.stdout + result.stderr
        return result

    run("plugins", "enable", "geomesh_qgis")
    return run
