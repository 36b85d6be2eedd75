"""Results as layers of the project: named, styled, and saying how they were made."""

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

# The order in which geomesh writes them.
LAYERS = ("triangles", "edges", "nodes")

# What a GeoPackage calls the CRS of a layer without one; QGIS takes it for one.
_UNDEFINED = "Undefined"

# From the bottom to the top of the legend.
_ORDER = ("mesh", "triangles", "edges", "nodes")


def layer_uri(path: str, name: str) -> str:
    """Return the URI of a layer of a mesh file."""
    if not is_geopackage(path):
        return path
    return f"{path}|layername={name}"


def dress_vector_layer(uri: str, style: str) -> None:
    """Give a layer of a mesh one of `VECTOR_STYLES`, kept with the data."""
    layer = _open(uri, style)
    VECTOR_STYLES[style](layer)
    keep_style(layer)


def dress_mesh_layer(path: str) -> None:
    """Give a UGRID file its style, kept beside it."""
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
    """Have QGIS load layers, if it is going to load the output of the algorithm.

    Parameters
    ----------
    context : QgsProcessingContext
    output : str
        The file that QGIS has been told of as the algorithm's output.
    uris : mapping of str to str
        URIs of layers, by "triangles", "edges", "nodes" or "mesh".
    title : str
        What the names of the layers end with, if the output is temporary.
    unnamed : str
        What the output is called where nobody has named it.
    about : dict
        The document of the mesh.
    """
    pending = context.layersToLoadOnCompletion()
    if output not in pending:
        return  # run by a model, or by a program that wants files
    asked = pending.pop(output)
    for name, uri in uris.items():
        rank = _ORDER.index(name)
        # Its id begins with its first name: QGIS before 3.32 adds results in the order of their
        # ids, the last on top.
        layer = _open(uri, f"{rank}_{name}", is_mesh=name == "mesh")
        # A file that the user has named is known by that name.
        shown = f"{name} · {title if layer.isTemporary() else Path(output).stem}"
        if name == "triangles" and asked.name not in ("", unnamed):
            shown = asked.name  # the user's, or a model's
        layer.setName(shown)
        layer.setMetadata(as_metadata(layer, about))
        layer.setCustomProperty("geomesh/recipe", json.dumps(about.get("recipe", {})))
        output_name = asked.outputName if name == "triangles" else name.upper()
        details = QgsProcessingContext.LayerDetails(shown, asked.project, output_name)
        details.forceName = True
        if hasattr(details, "layerSortKey"):  # QGIS 3.32
            details.layerSortKey = rank
        pending[layer.id()] = details
        # Whole layers rather than names of files, which QGIS would load without their styles.
        context.temporaryLayerStore().addMapLayer(layer)
    context.setLayersToLoadOnCompletion(pending)


def _open(uri: str, name: str, *, is_mesh: bool = False) -> QgsMapLayer:
    """Return a layer with the style that is kept with its data."""
    layer = QgsMeshLayer(uri, name, "mdal") if is_mesh else QgsVectorLayer(uri, name, "ogr")
    if not layer.isValid():
        raise QgsProcessingException(f"QGIS cannot read {uri}, although geomesh has written it.")
    if layer.crs().description().startswith(_UNDEFINED):
        layer.setCrs(QgsCoordinateReferenceSystem())
    layer.loadDefaultStyle()
    return layer
