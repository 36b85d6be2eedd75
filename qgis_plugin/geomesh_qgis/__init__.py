"""The QGIS plugin of geomesh: it converts rasters to triangle meshes.

This module imports QGIS only when QGIS loads the plugin. So the modules that do not need QGIS
can be used and tested without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from qgis.gui import QgisInterface

    from .plugin import GeomeshPlugin


def classFactory(iface: QgisInterface) -> GeomeshPlugin:
    """Return the plugin. QGIS calls this function."""
    from .plugin import GeomeshPlugin

    return GeomeshPlugin(iface)
