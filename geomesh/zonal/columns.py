"""Turn band statistics into columns of the attribute tables: names and values."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.zonal.statistics import Statistics

# Names of other columns; a band must not have one of these names.
_TAKEN = frozenset(("id", "kind", "col", "row", "scale", "response", "octave", "angle"))
_TAKEN |= frozenset(("fid", "bbox", "geometry", "geom"))
# The statistics of a band with one of these names would have the name of a quality measure,
# such as ki_min or ki_mean.
_TAKEN |= frozenset(("ki", "map_ki"))
_LONGEST_NAME = 40


def triangle_columns(
    stats: Statistics,
    band_names: Sequence[str],
    which: Sequence[str] = ("mean", "std", "min", "max"),
) -> dict[str, NDArray[Any]]:
    """Return the columns of the triangles: count, then <band>_<statistic> band by band."""
    columns: dict[str, NDArray[Any]] = {"count": stats.count}
    for band, name in enumerate(band_names):
        columns |= {f"{name}_{statistic}": getattr(stats, statistic)[band] for statistic in which}
    return columns


def node_columns(stats: Statistics, band_names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the columns of the nodes: one for each band, with the value at the node."""
    return {name: stats.node_values[band] for band, name in enumerate(band_names)}


def band_names(descriptions: Sequence[str | None]) -> list[str]:
    """Return a column name for each band: made from its description, or else b1, b2, ...

    A name has only lower-case letters, digits and underscores, starts with a letter and has
    at most 40 characters. All names are different, and none is the name of another column.
    """
    names: list[str] = []
    for number, description in enumerate(descriptions, start=1):
        plain = unicodedata.normalize("NFKD", description or "").encode("ascii", "ignore").decode()
        name = re.sub("[^a-z0-9]+", "_", plain.lower()).strip("_") or f"b{number}"
        if not name[0].isalpha() or name in _TAKEN:
            name = f"b_{name}"
        name = name[:_LONGEST_NAME].rstrip("_")
        stem, turn = name, 1
        while name in names:
            turn += 1
            name = f"{stem[: _LONGEST_NAME - len(f'_{turn}')]}_{turn}"
        names.append(name)
    return names
