"""Batch mode: the dialog with one row for each raster."""

from __future__ import annotations

import json

from qgis.core import QgsProject, QgsVectorLayer
from qgis.PyQt.QtWidgets import QFileDialog


def test_a_batch_of_scenes(provider, qgis_iface, samples, tmp_path, project, monkeypatch):
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    names = ("olinda_landsat7_rgb_uint8", "rmnp_rgb", "colorado_dem_float32_epsg4269")
    rows = [
        {
            "PARAMETERS": {"INPUT": repr(str(samples / f"{name}.tif")), "NODES": "90"},
            "OUTPUTS": {"OUTPUT": str(tmp_path / f"{name}.gpkg")},
        }
        for name in names
    ]
    file = tmp_path / "batch.json"
    file.write_text(json.dumps(rows))
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(file), ""))
    dialog = BatchAlgorithmDialog(provider.algorithm("rastertomesh").create())
    dialog.mainWidget().load()
    assert dialog.mainWidget().batchRowCount() == 3
    dialog.mainWidget().checkLoadLayersOnCompletion.setChecked(True)
    dialog.runAlgorithm()
    for name in names:
        layer = QgsVectorLayer(f"{tmp_path / name}.gpkg|layername=nodes", name, "ogr")
        assert 0 < layer.featureCount() <= 90
    loaded = sorted(layer.name() for layer in QgsProject.instance().mapLayers().values())
    assert loaded == sorted(f"{name} {part}" for name in names for part in ("nodes", "triangles"))
    dialog.close()
