"""Find out what a base is, and measure the volume between a mesh and it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import MeshFileError, OutputError
from geomesh.io.read import read_document, read_mesh
from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.raster.open import open_scene
from geomesh.terrain.volume import (
    Volume,
    volume_above_level,
    volume_above_mesh,
    volume_above_pixels,
)

if TYPE_CHECKING:
    from geomesh.parallel.progress import Progress


def measure_volume(mesh: TriangleMesh, base: Any, progress: Progress) -> Volume:
    """Return the volume between a mesh and a base.

    Parameters
    ----------
    mesh : TriangleMesh
        With heights.
    base : float, TriangleMesh, path-like, or raster, optional
        A level in the unit of the mesh's heights; a mesh, or the GeoPackage of one; or a raster
        with one band, of any kind that `geomesh.mesh_raster` takes. None: the lowest height of
        the mesh.
    progress : callable(fraction, message)

    Raises
    ------
    GeomeshError
        If the mesh or the base has no heights, or they are in different CRSs.
    """
    if mesh.heights is None:
        raise OutputError("the mesh has no heights: choose the band of heights with `z`")
    if base is None:
        base = lowest(mesh)
    if isinstance(base, int | float | np.number):
        return volume_above_level(mesh, float(base))
    if isinstance(base, str | Path) and _is_mesh(base):
        base = read_mesh(base)
    if isinstance(base, TriangleMesh):
        return volume_above_mesh(mesh, base.with_height(), progress)
    return volume_above_pixels(mesh, open_scene(base), progress)


def lowest(mesh: TriangleMesh) -> float:
    """Return the lowest height of a mesh."""
    known = mesh.heights[np.isfinite(mesh.heights)] if mesh.heights is not None else np.empty(0)
    if not len(known):
        raise OutputError("no node of the mesh has a height")
    return float(known.min())


def _is_mesh(path: str | Path) -> bool:
    """Return whether a file is a mesh of geomesh. Another GeoPackage may hold a raster."""
    if Path(path).suffix.lower() != ".gpkg":
        return False
    try:
        read_document(path)
    except MeshFileError:
        return False
    return True
