"""The actions of a user: add a raster, press the button, Run, look at the map. Runs in QGIS."""

import os
import sys
from pathlib import Path

sys.path.insert(0, os.environ["GEOMESH_TEST_SCRIPTS"])

import qgis.utils
from driver import Driver, canvas_is_still, press_run, processing_dialog
from qgis.core import Qgis, QgsApplication, QgsProject, QgsRasterLayer, QgsVectorLayer
from qgis.PyQt.QtCore import QT_VERSION_STR, QTimer
from qgis.PyQt.QtWidgets import QAction, QDockWidget, QTextEdit, QToolBar
from qgis.PyQt.QtXml import QDomDocument

iface = qgis.utils.iface
RASTER = Path(os.environ["GEOMESH_TEST_RASTER"])
PICTURES = Path(os.environ["GEOMESH_TEST_PICTURES"])


def within(menu, action):
    return any(
        item is action or (item.menu() and within(item.menu(), action)) for item in menu.actions()
    )


def describe(layer):
    about = {
        "name": layer.name(),
        "valid": layer.isValid(),
        "crs": layer.crs().authid(),
        "source": layer.source(),
    }
    if isinstance(layer, QgsVectorLayer):
        about["features"] = layer.featureCount()
        about["fields"] = layer.fields().names()
        document = QDomDocument()
        layer.exportNamedStyle(document)
        about["style"] = document.toString()
    return about


def steps(driver):
    report = driver.report
    window, canvas, project = iface.mainWindow(), iface.mapCanvas(), QgsProject.instance()
    report.update(qgis=Qgis.QGIS_VERSION, qt=QT_VERSION_STR)
    report["messages"] = messages = []
    QgsApplication.messageLog().messageReceived.connect(
        lambda text, tag, _: messages.append(f"{tag}: {text}")
    )
    window.showNormal()
    window.setGeometry(QgsApplication.primaryScreen().geometry())
    for dock in window.findChildren(QDockWidget):
        if dock.objectName() in ("Browser", "ProcessingToolbox"):
            dock.hide()
    report["loaded"] = "geomesh_qgis" in qgis.utils.plugins

    action = yield lambda: window.findChild(QAction, "geomeshRasterToMesh")
    report["in_toolbar"] = any(
        action in bar.actions() and bar.isVisible() for bar in window.findChildren(QToolBar)
    )
    report["in_raster_menu"] = within(iface.rasterMenu(), action)
    report["enabled_without_layer"] = action.isEnabled()
    vector = QgsVectorLayer("Point?crs=EPSG:4326", "points", "memory")
    project.addMapLayer(vector)
    iface.setActiveLayer(vector)
    yield canvas_is_still()
    report["enabled_with_vector"] = action.isEnabled()
    project.removeMapLayer(vector)

    raster = QgsRasterLayer(str(RASTER), "Olinda, Landsat 7")
    project.addMapLayer(raster)
    project.setCrs(raster.crs())
    iface.setActiveLayer(raster)
    canvas.setExtent(raster.extent())
    yield canvas_is_still()
    report["enabled_with_raster"] = action.isEnabled()

    # A timer triggers the action, because it returns only after its dialog is closed.
    QTimer.singleShot(0, action.trigger)
    dialog = yield processing_dialog
    dialog.setGeometry(140, 80, 1000, 640)
    yield canvas_is_still()
    report["dialog"] = dialog.windowTitle()
    driver.picture(PICTURES / "qgis_dialog.png")
    report["successful"], report["results"] = yield from press_run(dialog)
    yield canvas_is_still()
    report["log"] = [text.toPlainText() for text in dialog.findChildren(QTextEdit)]
    driver.picture(PICTURES / "qgis_finished.png")
    dialog.close()
    yield lambda: processing_dialog() is None
    if not report["successful"]:
        return
    yield lambda: len(project.mapLayers()) > 1

    made = [node.layer() for node in project.layerTreeRoot().findLayers()]
    report["layers"] = [describe(layer) for layer in made if layer is not raster]
    report["messages"] = messages[:]
    for layer in made:
        if layer is not raster:
            iface.setActiveLayer(layer)
            break
    canvas.setExtent(raster.extent())
    iface.messageBar().clearWidgets()  # QGIS tells of the end of a task that took a while
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_map.png", window)
    canvas.zoomByFactor(0.3)
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_map_near.png", window)


# QGIS deletes the variables of a script at its end. This keeps the driver.
qgis.utils.geomesh_test = Driver(steps)
