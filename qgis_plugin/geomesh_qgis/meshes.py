"""The mesh behind a layer: the GeoPackage that has all of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from qgis.core import QgsMeshLayer

from .files import is_geopackage, layer_files

if TYPE_CHECKING:
    from qgis.core import QgsMapLayer

# The property of a mesh layer that names the GeoPackage from which it was made.
_PROPERTY = "geomesh/mesh"

TIN = "TIN of "


def remember_mesh(layer: QgsMapLayer, path: str) -> None:
    """Note on a layer, and so in the project, which GeoPackage has its mesh."""
    layer.setCustomProperty(_PROPERTY, path)


def find_mesh(layer: QgsMapLayer | None) -> str:
    """Return the GeoPackage that a layer shows, or from which it was made; or an empty text."""
    for path in (*layer_files(layer), str(layer.customProperty(_PROPERTY, "")) if layer else ""):
        if is_geopackage(path) and Path(path).is_file():
            return path
    return ""


def find_mesh_fault(layer: QgsMapLayer | None) -> str:
    """Return why a layer shows no mesh of geomesh, or an empty text."""
    if layer is None or not layer.isValid():
        return "The mesh cannot be read: choose another one."
    if find_mesh(layer):
        return ""
    if isinstance(layer, QgsMeshLayer):
        return (
            f"There is no GeoPackage of {layer.name()}: choose the layer triangles of the same "
            "mesh, or make it again with DEM to TIN and keep its triangles and nodes."
        )
    return (
        f"{layer.name()} is not from a GeoPackage that geomesh has written: choose a layer of such "
        "a file."
    )


def name_of_mesh(layer: QgsMapLayer) -> str:
    """Return the name of a mesh, from the name of a layer that shows it."""
    name = layer.name()
    return name[len(TIN) :] if name.startswith(TIN) else name.rpartition(" · ")[2]
