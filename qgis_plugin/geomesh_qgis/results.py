"""Add results to the project as layers, with names, styles and how they were made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsMapLayer,
    QgsMeshLayer,
    QgsProcessingContext,
    QgsProcessingException,
    QgsVectorLayer,
)

from .files import is_geopackage
from .provenance import as_metadata
from .styling import VECTOR_STYLES, keep_style, style_mesh_layer

if TYPE_CHECKING:
    from collections.abc import Mapping

# The order in which geomesh writes the layers.
LAYERS = ("triangles", "edges", "nodes")

# The name that a GeoPackage gives to a missing CRS. QGIS reads it as a real CRS.
_UNDEFINED = "Undefined"

# The order in the legend, from bottom to top.
_ORDER = ("mesh", "triangles", "edges", "nodes")


def layer_uri(path: str, name: str) -> str:
    """Return the URI of a layer of a mesh file."""
    if not is_geopackage(path):
        return path
    return f"{path}|layername={name}"


def dress_vector_layer(uri: str, style: str) -> None:
    """Set one of `VECTOR_STYLES` for a layer of a mesh, and save it with the data."""
    layer = _open(uri, style)
    VECTOR_STYLES[style](layer)
    keep_style(layer)


def dress_mesh_layer(path: str) -> None:
    """Set the style of a UGRID file, and save it beside the file."""
    layer = _open(path, "mesh", is_mesh=True)
    style_mesh_layer(layer)
    keep_style(layer)


def load_when_done(
    context: QgsProcessingContext,
    output: str,
    uris: Mapping[str, str],
    *,
    title: str,
    unnamed: str,
    about: dict[str, Any],
) -> None:
    """Let QGIS load layers, if it was going to load the output of the algorithm.

    Parameters
    ----------
    context : QgsProcessingContext
    output : str
        File that the algorithm reported to QGIS as its output.
    uris : mapping of str to str
        URIs of layers. The keys are "triangles", "edges", "nodes" or "mesh".
    title : str
        End of the layer names, if the output is temporary.
    unnamed : str
        Default name of the output, used if the user did not choose one.
    about : dict
        Document about how the mesh was made.
    """
    pending = context.layersToLoadOnCompletion()
    if output not in pending:
        return  # a model, or a program that only needs files
    asked = pending.pop(output)
    for name, uri in uris.items():
        rank = _ORDER.index(name)
        # QGIS before 3.32 adds results in the order of their ids, so that the last one is on top.
        # The id of a layer starts with its first name, so that name starts with the rank.
        layer = _open(uri, f"{rank}_{name}", is_mesh=name == "mesh")
        # If the user chose the output file, its name is part of the layer name.
        shown = f"{name} · {title if layer.isTemporary() else Path(output).stem}"
        if name == "triangles" and asked.name not in ("", unnamed):
            shown = asked.name  # chosen by the user or by a model
        layer.setName(shown)
        layer.setMetadata(as_metadata(layer, about))
        layer.setCustomProperty("geomesh/recipe", json.dumps(about.get("recipe", {})))
        output_name = asked.outputName if name == "triangles" else name.upper()
        details = QgsProcessingContext.LayerDetails(shown, asked.project, output_name)
        details.forceName = True
        if hasattr(details, "layerSortKey"):  # QGIS 3.32
            details.layerSortKey = rank
        pending[layer.id()] = details
        # Add layers, not file names: QGIS would load the files without their styles.
        context.temporaryLayerStore().addMapLayer(layer)
    context.setLayersToLoadOnCompletion(pending)


def _open(uri: str, name: str, *, is_mesh: bool = False) -> QgsMapLayer:
    """Return a layer with the style that is saved with its data."""
    layer = QgsMeshLayer(uri, name, "mdal") if is_mesh else QgsVectorLayer(uri, name, "ogr")
    if not layer.isValid():
        raise QgsProcessingException(f"QGIS cannot read {uri}, although geomesh has written it.")
    if layer.crs().description().startswith(_UNDEFINED):
        layer.setCrs(QgsCoordinateReferenceSystem())
    layer.loadDefaultStyle()
    return layer
