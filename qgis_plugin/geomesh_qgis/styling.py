"""How the layers of a mesh look.

Styles are kept with the data (in the GeoPackage, or in a .qml beside the file), where
QGIS finds them whenever the file is opened, in whatever way.
"""

from __future__ import annotations

import math

from qgis.core import (
    QgsCategorizedSymbolRenderer,
    QgsColorRampShader,
    QgsFillSymbol,
    QgsLineSymbol,
    QgsMapLayer,
    QgsMarkerSymbol,
    QgsMeshDatasetIndex,
    QgsMeshLayer,
    QgsMeshRendererScalarSettings,
    QgsProperty,
    QgsRendererCategory,
    QgsSimpleFillSymbolLayer,
    QgsSingleSymbolRenderer,
    QgsSymbolLayer,
    QgsUnitTypes,
    QgsVectorLayer,
)
from qgis.PyQt.QtGui import QColor

from .files import is_geopackage

STYLE = "geomesh"

# Lines and dots show where they are this far apart on the screen, in millimetres.
_EDGES_APART = 1.0
_NODES_APART = 2.0

# Seen on dark and on bright images alike, and their colours through it.
_EDGE = {"outline_color": "160,160,160,130", "outline_width": "0.1", "joinstyle": "round"}

# Colours that differ for the colour-blind too (Okabe and Ito).
_NODES = (("feature", "feature node", "#e69f00"), ("border", "border node", "#56b4e9"))
_EDGES = ((0, "inner edge", "#8c8c8c", "0.15"), (1, "outline", "#d55e00", "0.4"))


def style_triangles(layer: QgsVectorLayer) -> None:
    """Fill each triangle with the mean colour of the image, with a thin edge."""
    symbol = QgsFillSymbol.createSimple(
        {"color": "#808080", "outline_color": "#808080", "outline_width": "0.1"}
    )
    if layer.fields().indexOf("color") >= 0:
        color = QgsProperty.fromField("color")
        for part in ("PropertyFillColor", "PropertyStrokeColor"):
            symbol.symbolLayer(0).setDataDefinedProperty(
                getattr(QgsSymbolLayer.Property, part), color
            )
    edge = QgsSimpleFillSymbolLayer.create({"style": "no", **_EDGE})
    # First all fills, whose own strokes close the gaps that antialiasing leaves between them.
    edge.setRenderingPass(1)
    near = QgsProperty.fromExpression(f"@map_scale < {farthest_scale(layer, _EDGES_APART)}")
    edge.setDataDefinedProperty(QgsSymbolLayer.Property.PropertyLayerEnabled, near)
    symbol.appendSymbolLayer(edge)
    renderer = QgsSingleSymbolRenderer(symbol)
    renderer.setUsingSymbolLevels(True)
    layer.setRenderer(renderer)


def farthest_scale(layer: QgsVectorLayer, apart: float) -> int:
    """Return the scale's denominator at which elements are `apart` millimetres from each other.

    Seen from farther away, lines and dots would hide the colours that they part.
    """
    box = layer.extent()
    count = max(layer.featureCount(), 1)
    metres = QgsUnitTypes.fromUnitToUnitFactor(
        layer.crs().mapUnits(), QgsUnitTypes.DistanceUnit.DistanceMeters
    )
    spacing = math.sqrt(box.width() * box.height() / count) * metres
    return max(math.ceil(spacing * 1000 / apart), 1)


def style_nodes(layer: QgsVectorLayer) -> None:
    """Show nodes as small dots, coloured by their kind."""
    categories = []
    for value, label, color in _NODES:
        symbol = QgsMarkerSymbol.createSimple(
            {
                "name": "circle",
                "color": color,
                "size": "1.2",
                "outline_color": "10,15,25,160",
                "outline_width": "0.1",
            }
        )
        categories.append(QgsRendererCategory(value, symbol, label))
    layer.setRenderer(QgsCategorizedSymbolRenderer("kind", categories))
    layer.setMinimumScale(farthest_scale(layer, _NODES_APART))
    layer.setScaleBasedVisibility(True)


def style_edges(layer: QgsVectorLayer) -> None:
    """Show edges as thin lines, those of the outline thicker."""
    categories = []
    for value, label, color, width in _EDGES:
        symbol = QgsLineSymbol.createSimple(
            {"line_color": color, "line_width": width, "capstyle": "round"}
        )
        categories.append(QgsRendererCategory(value, symbol, label))
    layer.setRenderer(QgsCategorizedSymbolRenderer('to_int("constrained")', categories))


VECTOR_STYLES = {"triangles": style_triangles, "nodes": style_nodes, "edges": style_edges}


def style_mesh_layer(layer: QgsMeshLayer) -> None:
    """Fill each face of a UGRID mesh with its own colour, not smoothed between faces."""
    group = _find_group(layer, "color")
    if group is None:
        return
    settings = layer.rendererSettings()
    scalar = settings.scalarSettings(group)
    methods = QgsMeshRendererScalarSettings.DataResamplingMethod
    flat = methods.NoResampling if hasattr(methods, "NoResampling") else methods.None_  # 3.22
    scalar.setDataResamplingMethod(flat)
    values = _distinct_values(layer, group)
    items = [
        QgsColorRampShader.ColorRampItem(value, _unpack(int(value)), f"#{int(value):06x}")
        for value in values
    ]
    shader = QgsColorRampShader(
        values[0] if values else 0,
        values[-1] if values else 0,
        None,
        QgsColorRampShader.Type.Exact,
    )
    shader.setColorRampItemList(items)
    scalar.setColorRampShader(shader)
    scalar.setClassificationMinimumMaximum(shader.minimumValue(), shader.maximumValue())
    settings.setScalarSettings(group, scalar)
    settings.setActiveScalarDatasetGroup(group)
    layer.setRendererSettings(settings)


def keep_style(layer: QgsMapLayer) -> None:
    """Save the style of a layer with its data."""
    if isinstance(layer, QgsVectorLayer) and is_geopackage(layer.source().partition("|")[0]):
        layer.saveStyleToDatabase(STYLE, "Colours of the image, by geomesh", True, "")
    else:
        layer.saveDefaultStyle()


def _find_group(layer: QgsMeshLayer, name: str) -> int | None:
    for group in layer.datasetGroupsIndexes():
        if layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0)).name() == name:
            return group
    return None


def _distinct_values(layer: QgsMeshLayer, group: int) -> list[float]:
    block = layer.datasetValues(QgsMeshDatasetIndex(group, 0), 0, layer.dataProvider().faceCount())
    return sorted({block.value(index).scalar() for index in range(block.count())})


def _unpack(packed: int) -> QColor:
    """Return the colour that geomesh wrote as 65536 red + 256 green + blue."""
    return QColor(packed >> 16 & 255, packed >> 8 & 255, packed & 255)
