"""The range of heights of a DEM, from all of its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from qgis.core import QgsProcessingException

if TYPE_CHECKING:
    from qgis.core import QgsProcessingFeedback

# Pixels that are read at once.
_PIXELS = 4_000_000


@dataclass(frozen=True)
class HeightRange:
    """The heights of a DEM.

    Parameters
    ----------
    low, high : float
        Infinite, with low > high, if no pixel is valid.
    is_scaled : bool
        Whether the file has a scale or an offset, with which these heights were computed.
    """

    low: float
    high: float
    is_scaled: bool

    @property
    def span(self) -> float:
        """The range of heights; 0 if no pixel is valid."""
        return max(self.high - self.low, 0.0)


def find_height_range(
    path: str, number: int, nodata: float | None, feedback: QgsProcessingFeedback
) -> HeightRange:
    """Return the range of heights of a band, without pixels that have no value.

    Parameters
    ----------
    path : str
        For GDAL. Nothing is written: GDAL's own statistics would be saved beside the file.
    number : int
        Of the band; the first is 1.
    nodata : float or None
        Instead of the nodata value of the file.
    feedback : QgsProcessingFeedback
        Tells whether the user cancelled.

    Raises
    ------
    QgsProcessingException
        If the raster cannot be read, or the user cancelled.
    """
    import numpy as np
    from osgeo import gdal

    dataset = gdal.OpenEx(path, gdal.OF_RASTER)
    band = dataset.GetRasterBand(number) if dataset is not None else None
    if band is None:
        raise QgsProcessingException(
            f"Band {number} of {path} cannot be read: {gdal.GetLastErrorMsg()}"
        )
    mask = band.GetMaskBand()
    rows = max(_PIXELS // max(band.XSize, 1), 1)
    low, high = math.inf, -math.inf
    for top in range(0, band.YSize, rows):
        if feedback.isCanceled():
            raise QgsProcessingException("Cancelled: nothing was written.")
        part = (0, top, band.XSize, min(rows, band.YSize - top))
        values, valid = band.ReadAsArray(*part), mask.ReadAsArray(*part)
        if values is None or valid is None:
            raise QgsProcessingException(f"{path} cannot be read: {gdal.GetLastErrorMsg()}")
        keep = np.isfinite(values)
        keep &= values != nodata if nodata is not None else valid != 0
        if keep.any():
            kept = values[keep]
            low, high = min(low, float(kept.min())), max(high, float(kept.max()))
    scale, offset = band.GetScale() or 1.0, band.GetOffset() or 0.0
    ends = sorted((scale * low + offset, scale * high + offset)) if low <= high else (low, high)
    return HeightRange(*ends, is_scaled=(scale, offset) != (1.0, 0.0))
