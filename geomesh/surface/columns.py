"""Columns of the attribute tables of a refined mesh: the surface, and its errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh.parameters import DEFAULT_STATISTICS
from geomesh.zonal.columns import statistics_of
from geomesh.zonal.columns import triangle_columns as statistics_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.raster.bands import Band
    from geomesh.surface.accuracy import Accuracy
    from geomesh.zonal.statistics import Statistics


def node_columns(values: Floats, bands: Sequence[str]) -> dict[str, Floats]:
    """Return the columns of the nodes with the values (N, B) of a linear surface."""
    # Adding 0 turns -0 into 0: a GeoPackage keeps only one of them.
    return {band: values[:, k] + 0.0 for k, band in enumerate(bands)}


def triangle_columns(
    stats: Statistics,
    measured: Sequence[Band],
    accuracy: Accuracy,
    which: Sequence[str] = DEFAULT_STATISTICS,
    *,
    means: Floats | None = None,
) -> dict[str, NDArray[Any]]:
    """Return the columns of the triangles: count, then band by band statistics and errors.

    Parameters
    ----------
    stats : Statistics
    measured : sequence of Band
        The bands of `stats`; of a palette the band of its classes.
    accuracy : Accuracy
        Of a palette those of its colours, which come last.
    which : sequence of str
        The wanted statistics.
    means : float64 (B, T), optional
        The values of a surface with the model "constant", for the bands of `accuracy`. They
        become `<band>_mean`, also if `which` does not have the mean.
    """
    found = statistics_columns(stats, measured, which)
    columns: dict[str, NDArray[Any]] = {"count": found["count"]}
    errors = {name: _errors(accuracy, k) for k, name in enumerate(accuracy.bands)}
    if means is not None:
        for k, name in enumerate(accuracy.bands):
            errors[name] = {"mean": means[k] + 0.0, **errors[name]}
    for band in measured:
        names = [f"{band.name}_{each}" for each in statistics_of(band, which)]
        columns |= {name: found[name] for name in names}
        columns |= _named(band.name, errors.pop(band.name, {}))
    for name, rest in errors.items():
        columns |= _named(name, rest)
    return columns


def _errors(accuracy: Accuracy, band: int) -> dict[str, Floats]:
    return {
        "rmse": accuracy.triangle_rmse[band],
        "max_error": accuracy.triangle_max_error[band],
    }


def _named(band: str, columns: dict[str, Floats]) -> dict[str, Floats]:
    return {f"{band}_{name}": values for name, values in columns.items()}
