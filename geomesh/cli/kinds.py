"""What a file is: a mesh or a raster."""

from __future__ import annotations

from pathlib import Path


def is_mesh(path: str) -> bool:
    """Return whether a file is a GeoPackage of layers. One may contain a raster instead."""
    if Path(path).suffix.lower() != ".gpkg":
        return False
    import pyogrio
    from pyogrio.errors import DataSourceError

    try:
        return len(pyogrio.list_layers(path)) > 0
    except DataSourceError:
        return not Path(path).exists()  # an existing file may be a raster
