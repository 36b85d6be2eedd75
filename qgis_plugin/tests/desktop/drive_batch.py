"""A batch: the dialog with one row for each raster. Runs inside QGIS."""

import os
import sys
from pathlib import Path

sys.path.insert(0, os.environ["GEOMESH_TEST_SCRIPTS"])

import qgis.utils
from driver import Driver, canvas_is_still
from qgis.core import QgsApplication, QgsProcessingContext, QgsProject

FOLDER = Path(os.environ["GEOMESH_TEST_OUTPUT"])


def steps(driver):
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    find = QgsApplication.processingRegistry().createAlgorithmById
    algorithm = yield lambda: find("geomesh:rastertomesh")
    rasters = [Path(raster) for raster in os.environ["GEOMESH_TEST_RASTERS"].split(os.pathsep)]
    dialog = BatchAlgorithmDialog(algorithm, qgis.utils.iface.mainWindow())
    panel = dialog.mainWidget()
    panel.clear()
    for row, raster in enumerate(rasters):
        panel.addRow()
        for parameter, value in {"INPUT": str(raster), "NODES": 90}.items():
            widget = panel.wrappers[row][panel.parameter_to_column[parameter]]
            widget.setParameterValue(value, QgsProcessingContext())
        output = panel.tblParameters.cellWidget(row + 1, panel.parameter_to_column["OUTPUT"])
        output.setValue(str(FOLDER / f"{raster.stem}.gpkg"))
    panel.checkLoadLayersOnCompletion.setChecked(True)
    dialog.show()
    yield canvas_is_still()
    dialog.runButton().click()
    layers = QgsProject.instance().mapLayers
    yield lambda: len(layers()) >= 2 * len(rasters)
    yield canvas_is_still()
    dialog.close()
    driver.report["layers"] = {
        layer.name(): layer.featureCount() for layer in QgsProject.instance().mapLayers().values()
    }


# QGIS deletes the variables of a script at its end. This keeps the driver.
qgis.utils.geomesh_test = Driver(steps, timeout=120)
