"""geomesh in QGIS: rasters to triangle meshes.

QGIS is imported only when it loads the plugin, so that what needs no QGIS can be used,
and tested, without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from qgis.gui import QgisInterface

    from .plugin import GeomeshPlugin


def classFactory(iface: QgisInterface) -> GeomeshPlugin:
    """Return the plugin: what QGIS calls."""
    from .plugin import GeomeshPlugin

    return GeomeshPlugin(iface)
