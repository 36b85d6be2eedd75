"""The styles of terrain: heights of a TIN in bands, and contours with labels."""

from __future__ import annotations

import math

from qgis.core import (
    QgsColorRampShader,
    QgsLabeling,
    QgsLineSymbol,
    QgsMeshDatasetIndex,
    QgsMeshLayer,
    QgsPalLayerSettings,
    QgsProperty,
    QgsPropertyCollection,
    QgsRuleBasedRenderer,
    QgsTextBufferSettings,
    QgsTextFormat,
    QgsVectorLayer,
    QgsVectorLayerSimpleLabeling,
)
from qgis.PyQt.QtGui import QColor

from .styling import find_group, show_group

# What MDAL calls the heights of the nodes.
HEIGHTS = "Bed Elevation"

# Viridis: its lightness rises evenly, so that higher ground is always lighter.
_RAMP = [
    "#440154",
    "#482878",
    "#3e4989",
    "#31688e",
    "#26828e",
    "#1f9e89",
    "#35b779",
    "#6ece58",
    "#b5de2b",
    "#fde725",
]

# Bands of heights between two contours.
_MOST_BANDS = 20

_BROWN = "#6b4423"
_THIN, _THICK = "0.18", "0.45"


def round_interval(span: float, most: int = _MOST_BANDS) -> float:
    """Return 1, 2 or 5 times a power of ten, of which at most `most` are in a span of heights."""
    if not span > 0:
        return 1.0
    step = span / most
    power = 10.0 ** math.floor(math.log10(step))
    return next(each * power for each in (1, 2, 5, 10) if each * power >= step * (1 - 1e-9))


def style_heights(layer: QgsMeshLayer) -> None:
    """Colour a TIN by height. One colour ends and the next begins at contours."""
    group = find_group(layer, HEIGHTS)
    if group is None:
        return
    about = layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0))
    low, high = about.minimum(), about.maximum()
    if not (math.isfinite(low) and math.isfinite(high)):
        return
    step = round_interval(high - low)
    first = math.floor(low / step)
    bands = max(math.ceil(high / step) - first, 1)
    shader = QgsColorRampShader(
        first * step, (first + bands) * step, None, QgsColorRampShader.Type.Discrete
    )
    items = []
    for band in range(bands):
        below, above = ((first + band + more) * step for more in (0, 1))
        color = _color(band / max(bands - 1, 1))
        label = f"{below:.10g} to {above:.10g}"
        items.append(QgsColorRampShader.ColorRampItem(above, color, label))
    shader.setColorRampItemList(items)
    show_group(layer, group, shader)


def style_contours(layer: QgsVectorLayer) -> None:
    """Draw contours as thin lines. Index contours are thicker, with their level along them."""
    root = QgsRuleBasedRenderer.Rule(None)
    for label, rule, width in (("contour", "ELSE", _THIN), ("index contour", '"index"', _THICK)):
        symbol = QgsLineSymbol.createSimple(
            {"line_color": _BROWN, "line_width": width, "joinstyle": "round", "capstyle": "round"}
        )
        root.appendChild(QgsRuleBasedRenderer.Rule(symbol, 0, 0, rule, label))
    layer.setRenderer(QgsRuleBasedRenderer(root))
    layer.setLabeling(QgsVectorLayerSimpleLabeling(_labels()))
    layer.setLabelsEnabled(True)


def _labels() -> QgsPalLayerSettings:
    buffer = QgsTextBufferSettings()
    buffer.setEnabled(True)
    buffer.setSize(0.8)
    buffer.setColor(QColor("#ffffff"))
    text = QgsTextFormat()
    text.setSize(8)
    text.setColor(QColor(_BROWN))
    text.setBuffer(buffer)
    labels = QgsPalLayerSettings()
    # A level may be 0.1 * 3, which has more digits than are meant.
    labels.fieldName = 'to_string(round("level", 6))'
    labels.isExpression = True
    labels.setFormat(text)
    labels.placement = QgsPalLayerSettings.Placement.Curved
    lines = labels.lineSettings()
    lines.setPlacementFlags(QgsLabeling.LinePlacementFlag.OnLine)
    labels.setLineSettings(lines)
    shown = QgsPropertyCollection()
    shown.setProperty(QgsPalLayerSettings.Property.Show, QgsProperty.fromField("index"))
    labels.setDataDefinedProperties(shown)
    return labels


def _color(share: float) -> QColor:
    """Return the colour at a place of the ramp, from 0 to 1."""
    place = share * (len(_RAMP) - 1)
    index = min(int(place), len(_RAMP) - 2)
    one, other = QColor(_RAMP[index]), QColor(_RAMP[index + 1])
    part = place - index
    return QColor(
        *(
            round(a + part * (b - a))
            for a, b in zip(
                (one.red(), one.green(), one.blue()), (other.red(), other.green(), other.blue())
            )
        )
    )
