"""Results as layers of the project: named, styled, and saying how they were made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from qgis.core import (
    QgsLayerTree,
    QgsMapLayer,
    QgsMeshLayer,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingLayerPostProcessorInterface,
    QgsProcessingUtils,
    QgsProject,
    QgsVectorLayer,
)

from .provenance import as_metadata
from .styling import VECTOR_STYLES, keep_style, style_mesh_layer

# The order in which geomesh writes them.
LAYERS = ("triangles", "edges", "nodes")

_SUFFIXES = (".gpkg", ".geojson", ".fgb")

# From the bottom to the top of the legend.
_ORDER = ("mesh", "triangles", "edges", "nodes")

_MESH_LAYER = QgsProcessingUtils.LayerHint.Mesh
_VECTOR_LAYER = QgsProcessingUtils.LayerHint.Vector

# QGIS keeps no reference to post-processors: Python would delete them before their time.
_waiting: list[QgsProcessingLayerPostProcessorInterface] = []


def is_geopackage(path: str) -> bool:
    """Tell whether a file can hold all layers of a mesh."""
    return path.lower().endswith(".gpkg")


def layer_uri(path: str, name: str) -> str:
    """Return the URI of a layer of a mesh file."""
    if not is_geopackage(path):
        return path
    return f"{path}|layername={name}"


def dress_vector_layer(uri: str, name: str) -> None:
    """Give a layer of a mesh its style, kept with the data."""
    layer = QgsVectorLayer(uri, name, "ogr")
    if not layer.isValid():
        raise QgsProcessingException(f"QGIS cannot read {uri}, though geomesh has written it")
    VECTOR_STYLES[name](layer)
    keep_style(layer)


def dress_mesh_layer(path: str) -> None:
    """Give a UGRID file its style, kept beside it."""
    layer = QgsMeshLayer(path, "mesh", "mdal")
    if not layer.isValid():
        raise QgsProcessingException(f"QGIS cannot read {path}, though geomesh has written it")
    style_mesh_layer(layer)
    keep_style(layer)


def find_output_fault(path: str, project: QgsProject | None) -> str:
    """Return why a mesh cannot be written to a file, or an empty text."""
    if Path(path).suffix.lower() not in _SUFFIXES:
        return f"{path} has no extension that geomesh knows: choose {', '.join(_SUFFIXES)}."
    return find_use(path, project)


def find_use(path: str, project: QgsProject | None) -> str:
    """Return which layer shows a file that is to be replaced, or an empty text."""
    for layer in project.mapLayers().values() if project else ():
        shown = layer.source().partition("|")[0]
        if shown and Path(shown) == Path(path):
            return (
                f"{path} is open as layer {layer.name()!r}: remove that layer, "
                "or choose another file."
            )
    return ""


def load_when_done(
    context: QgsProcessingContext,
    output: str,
    uris: Mapping[str, str],
    *,
    title: str,
    unnamed: str,
    about: dict,
) -> None:
    """Have QGIS load layers, if it is going to load the output of the algorithm.

    Parameters
    ----------
    context : QgsProcessingContext
    output : str
        The file that QGIS has been told of as the algorithm's output.
    uris : mapping of str to str
        URIs of layers, by "triangles", "edges", "nodes" or "mesh".
    title : str
        What the names of the layers begin with.
    unnamed : str
        What the output is called where nobody has named it.
    about : dict
        The document of the mesh.
    """
    pending = context.layersToLoadOnCompletion()
    if output not in pending:
        return  # run by a model, or by a program that wants files
    asked = pending.pop(output)
    loaded: dict[str, int] = {}
    for name, uri in uris.items():
        hint = _MESH_LAYER if name == "mesh" else _VECTOR_LAYER
        shown = f"{title} {name}"
        if name == "triangles" and asked.name not in ("", unnamed):
            shown = asked.name  # the user's, or a model's
        output_name = asked.outputName if name == "triangles" else name.upper()
        details = QgsProcessingContext.LayerDetails(shown, asked.project, output_name, hint)
        if hasattr(details, "layerSortKey"):  # QGIS 3.32
            details.layerSortKey = _ORDER.index(name)
        dresser = _Dresser(about, _ORDER.index(name), loaded)
        _waiting.append(dresser)
        details.setPostProcessor(dresser)
        pending[uri] = details
    context.setLayersToLoadOnCompletion(pending)


class _Dresser(QgsProcessingLayerPostProcessorInterface):
    """Gives a layer that was loaded its style, and tells in its properties how it was made."""

    def __init__(self, document: dict, rank: int, loaded: dict[str, int]) -> None:
        super().__init__()
        self._document = document
        self._rank = rank
        self._loaded = loaded  # ranks of the layers of one run, by their ids

    def postProcessLayer(
        self,
        layer: QgsMapLayer,
        context: QgsProcessingContext,
        feedback: QgsProcessingFeedback,
    ) -> None:
        layer.loadDefaultStyle()  # Processing does not
        layer.setMetadata(as_metadata(layer, self._document))
        recipe = self._document.get("recipe", {})
        layer.setCustomProperty("geomesh/recipe", json.dumps(recipe))
        self._loaded[layer.id()] = self._rank
        if context.project() is not None:
            _arrange(context.project().layerTreeRoot(), self._loaded)
        if self in _waiting:
            _waiting.remove(self)


def _arrange(root: QgsLayerTree, ranks: Mapping[str, int]) -> None:
    """Put layers into the order of their ranks, the highest on top, in the places they have.

    QGIS before 3.32 adds results in the order of their files' names.
    """
    nodes = [node for node in root.findLayers() if node.layerId() in ranks]
    parent = nodes[0].parent() if nodes else None
    ordered = sorted(nodes, key=lambda node: -ranks[node.layerId()])
    if ordered == nodes or any(node.parent() != parent for node in nodes):
        return
    place = min(parent.children().index(node) for node in nodes)
    # Copies first: a layer whose last node goes is taken out of the project.
    for node in reversed(ordered):
        parent.insertChildNode(place, node.clone())
    for node in nodes:
        parent.removeChildNode(node)
