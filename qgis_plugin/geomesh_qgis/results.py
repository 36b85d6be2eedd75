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
from .styling import VECTOR_STYLES, keep_style, style_mesh_layer, style_surface

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .surface import Channel

# The order in which geomesh writes the layers.
LAYERS = ("triangles", "edges", "nodes")

# The name that a GeoPackage gives to a missing CRS. QGIS reads it as a real CRS.
_UNDEFINED = "Undefined"

# The order in the legend, from bottom to top. A smooth surface is above the triangles, because
# it shows more than they do; faces with the colours of the triangles are below.
_ORDER = ("mesh", "triangles", "surface", "edges", "nodes")


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


def open_triangles(path: str) -> QgsVectorLayer:
    """Return the triangles of a mesh file as a layer."""
    return _open(layer_uri(path, "triangles"), "triangles")


def dress_mesh_layer(path: str, channels: Sequence[Channel] = ()) -> None:
    """Set the style of a UGRID file, and save it beside the file.

    If one layer is enough for a linear surface, the style shows the surface. Otherwise it shows
    the colours of the faces.
    """
    layer = _open(path, "mesh", is_mesh=True)
    if len(channels) == 1:
        style_surface(layer, channels[0], adds=False)
    else:
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
    channels: Sequence[Channel] = (),
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
    channels : sequence of Channel, optional
        Bands of the linear surface of "mesh", each of which becomes a mesh layer.
    """
    pending = context.layersToLoadOnCompletion()
    if output not in pending:
        return  # a model, or a program that only needs files
    asked = pending.pop(output)
    for rank, (kind, uri, channel) in enumerate(_in_order(uris, channels)):
        # QGIS before 3.32 adds results in the order of their ids, so that the last one is on top.
        # The id of a layer starts with its first name, so that name starts with the rank.
        layer = _open(uri, f"{rank}_{kind}", is_mesh=kind == "mesh")
        if channel is not None:
            style_surface(layer, channel, adds=channel is not channels[0])
        name = f"{kind} {channel.name}".strip() if channel is not None else kind
        # If the user chose the file, its name is part of the layer name.
        stem = Path(uri.partition("|")[0]).stem
        shown = f"{name} · {title if layer.isTemporary() else stem}"
        if kind == "triangles" and asked.name not in ("", unnamed):
            shown = asked.name  # chosen by the user or by a model
        layer.setName(shown)
        layer.setMetadata(as_metadata(layer, about))
        layer.setCustomProperty("geomesh/recipe", json.dumps(about.get("recipe", {})))
        output_name = asked.outputName if kind == "triangles" else kind.upper()
        details = QgsProcessingContext.LayerDetails(shown, asked.project, output_name)
        details.forceName = True
        if hasattr(details, "layerSortKey"):  # QGIS 3.32
            details.layerSortKey = rank
        pending[layer.id()] = details
        # Add layers, not file names: QGIS would load the files without their styles.
        context.temporaryLayerStore().addMapLayer(layer)
    context.setLayersToLoadOnCompletion(pending)


def _in_order(
    uris: Mapping[str, str], channels: Sequence[Channel]
) -> list[tuple[str, str, Channel | None]]:
    """Return kind, URI and channel of each layer, from bottom to top."""
    found: list[tuple[int, str, str, Channel | None]] = []
    for kind, uri in uris.items():
        if kind == "mesh" and channels:
            place = _ORDER.index("surface")
            found += [(place, kind, uri, channel) for channel in channels]
        else:
            found.append((_ORDER.index(kind), kind, uri, None))
    found.sort(key=lambda each: each[0])
    return [each[1:] for each in found]


def _open(uri: str, name: str, *, is_mesh: bool = False) -> QgsMapLayer:
    """Return a layer with the style that is saved with its data."""
    layer = QgsMeshLayer(uri, name, "mdal") if is_mesh else QgsVectorLayer(uri, name, "ogr")
    if not layer.isValid():
        raise QgsProcessingException(f"QGIS cannot read {uri}, although geomesh has written it.")
    if layer.crs().description().startswith(_UNDEFINED):
        layer.setCrs(QgsCoordinateReferenceSystem())
    layer.loadDefaultStyle()
    return layer
