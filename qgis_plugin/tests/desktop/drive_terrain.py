"""The actions of a user who wants a TIN: menu, dialog, Run, look at the map. Runs in QGIS."""

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, os.environ["GEOMESH_TEST_SCRIPTS"])

import processing
import qgis.utils
from driver import Driver, canvas_is_still, press_run, processing_dialog
from qgis.core import QgsMeshLayer, QgsProject, QgsRasterLayer
from qgis.gui import QgsDoubleSpinBox
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtGui import QColor
from qgis.PyQt.QtWidgets import QAction, QApplication, QDockWidget, QTextEdit

iface = qgis.utils.iface
PICTURES = Path(os.environ["GEOMESH_TEST_PICTURES"])


def own_menu():
    """Return the menu geomesh in the Raster menu."""
    menus = (action.menu() for action in iface.rasterMenu().actions())
    return next((menu for menu in menus if menu and "geomesh" in menu.title()), None)


def mesh_layers(project):
    return [layer for layer in project.mapLayers().values() if isinstance(layer, QgsMeshLayer)]


def steps(driver):
    report = driver.report
    window, canvas, project = iface.mainWindow(), iface.mapCanvas(), QgsProject.instance()
    window.showNormal()
    window.setGeometry(QApplication.primaryScreen().geometry())
    for dock in window.findChildren(QDockWidget):
        if dock.objectName() in ("Browser", "ProcessingToolbox"):
            dock.hide()
    menu = yield own_menu
    report["menu"] = [action.text() for action in menu.actions() if not action.isSeparator()]

    raster = QgsRasterLayer(os.environ["GEOMESH_TEST_RASTER"], "Colorado")
    project.addMapLayer(raster)
    project.setCrs(raster.crs())
    iface.setActiveLayer(raster)
    yield canvas_is_still()
    action = window.findChild(QAction, "geomesh_demtotin")
    QTimer.singleShot(0, action.trigger)  # it returns only after its dialog is closed
    dialog = yield processing_dialog
    dialog.setGeometry(140, 60, 1000, 680)
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_tin_dialog.png")
    report["shown"] = [box.text() for box in dialog.findChildren(QgsDoubleSpinBox)]
    pressed = time.monotonic()
    report["successful"], report["results"] = yield from press_run(dialog)
    report["log"] = [text.toPlainText() for text in dialog.findChildren(QTextEdit)]
    if not report["successful"]:
        return
    (tin,) = yield lambda: mesh_layers(project)
    yield lambda: not canvas.isDrawing()
    report["seconds"] = time.monotonic() - pressed
    dialog.close()
    yield lambda: processing_dialog() is None
    report["layers"] = [node.layer().name() for node in project.layerTreeRoot().findLayers()]

    iface.setActiveLayer(tin)
    iface.layerTreeView().collapseAllNodes()
    canvas.setExtent(raster.extent())
    iface.messageBar().clearWidgets()
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_tin_whole.png", window)
    # The first of the mirror images, which is the DEM of the sample.
    part = raster.extent()
    part.setXMaximum(part.xMinimum() + 512 * raster.rasterUnitsPerPixelX())
    part.setYMinimum(part.yMaximum() - 448 * raster.rasterUnitsPerPixelY())
    canvas.setExtent(part)
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_tin_map.png", window)

    given = {"INPUT": tin.id(), "OUTPUT": "TEMPORARY_OUTPUT"}
    report["contours"] = processing.runAndLoadResults("geomesh:contours", given)
    settings = tin.rendererSettings()
    edges = settings.nativeMeshSettings()
    edges.setEnabled(True)
    edges.setColor(QColor(0, 0, 0, 90))
    edges.setLineWidth(0.1)
    settings.setNativeMeshSettings(edges)
    tin.setRendererSettings(settings)
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_tin_contours.png", window)


# QGIS deletes the variables of a script at its end. This keeps the driver.
qgis.utils.geomesh_test = Driver(steps, timeout=300)
