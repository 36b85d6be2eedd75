"""Histograms of the triangles of a mesh: angles, areas, errors and Ki."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.view.report.content import Histogram
from geomesh.view.report.errors import refinement_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.arrays.types import Floats
    from geomesh.mesh.quality import Quality
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.view.report.errors import Errors

# Number of bins; of angles, whose range is known, degrees in each.
_BINS = 32
_DEGREES = 2.0

# Areas that differ by more than this factor are shown on a logarithmic axis.
_WIDE = 30.0

# Bands with a histogram of their own.
MOST_BANDS = 3


def histograms(mesh: TriangleMesh, quality: Quality, errors: Errors | None) -> Iterator[Histogram]:
    """Yield the histograms of a mesh."""
    refinement = refinement_of(mesh)
    angles = np.arange(0, 60 + _DEGREES, _DEGREES)
    floor = None
    if refinement is not None and refinement.min_angle_floor > 0:
        floor = (refinement.min_angle_floor, "allowed")
    yield count("Smallest angle", "degrees", quality.table["min_angle"], edges=angles, limit=floor)
    unit = "square pixels" if mesh.grid.crs is None else "m²"
    yield count("Area", unit, mesh.grid.areas(mesh.nodes, mesh.triangles), wide=True)
    yield count("Ki", "pixels", quality.table["ki"], wide=True)
    if errors is None:
        return
    bounded = refinement is not None and refinement.goal == "max_error"
    units = (
        {} if mesh.provenance is None else {b.name: b.unit for b in mesh.provenance.source.bands}
    )
    for k, band in enumerate(errors.bands[:MOST_BANDS]):
        limit = None
        if bounded and refinement is not None:
            limit = (refinement.limits[k], "bound")
        values = (errors.greatest if bounded else errors.rmse)[k]
        kind = "Greatest error" if bounded else "Root mean square error"
        of = f", band {band.name}" if len(errors.bands) > 1 else ""
        yield count(f"{kind}{of}", units.get(band.name, ""), values, limit=limit, least=0.0)


def count(
    title: str,
    unit: str,
    values: Floats,
    *,
    edges: Floats | None = None,
    wide: bool = False,
    least: float | None = None,
    limit: tuple[float, str] | None = None,
) -> Histogram:
    """Return the histogram of some values, of which those that are not finite are left out.

    Parameters
    ----------
    title, unit : str
    values : float64 (T,)
    edges : float64, optional
        Limits of the bins. Default: from the least value to the greatest.
    wide : bool
        Use a logarithmic axis if the values differ by a large factor.
    least : float, optional
        Where the first bin begins.
    limit : (float, str), optional
    """
    finite = values[np.isfinite(values)]
    left_out = len(values) - len(finite)
    logarithmic = False
    if edges is None:
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        low = low if least is None else min(least, low)
        if limit is not None and math.isfinite(limit[0]):
            high = max(high, limit[0])
        logarithmic = wide and low > 0 and high / low > _WIDE
        edges = np.geomspace(low, high, _BINS + 1) if logarithmic else _even(low, high)
    counts, _ = np.histogram(finite, edges)
    median = float(np.median(finite)) if len(finite) else math.nan
    return Histogram(
        title,
        unit,
        tuple(edges.tolist()),
        tuple(counts.tolist()),
        median,
        left_out,
        logarithmic,
        limit,
    )


def _even(low: float, high: float) -> Floats:
    """Return limits of bins of equal width; of one value, around it."""
    edges = np.linspace(low, high, _BINS + 1)
    if (np.diff(edges) > 1e-9 * max(abs(low), abs(high))).all() and high > low:
        return edges
    around = max(abs(low), 1.0) / 2
    return np.linspace(low - around, low + around, _BINS + 1)
