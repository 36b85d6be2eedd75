"""Turn band statistics into columns of the attribute tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.mesh.topology import FILL
from geomesh.parameters import CLASS_STATISTICS, COUNTED_STATISTICS, DEFAULT_STATISTICS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.raster.bands import Band
    from geomesh.zonal.statistics import Statistics


def counted_bands(bands: Sequence[Band], which: Sequence[str]) -> tuple[int, ...]:
    """Return the positions of the bands whose values have to be counted for these statistics."""
    return tuple(
        k
        for k, band in enumerate(bands)
        if not set(COUNTED_STATISTICS).isdisjoint(statistics_of(band, which))
    )


def statistics_of(band: Band, which: Sequence[str]) -> tuple[str, ...]:
    """Return those of the wanted statistics that make sense for a band.

    Classes have neither an order nor a mean: if no statistic of classes is wanted, they get
    all of these instead.
    """
    if not band.is_class or not which:
        return tuple(which)
    return tuple(name for name in which if name in CLASS_STATISTICS) or CLASS_STATISTICS


def triangle_columns(
    stats: Statistics, bands: Sequence[Band], which: Sequence[str] = DEFAULT_STATISTICS
) -> dict[str, NDArray[Any]]:
    """Return the columns of the triangles: count, then <band>_<statistic> band by band."""
    columns: dict[str, NDArray[Any]] = {"count": stats.count}
    for k, band in enumerate(bands):
        for statistic in statistics_of(band, which):
            row = stats.counted.index(k) if statistic in COUNTED_STATISTICS else k
            values = getattr(stats, statistic)[row]
            if band.is_class and statistic != "variety":
                values = _classes(values)
            columns[f"{band.name}_{statistic}"] = values
    return columns


def node_columns(stats: Statistics, bands: Sequence[Band]) -> dict[str, NDArray[Any]]:
    """Return the columns of the nodes: one for each band, with the value at the node."""
    return {
        band.name: _classes(values) if band.is_class else values
        for band, values in zip(bands, stats.node_values, strict=True)
    }


def _classes(values: Floats) -> NDArray[np.signedinteger[Any]]:
    """Return classes as whole numbers; `FILL` where there is none."""
    known = np.where(np.isnan(values), FILL, values)
    fits = np.abs(known).max(initial=0) <= np.iinfo(np.int32).max
    return known.astype(np.int32 if fits else np.int64)
