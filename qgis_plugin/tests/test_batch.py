"""Batch mode: the dialog with one row for each raster."""

from __future__ import annotations

import time

from qgis.core import QgsProcessingContext, QgsProject, QgsVectorLayer
from qgis.PyQt.QtCore import QCoreApplication


def test_a_batch_of_scenes(provider, qgis_iface, samples, tmp_path, project):
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    names = ("olinda_landsat7_rgb_uint8", "rmnp_rgb", "colorado_dem_float32_epsg4269")
    dialog = BatchAlgorithmDialog(provider.algorithm("rastertomesh").create())
    panel = dialog.mainWidget()
    panel.clear()
    for row, name in enumerate(names):
        panel.addRow()
        values = {"INPUT": str(samples / f"{name}.tif"), "NODES": 90}
        for parameter, value in values.items():
            widget = panel.wrappers[row][panel.parameter_to_column[parameter]]
            widget.setParameterValue(value, QgsProcessingContext())
        output = panel.tblParameters.cellWidget(row + 1, panel.parameter_to_column["OUTPUT"])
        output.setValue(str(tmp_path / f"{name}.gpkg"))
    panel.checkLoadLayersOnCompletion.setChecked(True)
    dialog.runAlgorithm()
    # QGIS 3.22 returns when all is done, later ones at once.
    layers = QgsProject.instance().mapLayers
    end = time.monotonic() + 120
    while len(layers()) < 2 * len(names) and time.monotonic() < end:
        QCoreApplication.processEvents()
        time.sleep(0.05)
    loaded = sorted(layer.name() for layer in layers().values())
    assert loaded == sorted(f"{name} {part}" for name in names for part in ("nodes", "triangles"))
    for name in names:
        layer = QgsVectorLayer(f"{tmp_path / name}.gpkg|layername=nodes", name, "ogr")
        assert 0 < layer.featureCount() <= 90
    dialog.close()
