"""Verify a refined mesh: measure its errors again, and compare them with the recorded ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import CertificateError, MeshFileError
from geomesh.mesh.refinement import BandAccuracy, surface_values
from geomesh.parallel.progress import Progress, reporting
from geomesh.parallel.workers import open_workers
from geomesh.surface.accuracy import Accuracy, measure_accuracy
from geomesh.surface.original import open_original

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.mesh.refinement import Refinement
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import Alpha
    from geomesh.raster.open import Source

# Relative difference of two root mean square errors that may be due to another machine.
_TOLERANCE = 1e-9


def verify(
    mesh: TriangleMesh,
    source: Source,
    *,
    alpha: Alpha | None = None,
    crs: Any = None,
    workers: int | None = None,
    progress: bool | Progress = False,
) -> Accuracy:
    """Return the errors of a refined mesh, measured again with the values in its columns.

    Parameters
    ----------
    mesh : TriangleMesh
        A refined mesh, such as one that was read from a file.
    source, alpha, crs, workers, progress
        As in `geomesh.surface.fidelity.measure_fidelity`.

    Raises
    ------
    CertificateError
        If an error, of all pixels or of a triangle, is not the one that the mesh records.
    GeomeshError
        If the mesh was not refined, or the raster cannot be read or has other pixels.
    """
    refinement = None if mesh.provenance is None else mesh.provenance.refinement
    if refinement is None:
        raise MeshFileError(
            "the mesh was not refined, so it records no errors; measure how well it shows the "
            "raster with `geomesh render`"
        )
    names = [band.name for band in refinement.bands]
    table = mesh.node_table if refinement.model == "linear" else mesh.triangle_table
    values = surface_values(table, names, refinement.model)
    scene = open_original(mesh, source, alpha=alpha, crs=crs)
    with reporting(progress) as report, open_workers(workers) as pool, scene.open():
        found = measure_accuracy(
            *(mesh.nodes, mesh.triangles, values, scene, pool, report), model=refinement.model
        )
    differing = list(_differences(found, refinement, mesh))
    if differing:
        raise CertificateError(
            f"the mesh does not show {scene.name} as it records: {'; '.join(differing)}; use the "
            "raster from which the mesh was made, or make the mesh again"
        )
    return found


def _differences(found: Accuracy, refinement: Refinement, mesh: TriangleMesh) -> Iterator[str]:
    if found.pixels != refinement.pixels:
        yield f"{found.pixels} valid pixels, recorded {refinement.pixels}"
    triangles = mesh.triangle_table
    for k, (own, recorded) in enumerate(zip(found.of_bands(), refinement.bands, strict=True)):
        if not _agree(own, recorded):
            yield (
                f"{recorded.name}: greatest error {own.max_error:.6g} and rmse {own.rmse:.6g}, "
                f"recorded {recorded.max_error:.6g} and {recorded.rmse:.6g}"
            )
        for name, values in (
            ("max_error", found.triangle_max_error[k]),
            ("rmse", found.triangle_rmse[k]),
        ):
            stored = triangles[f"{recorded.name}_{name}"]
            same = np.isclose(stored, values, rtol=_TOLERANCE, atol=0.0, equal_nan=True)
            if not same.all():
                yield f"{recorded.name}_{name} of {np.count_nonzero(~same)} triangles"


def _agree(found: BandAccuracy, recorded: BandAccuracy) -> bool:
    pairs = ((getattr(found, n), getattr(recorded, n)) for n in ("max_error", "rmse", "peak"))
    return all(math.isclose(one, other, rel_tol=_TOLERANCE) for one, other in pairs)
