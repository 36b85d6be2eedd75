"""Add results to the project as layers, with names, styles and how they were made."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsMapLayer,
    QgsMeshLayer,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProject,
    QgsVectorLayer,
)

from .files import is_geopackage
from .provenance import as_metadata
from .styling import VECTOR_STYLES, keep_style, style_mesh_layer, style_surface
from .terrain_styling import style_contours, style_heights

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .surface import Channel

# The order in which geomesh writes the layers.
LAYERS = ("triangles", "edges", "nodes")

_STYLES = {**VECTOR_STYLES, "contours": style_contours}

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
    """Set the style with this name for a layer of a mesh, and save it with the data."""
    layer = _open(uri, style)
    _STYLES[style](layer)
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


def dress_tin(path: str) -> None:
    """Colour a UGRID file by its heights, and save the style beside the file."""
    layer = _open(path, "TIN", is_mesh=True)
    style_heights(layer)
    keep_style(layer)


@dataclass(frozen=True)
class NewLayer:
    """A result that is to become a layer of the project.

    Parameters
    ----------
    uri : str
    kind : str
        What it shows. It begins the name of the layer, and of its output if there is no other.
    title : str
        End of the layer name, if the file is temporary; otherwise the name of the file.
    name : str
        The whole name of the layer, instead of `kind` and `title`.
    output : str
        Name of the output of the algorithm.
    is_mesh : bool
        Whether it is a mesh layer.
    dress : callable(layer), optional
        Changes the style that is saved with the data.
    """

    uri: str
    kind: str
    title: str = ""
    name: str = ""
    output: str = ""
    is_mesh: bool = False
    dress: Callable[[Any], None] | None = None


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
    asked = take_request(context, output)
    if asked is None:
        return
    new = []
    for kind, uri, channel in _in_order(uris, channels):
        is_main = kind == "triangles"
        shown, dress = kind, None
        if channel is not None:
            shown = f"{kind} {channel.name}".strip()
            dress = partial(style_surface, channel=channel, adds=channel is not channels[0])
        new.append(
            NewLayer(
                uri,
                shown,
                title,
                chosen_name(asked, unnamed) if is_main else "",
                asked.outputName if is_main else kind.upper(),
                kind == "mesh",
                dress,
            )
        )
    load_layers(context, new, about, asked.project)


def take_request(
    context: QgsProcessingContext, output: str
) -> QgsProcessingContext.LayerDetails | None:
    """Return how QGIS was going to load an output, which it then does not load by itself.

    None if it was not going to: for a model, or a program that only needs files.
    """
    pending = context.layersToLoadOnCompletion()
    asked = pending.pop(output, None)
    context.setLayersToLoadOnCompletion(pending)
    return asked


def chosen_name(asked: QgsProcessingContext.LayerDetails, unnamed: str) -> str:
    """Return the name that the user or a model chose for a layer, or an empty text."""
    return "" if asked.name == unnamed else asked.name


def load_layers(
    context: QgsProcessingContext,
    new: Sequence[NewLayer],
    about: dict[str, Any] | None,
    project: QgsProject,
) -> None:
    """Let QGIS load layers when the algorithm has ended.

    Parameters
    ----------
    context : QgsProcessingContext
    new : sequence of NewLayer
        From the bottom of the legend to its top.
    about : dict or None
        Document about how the mesh was made, shown in the properties of the layers.
    project : QgsProject
    """
    pending = context.layersToLoadOnCompletion()
    for rank, each in enumerate(new):
        # QGIS before 3.32 adds results in the order of their ids, so that the last one is on top.
        # The id of a layer starts with its first name, so that name starts with the rank.
        layer = _open(each.uri, f"{rank}_{each.kind}", is_mesh=each.is_mesh)
        if each.dress is not None:
            each.dress(layer)
        # If the user chose the file, its name is part of the layer name.
        stem = Path(each.uri.partition("|")[0]).stem
        end = each.title if layer.isTemporary() else stem
        shown = each.name or f"{each.kind} · {end}"
        layer.setName(shown)
        if about is not None:
            layer.setMetadata(as_metadata(layer, about))
            layer.setCustomProperty("geomesh/recipe", json.dumps(about.get("recipe", {})))
        details = QgsProcessingContext.LayerDetails(shown, project, each.output)
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
