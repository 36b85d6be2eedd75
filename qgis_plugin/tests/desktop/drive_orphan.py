"""Start a long run and wait until the test kills QGIS. Runs inside QGIS."""

import os
import sys

sys.path.insert(0, os.environ["GEOMESH_TEST_SCRIPTS"])

import processing
import qgis.utils
from driver import Driver, processing_dialog
from qgis.PyQt.QtCore import QTimer


def steps(driver):
    yield lambda: "geomesh_qgis" in qgis.utils.plugins
    parameters = {
        "INPUT": os.environ["GEOMESH_TEST_RASTER"],
        "OUTPUT": os.environ["GEOMESH_TEST_OUTPUT"],
    }
    QTimer.singleShot(0, lambda: processing.execAlgorithmDialog("geomesh:rastertomesh", parameters))
    dialog = yield processing_dialog
    QTimer.singleShot(0, dialog.runButton().click)
    yield lambda: False


qgis.utils.geomesh_test = Driver(steps, timeout=300)
