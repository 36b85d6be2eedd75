"""Pictures of layers as the map shows them, and how much they differ."""

from __future__ import annotations

from qgis.core import QgsMapRendererParallelJob, QgsMapSettings
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor, QImage, QPainter


def paint(layers, extent, side=300) -> QImage:
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setOutputSize(QSize(side, side))
    settings.setExtent(extent)
    settings.setDestinationCrs(layers[0].crs())
    settings.setBackgroundColor(QColor("magenta"))
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    assert job.errors() == []
    return job.renderedImage()


def blocks(image: QImage, count=12) -> list[tuple[float, float, float]]:
    """Return the mean colours of a grid of blocks, as seen from far away."""
    from qgis.PyQt.QtCore import Qt

    small = image.scaled(
        count,
        count,
        Qt.AspectRatioMode.IgnoreAspectRatio,
        Qt.TransformationMode.SmoothTransformation,
    )
    colors = (small.pixelColor(x, y) for y in range(count) for x in range(count))
    return [(color.red(), color.green(), color.blue()) for color in colors]


def difference(one, other, count=12) -> float:
    """Return the mean difference of the levels of two pictures, in a grid of blocks."""
    pairs = list(zip(blocks(one, count), blocks(other, count)))
    return sum(abs(a - b) for left, right in pairs for a, b in zip(left, right)) / (3 * len(pairs))


def beside(left: QImage, right: QImage, gap=4) -> QImage:
    """Return two pictures next to each other."""
    both = QImage(left.width() + gap + right.width(), left.height(), QImage.Format.Format_RGB32)
    both.fill(QColor("white"))
    painter = QPainter(both)
    painter.drawImage(0, 0, left)
    painter.drawImage(left.width() + gap, 0, right)
    painter.end()
    return both
