"""The worst triangles of a mesh: those with the smallest angles, and with the largest errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import GeoreferenceError
from geomesh.formats.lonlat import crs_on_earth, lonlat_of
from geomesh.view.report.content import WorstList, WorstTriangle
from geomesh.view.report.errors import refinement_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from geomesh.arrays.types import Floats, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.view.report.content import Worse
    from geomesh.view.report.errors import Errors

# Triangles in each list.
MOST = 5


def worst_triangles(
    mesh: TriangleMesh, angles: Floats, errors: Errors | None
) -> Iterator[WorstList]:
    """Yield the lists of the worst triangles of a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
    angles : float64 (T,)
        Smallest angle of each triangle, in degrees.
    errors : Errors, optional
        Without them, there is no list of the largest errors.
    """
    order = _first(angles)
    values = [f"{angles[t]:.4f}°" for t in order]
    yield _listed(mesh, "angle", "The smallest angles", "smallest angle", order, values)
    if errors is None or not len(errors.bands):
        return
    shares = errors.greatest / _yardsticks(mesh, errors)[:, None]
    known = ~np.isnan(shares).all(axis=0)
    highest = np.full(shares.shape[1], np.nan)
    highest[known] = np.nanmax(shares[:, known], axis=0)
    order = _first(-highest)
    bands = [int(np.nanargmax(shares[:, t])) for t in order]
    several = len(errors.bands) > 1
    values = [
        f"{errors.greatest[k, t]:.6g}" + (f" in band {errors.bands[k].name}" if several else "")
        for k, t in zip(bands, order, strict=True)
    ]
    title = "The largest errors" + (", compared with the range of each band" if several else "")
    yield _listed(mesh, "error", title, "greatest error", order, values)


def _first(values: Floats) -> list[int]:
    """Return the triangles with the smallest values; of equal ones, those with the lowest ids."""
    finite = np.flatnonzero(~np.isnan(values))
    if len(finite) > MOST:
        limit = np.partition(values[finite], MOST - 1)[MOST - 1]
        finite = finite[values[finite] <= limit]
    ordered: list[int] = finite[np.argsort(values[finite], kind="stable")][:MOST].tolist()
    return ordered


def _yardsticks(mesh: TriangleMesh, errors: Errors) -> Floats:
    """Return by what the errors of each band are divided, to compare those of several bands."""
    refinement = refinement_of(mesh)
    if refinement is not None and refinement.goal == "max_error":
        sizes = np.array(refinement.limits)
    else:
        sizes = np.array([band.peak for band in errors.bands])
    return np.where((sizes > 0) & np.isfinite(sizes), sizes, 1.0)


def _listed(
    mesh: TriangleMesh,
    by: Worse,
    title: str,
    column: str,
    order: Sequence[int],
    values: Sequence[str],
) -> WorstList:
    letter = by[0].upper()
    places = mesh.map_nodes[mesh.triangles[list(order)]].mean(axis=1).reshape(-1, 2)
    lonlat = _lonlat(mesh, places)
    rows = zip(order, places.tolist(), lonlat, values, strict=True)
    return WorstList(
        by,
        title,
        column,
        tuple(
            WorstTriangle(f"{letter}{k}", t, (x, y), degrees, value)
            for k, (t, (x, y), degrees, value) in enumerate(rows, 1)
        ),
    )


def _lonlat(mesh: TriangleMesh, places: Points) -> list[tuple[float, float] | None]:
    try:
        found = lonlat_of(crs_on_earth(mesh))(places)
    except GeoreferenceError:
        return [None] * len(places)
    return [(lon, lat) if np.isfinite([lon, lat]).all() else None for lon, lat in found.tolist()]
