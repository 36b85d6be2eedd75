"""Helpers for tests of `geomesh:rastertomesh`."""

from __future__ import annotations

import math

from qgis.core import QgsProcessingFeedback, QgsVectorLayer

ALGORITHM = "geomesh:rastertomesh"


class Listener(QgsProcessingFeedback):
    """Feedback that records all messages, and can cancel at the first progress."""

    def __init__(self, *, cancel: bool = False) -> None:
        super().__init__(False)
        self.warnings: list[str] = []
        self.texts: list[str] = []
        self.percents: list[float] = []
        self._cancel = cancel
        self.progressChanged.connect(self._progress)

    def _progress(self, percent: float) -> None:
        self.percents.append(percent)
        if self._cancel:
            self.cancel()

    def pushWarning(self, warning: str) -> None:
        self.warnings.append(warning)

    def setProgressText(self, text: str) -> None:
        self.texts.append(text)


def open_layer(uri: str) -> QgsVectorLayer:
    layer = QgsVectorLayer(uri, "layer", "ogr")
    assert layer.isValid(), uri
    return layer


def total_area(layer: QgsVectorLayer) -> float:
    return math.fsum(feature.geometry().area() for feature in layer.getFeatures())
