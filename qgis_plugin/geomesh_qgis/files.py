"""The files of layers: find them, and prevent that an output overwrites a file in use."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from qgis.core import QgsMapLayer, QgsProject, QgsProviderRegistry

if TYPE_CHECKING:
    from collections.abc import Iterable

_SUFFIXES = (".gpkg", ".geojson", ".fgb")

# A file name inside a data source of a GDAL driver, such as NETCDF:"file.nc":band.
_INSIDE = re.compile(r'[A-Za-z0-9_]{2,}:(?:"([^"]+)"|(.+?))(?::[^:]*)?')


def is_geopackage(path: str) -> bool:
    """Return whether a file can contain all layers of a mesh."""
    return path.lower().endswith(".gpkg")


def layer_files(layer: QgsMapLayer | None) -> list[str]:
    """Return the possible files of a layer."""
    if layer is None:
        return []
    parts = QgsProviderRegistry.instance().decodeUri(layer.providerType(), layer.source())
    path = str(parts.get("path") or layer.source().partition("|")[0])
    match = _INSIDE.fullmatch(path)
    return [path, match[1] or match[2]] if match else [path]


def is_same_file(one: str, other: str) -> bool:
    """Return whether two paths are the same file. The file need not exist."""
    if not one or not other:
        return False
    try:
        return Path(one).samefile(other)
    except (OSError, ValueError):
        return _canonical(one) == _canonical(other)


def find_output_fault(path: str, project: QgsProject | None, read: Iterable[str]) -> str:
    """Return why a file cannot be written, or an empty text.

    Parameters
    ----------
    path : str
    project : QgsProject or None
        Project whose layers must not use the file.
    read : iterable of str
        Files that the same run reads.
    """
    if "|" in path:
        return (
            f"{path} has a | in its name, which QGIS takes for the end of the name: choose "
            "another name."
        )
    if not Path(path).absolute().parent.is_dir():
        return f"The folder of {path} does not exist: create it first."
    if any(is_same_file(path, other) for other in read):
        return f"{path} is an input of the same run: choose another file."
    for layer in project.mapLayers().values() if project else ():
        if any(is_same_file(path, shown) for shown in layer_files(layer)):
            return (
                f"{path} is open as layer {layer.name()!r}: remove that layer, "
                "or choose another file."
            )
    return ""


def find_format_fault(path: str) -> str:
    """Return why a mesh cannot be written in the format of a file, or an empty text."""
    if Path(path).suffix.lower() in _SUFFIXES:
        return ""
    return f"{path} has no extension that geomesh knows: choose one of {', '.join(_SUFFIXES)}."


def _canonical(path: str) -> str:
    return os.path.normcase(os.path.realpath(path))
