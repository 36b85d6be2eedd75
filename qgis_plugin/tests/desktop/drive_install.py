"""The actions of a new user: Install geomesh, wait, Verify, mesh a raster. Runs inside QGIS."""

import os
import sys
from pathlib import Path

sys.path.insert(0, os.environ["GEOMESH_TEST_SCRIPTS"])

import qgis.utils
from driver import Driver, canvas_is_still, options_page, press_run, processing_dialog
from qgis.core import QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QAction, QLabel, QProgressBar, QPushButton

iface = qgis.utils.iface
PICTURES = Path(os.environ["GEOMESH_TEST_PICTURES"])


def steps(driver):
    report = driver.report
    window, project = iface.mainWindow(), QgsProject.instance()
    window.setGeometry(0, 0, 1280, 800)
    action = yield lambda: window.findChild(QAction, "geomeshRasterToMesh")
    raster = QgsRasterLayer(os.environ["GEOMESH_TEST_RASTER"], "Olinda, Landsat 7")
    project.addMapLayer(raster)
    iface.setActiveLayer(raster)
    yield canvas_is_still()

    action.trigger()
    button = yield lambda: window.findChild(QPushButton, "geomeshOpenOptions")
    report["dialog_without_geomesh"] = processing_dialog() is not None
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_first_press.png", window)
    QTimer.singleShot(0, button.click)
    page = yield options_page
    dialog = page.window()
    dialog.setGeometry(140, 60, 1000, 560)
    version, status = (page.findChild(QLabel, name) for name in ("versionLabel", "statusLabel"))
    install, verify = (
        page.findChild(QPushButton, name) for name in ("installButton", "verifyButton")
    )
    bar = page.findChild(QProgressBar, "progressBar")
    yield lambda: install.isEnabled()
    report["before"] = version.text()
    report["verify_before"] = verify.isEnabled()
    install.click()
    yield lambda: bar.value() >= 30 or install.isEnabled()
    yield canvas_is_still()
    report["half_way"] = bar.value()
    report["status_half_way"] = status.text()
    driver.picture(PICTURES / "qgis_installing.png", dialog)
    yield lambda: install.isEnabled()
    report["status"], report["version"] = status.text(), version.text()
    report["again"] = install.text()
    yield canvas_is_still()
    driver.picture(PICTURES / "qgis_options.png", dialog)
    verify.click()
    yield lambda: "works" in status.text() or (verify.isEnabled() and status.text())
    report["verified"] = status.text()
    yield lambda: install.isEnabled()
    dialog.accept()
    yield lambda: options_page() is None

    QTimer.singleShot(0, action.trigger)
    dialog = yield processing_dialog
    report["successful"], report["results"] = yield from press_run(dialog)
    dialog.close()
    yield lambda: processing_dialog() is None


# QGIS deletes the variables of a script at its end. This keeps the driver.
qgis.utils.geomesh_test = Driver(steps, timeout=500)
