"""geomesh: from a georeferenced raster to a certified triangle mesh.

>>> import geomesh
>>> mesh = geomesh.mesh_raster("scene.tif")  # doctest: +SKIP
>>> mesh.to_file("mesh.gpkg")  # doctest: +SKIP
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from geomesh._version import __version__

if TYPE_CHECKING:
    from geomesh.errors import GeomeshError, GeomeshWarning
    from geomesh.io.read import read_mesh
    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.quality import Quality
    from geomesh.mesh.triangle_mesh import Mesh
    from geomesh.pipeline.mesh_scene import mesh_raster
    from geomesh.raster.grid import Grid
    from geomesh.recipe import Recipe
    from geomesh.surface.fidelity import Fidelity

__all__ = [
    "Certificate",
    "Fidelity",
    "GeomeshError",
    "GeomeshWarning",
    "Grid",
    "Mesh",
    "Quality",
    "Recipe",
    "__version__",
    "mesh_raster",
    "read_mesh",
]

# OpenCV, GDAL and numba take a second to import: each name loads its module when
# it is first used, so that `geomesh --help` and `import geomesh` answer at once.
_HOMES = {
    "Certificate": "mesh.certificate",
    "Fidelity": "surface.fidelity",
    "GeomeshError": "errors",
    "GeomeshWarning": "errors",
    "Grid": "raster.grid",
    "Mesh": "mesh.triangle_mesh",
    "Quality": "mesh.quality",
    "Recipe": "recipe",
    "mesh_raster": "pipeline.mesh_scene",
    "read_mesh": "io.read",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'geomesh' has no attribute {name!r}")
    return getattr(importlib.import_module(f"geomesh.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
