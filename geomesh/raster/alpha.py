"""Whether a band that is tagged as alpha looks like data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rasterio.windows import Window

from geomesh.raster.bands import alpha_indexes
from geomesh.raster.gdal import GDAL_ERRORS

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rasterio

    from geomesh.parameters import Alpha

# The band is looked at in so many squares a side, of so many pixels a side.
_SQUARES = 4
_SIDE = 64

# A mask has few values, or one that most of its visible pixels have: a soft edge is narrow.
_FEW = 16
_MOST = 0.5


def note_on_alpha(name: str, dataset: rasterio.DatasetReader, alpha: Alpha) -> tuple[str, ...]:
    """Return a note if a band that is used as alpha holds more than a mask would."""
    for index in alpha_indexes(dataset, alpha):
        try:
            seen = np.concatenate(
                [dataset.read(index, window=square).ravel() for square in _squares(dataset)]
            )
        except GDAL_ERRORS:
            return ()  # reading the raster reports it
        values, counts = np.unique(seen[seen > 0], return_counts=True)
        if len(values) >= _FEW and counts.max() < _MOST * counts.sum():
            return (
                f"band {index} of {name} is tagged as alpha and used as a mask, but has many "
                'different values; if it is data, use `alpha="data"`',
            )
    return ()


def _squares(dataset: rasterio.DatasetReader) -> Iterator[Window]:
    """Yield small windows that are spread over a dataset."""
    width, height = min(_SIDE, dataset.width), min(_SIDE, dataset.height)
    for row in np.linspace(0, dataset.height - height, _SQUARES).astype(int).tolist():
        for col in np.linspace(0, dataset.width - width, _SQUARES).astype(int).tolist():
            yield Window(col, row, width, height)
