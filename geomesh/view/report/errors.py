"""The errors of a mesh for its report: as recorded in it, or measured on its raster."""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import GeomeshError, GeoreferenceError
from geomesh.parallel.progress import part_of
from geomesh.surface.accuracy import measure_accuracy
from geomesh.surface.original import open_original
from geomesh.surface.stored import choose, find_surface

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.arrays.types import Floats
    from geomesh.mesh.refinement import BandAccuracy, Refinement
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.open import Source
    from geomesh.raster.scene import Scene
    from geomesh.surface.fit import Surface

# Relative difference of two root mean square errors that may be due to another machine.
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Errors:
    """How far the pixels are from the surface of a mesh.

    Parameters
    ----------
    bands : tuple of BandAccuracy
    pixels : int
        Number of valid pixels that were compared.
    greatest, rmse : float64 (B, T)
        Of the pixels of each triangle; NaN where it has none.
    measured : bool
        False: as the mesh records them.
    """

    bands: tuple[BandAccuracy, ...]
    pixels: int
    greatest: Floats
    rmse: Floats
    measured: bool


@dataclass(frozen=True, eq=False)
class Original:
    """The raster of a mesh, and the surface with which the mesh shows it.

    Parameters
    ----------
    scene : Scene
    surface : Surface
    errors : Errors
    given : bool
        Whether the user gave the raster. If not, it is the one that the mesh records.
    own_crs : bool
        False: the mesh was made with a CRS instead of the raster's own.
    """

    scene: Scene
    surface: Surface
    errors: Errors
    given: bool
    own_crs: bool


def recorded_errors(mesh: TriangleMesh) -> Errors | None:
    """Return the errors that a refined mesh records; None if it does not, or not all of them."""
    refinement = refinement_of(mesh)
    if refinement is None:
        return None
    table = mesh.triangle_table
    columns = [
        [f"{band.name}_{name}" for band in refinement.bands] for name in ("max_error", "rmse")
    ]
    if any(
        name not in table or table[name].dtype.kind not in "iuf" for row in columns for name in row
    ):
        return None
    greatest, rmse = (
        np.array([table[name].astype(np.float64) for name in row]).reshape(len(row), -1)
        for row in columns
    )
    return Errors(refinement.bands, refinement.pixels, greatest, rmse, measured=False)


@contextmanager
def opened_original(
    mesh: TriangleMesh, source: Source | None, workers: Workers, progress: Progress
) -> Iterator[Original | None]:
    """Open the raster of a mesh and measure its errors there; yield None if there is no raster.

    Parameters
    ----------
    mesh : TriangleMesh
    source : path, rasterio dataset, xarray.DataArray, or (array, transform, crs), optional
        Default: the file that the mesh records, if it exists and has the same pixels.
    workers : Workers
    progress : callable(fraction, message)

    Raises
    ------
    GeomeshError
        If a given raster cannot be read, or has other pixels.
    """
    if source is not None:
        scene, own_crs = _open(mesh, source)
        with scene.open():
            surface, errors = _measure(mesh, scene, workers, progress)
            yield Original(scene, surface, errors, given=True, own_crs=own_crs)
        return
    made = mesh.provenance
    if made is None or not _is_file(made.source.name):
        yield None
        return
    try:
        scene, own_crs = _open(mesh, made.source.name)
        with scene.open():
            surface, errors = _measure(mesh, scene, workers, progress)
    except GeomeshError:  # it is another raster now, or damaged: the report does without it
        yield None
        return
    if errors.pixels != made.pixels.counted or differs(mesh, errors):
        yield None
        return
    with scene.open():
        yield Original(scene, surface, errors, given=False, own_crs=own_crs)


def differs(mesh: TriangleMesh, errors: Errors) -> bool:
    """Return whether measured errors are not those that the mesh records."""
    refinement = refinement_of(mesh)
    if refinement is None:
        return False
    pairs = zip(errors.bands, refinement.bands, strict=True)
    return errors.pixels != refinement.pixels or not all(
        math.isclose(one.rmse, other.rmse, rel_tol=_TOLERANCE)
        and math.isclose(one.max_error, other.max_error, rel_tol=_TOLERANCE)
        for one, other in pairs
    )


def refinement_of(mesh: TriangleMesh) -> Refinement | None:
    """Return the record of the refinement of a mesh, if it has one."""
    return None if mesh.provenance is None else mesh.provenance.refinement


def _is_file(name: str) -> bool:
    try:
        return Path(name).is_file()
    except (OSError, ValueError):  # the name may be too long, or contain a zero byte
        return False


def _open(mesh: TriangleMesh, source: Source) -> tuple[Scene, bool]:
    """Return the part of the raster that the mesh covers, and whether their CRSs agree."""
    try:
        return open_original(mesh, source), True
    except GeoreferenceError:
        if mesh.grid.crs is None:
            raise
        return open_original(mesh, source, crs=mesh.grid.crs), False


def _measure(
    mesh: TriangleMesh, scene: Scene, workers: Workers, progress: Progress
) -> tuple[Surface, Errors]:
    model, fit = choose(mesh, None, None)
    share = 0.0 if fit == "stored" else 0.7
    surface = find_surface(
        mesh,
        scene,
        model=model,
        fit=fit,
        bidx=None,
        workers=workers,
        progress=part_of(progress, 0, share),
    )
    accuracy = measure_accuracy(
        *(surface.nodes, surface.triangles, surface.values, scene, workers),
        part_of(progress, share, 1),
        model=model,
    )
    return surface, Errors(
        accuracy.of_bands(),
        accuracy.pixels,
        accuracy.triangle_max_error,
        accuracy.triangle_rmse,
        measured=True,
    )
