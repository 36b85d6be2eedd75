"""The styles of the layers of a mesh.

Styles are saved with the data: in the GeoPackage, or in a .qml file beside the data file. QGIS
then finds them each time the file is opened.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from qgis.core import (
    QgsCategorizedSymbolRenderer,
    QgsColorRampShader,
    QgsFeatureRequest,
    QgsFillSymbol,
    QgsGraduatedSymbolRenderer,
    QgsLineSymbol,
    QgsMapLayer,
    QgsMarkerSymbol,
    QgsMeshDatasetIndex,
    QgsMeshLayer,
    QgsMeshRendererScalarSettings,
    QgsProperty,
    QgsRendererCategory,
    QgsRendererRange,
    QgsSimpleFillSymbolLayer,
    QgsSingleSymbolRenderer,
    QgsSymbolLayer,
    QgsUnitTypes,
    QgsVectorLayer,
)
from qgis.PyQt.QtGui import QColor, QPainter

from .files import is_geopackage

if TYPE_CHECKING:
    from .surface import Channel

STYLE = "geomesh"

# Lines and dots are shown if the distance between them on the screen is at least this (mm).
_EDGES_APART = 3.0
_NODES_APART = 6.0

# The colour is visible on dark and bright images, and the image is visible through it.
_EDGE = {"outline_color": "160,160,160,130", "outline_width": "0.1", "joinstyle": "round"}

# Colours that people with colour blindness can distinguish (Okabe and Ito).
_NODES = (
    ("feature", "feature node", "#e69f00"),
    ("refined", "refined node", "#009e73"),
    ("breakline", "breakline node", "#cc79a7"),
    ("border", "border node", "#56b4e9"),
)
_ANGLES = (
    (0, 10, "#440154"),
    (10, 20, "#3b528b"),
    (20, 30, "#21918c"),
    (30, 45, "#5ec962"),
    (45, 60, "#fde725"),
)
_EDGES = (
    (0, "inner edge", "#8c8c8c", "0.15"),
    (1, "outline", "#d55e00", "0.4"),
    (2, "breakline", "#cc79a7", "0.4"),
)

# An edge with a triangle on either side that has to be kept is a breakline.
_KIND_OF_EDGE = (
    'CASE WHEN NOT "constrained" THEN 0 WHEN "left" >= 0 AND "right" >= 0 THEN 2 ELSE 1 END'
)
_HAS_BREAKLINES = '"constrained" AND "left" >= 0 AND "right" >= 0'


def style_triangles(layer: QgsVectorLayer) -> None:
    """Fill each triangle with the mean colour of the image, and draw a thin edge."""
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
    # The first pass draws all fills. Their outlines hide the gaps that antialiasing leaves.
    edge.setRenderingPass(1)
    farthest = farthest_scale(layer, _EDGES_APART)
    if farthest is not None:
        near = QgsProperty.fromExpression(f"@map_scale < {farthest}")
        edge.setDataDefinedProperty(QgsSymbolLayer.Property.PropertyLayerEnabled, near)
    symbol.appendSymbolLayer(edge)
    renderer = QgsSingleSymbolRenderer(symbol)
    renderer.setUsingSymbolLevels(True)
    layer.setRenderer(renderer)


def farthest_scale(layer: QgsVectorLayer, apart: float) -> int | None:
    """Return the scale denominator at which elements are `apart` millimetres from each other.

    At smaller scales, lines and dots would cover the colours between them. The result is None
    for a layer without a CRS, because the scale of the map then has no meaning.
    """
    if not layer.crs().isValid():
        return None
    box = layer.extent()
    count = max(layer.featureCount(), 1)
    metres = QgsUnitTypes.fromUnitToUnitFactor(
        layer.crs().mapUnits(), QgsUnitTypes.DistanceUnit.DistanceMeters
    )
    spacing = math.sqrt(box.width() * box.height() / count) * metres
    return max(math.ceil(spacing * 1000 / apart), 1)


def style_nodes(layer: QgsVectorLayer) -> None:
    """Show nodes as small dots with a colour for each kind that there is."""
    kinds = layer.uniqueValues(layer.fields().indexOf("kind"))
    categories = []
    for value, label, color in _NODES:
        if value not in kinds:
            continue
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
    farthest = farthest_scale(layer, _NODES_APART)
    if farthest is not None:
        layer.setMinimumScale(farthest)
        layer.setScaleBasedVisibility(True)


def style_edges(layer: QgsVectorLayer) -> None:
    """Show edges as thin lines. Edges of the outline and of breaklines are thicker."""
    request = QgsFeatureRequest().setFilterExpression(_HAS_BREAKLINES).setLimit(1)
    has_breaklines = any(True for _ in layer.getFeatures(request))
    categories = []
    for value, label, color, width in _EDGES if has_breaklines else _EDGES[:2]:
        symbol = QgsLineSymbol.createSimple(
            {"line_color": color, "line_width": width, "capstyle": "round"}
        )
        categories.append(QgsRendererCategory(value, symbol, label))
    layer.setRenderer(QgsCategorizedSymbolRenderer(_KIND_OF_EDGE, categories))


def style_quality(layer: QgsVectorLayer) -> None:
    """Colour triangles by their smallest angle (viridis). Bad triangles are dark."""
    field = "map_min_angle" if layer.fields().indexOf("map_min_angle") >= 0 else "min_angle"
    ranges = []
    for low, high, color in _ANGLES:
        symbol = QgsFillSymbol.createSimple({"color": color, **_EDGE})
        ranges.append(QgsRendererRange(low, high, symbol, f"{low}° to {high}°"))
    layer.setRenderer(QgsGraduatedSymbolRenderer(field, ranges))


VECTOR_STYLES = {
    "triangles": style_triangles,
    "nodes": style_nodes,
    "edges": style_edges,
    "quality": style_quality,
}


def style_mesh_layer(layer: QgsMeshLayer) -> None:
    """Fill each face of a UGRID mesh with its own colour, without smoothing between faces."""
    group = find_group(layer, "color")
    if group is None:
        return
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
    show_group(layer, group, shader, smooth=False)


def show_group(
    layer: QgsMeshLayer, group: int, shader: QgsColorRampShader, *, smooth: bool = True
) -> None:
    """Show a quantity of a mesh layer, in the colours of a shader.

    Parameters
    ----------
    smooth : bool
        Whether values on faces are smoothed between faces.
    """
    settings = layer.rendererSettings()
    scalar = settings.scalarSettings(group)
    if not smooth:
        # The number is used because QGIS changed the name from None_ to NoResampling.
        scalar.setDataResamplingMethod(QgsMeshRendererScalarSettings.DataResamplingMethod(0))
    # Set the limits first. After the shader, QGIS 3.44 would use its colour ramp and crash.
    scalar.setClassificationMinimumMaximum(shader.minimumValue(), shader.maximumValue())
    scalar.setColorRampShader(shader)
    settings.setScalarSettings(group, scalar)
    settings.setActiveScalarDatasetGroup(group)
    layer.setRendererSettings(settings)


def style_surface(layer: QgsMeshLayer, channel: Channel, *, adds: bool) -> None:
    """Show one band of a linear surface smoothly, from black to the colour of its channel.

    Parameters
    ----------
    layer : QgsMeshLayer
    channel : Channel
    adds : bool
        Whether the light adds to that of the layers below, instead of hiding them.
    """
    group = find_group(layer, channel.band)
    if group is None:
        return
    low, high = channel.black, channel.full
    if low is None or high is None:
        about = layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0))
        low, high = about.minimum(), about.maximum()
    if not low < high:
        high = low + 1
    shader = QgsColorRampShader(low, high, None, QgsColorRampShader.Type.Interpolated)
    shader.setColorRampItemList(
        [
            QgsColorRampShader.ColorRampItem(value, QColor(color), f"{value:.6g}")
            for value, color in ((low, "#000000"), (high, channel.color))
        ]
    )
    show_group(layer, group, shader)
    if adds:
        layer.setBlendMode(QPainter.CompositionMode.CompositionMode_Plus)


def keep_style(layer: QgsMapLayer) -> None:
    """Save the style of a layer with its data."""
    if isinstance(layer, QgsVectorLayer) and is_geopackage(layer.source().partition("|")[0]):
        # In QGIS 3.44, saveStyleToDatabase causes a deprecation warning.
        save = getattr(layer, "saveStyleToDatabaseV2", layer.saveStyleToDatabase)
        save(STYLE, "By geomesh", True, "")
    else:
        layer.saveNamedStyle(layer.styleURI())


def find_group(layer: QgsMeshLayer, name: str) -> int | None:
    """Return the number of the quantity with this name in a mesh layer, if there is one."""
    for group in layer.datasetGroupsIndexes():
        if layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0)).name() == name:
            return group
    return None


def _distinct_values(layer: QgsMeshLayer, group: int) -> list[float]:
    block = layer.datasetValues(QgsMeshDatasetIndex(group, 0), 0, layer.dataProvider().faceCount())
    return sorted({block.value(index).scalar() for index in range(block.count())})


def _unpack(packed: int) -> QColor:
    """Return the colour from a number that geomesh wrote: 65536 red + 256 green + blue."""
    return QColor(packed >> 16 & 255, packed >> 8 & 255, packed & 255)
