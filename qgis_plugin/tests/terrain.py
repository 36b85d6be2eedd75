"""DEMs that tests of terrain make, and the layers that they become."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Callable

if TYPE_CHECKING:
    from pathlib import Path

NODATA = -9999.0


def write_dem(
    path: Path,
    height: Callable[[float, float], float] = lambda x, y: 100 + 20 * math.sin(x / 9) + y / 4,
    side: int = 60,
    crs: int | None = 32613,
    unit: str = "m",
    cell: float = 10,
) -> Path:
    """Write a DEM whose heights are a function of column and row. NaN is nodata."""
    import numpy as np
    from osgeo import gdal, osr

    values = np.array([[height(x, y) for x in range(side)] for y in range(side)], np.float32)
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), side, side, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((500000, cell, 0, 4300000, 0, -cell))
    if crs is not None:
        reference = osr.SpatialReference()
        reference.ImportFromEPSG(crs)
        dataset.SetProjection(reference.ExportToWkt())
    band = dataset.GetRasterBand(1)
    band.SetNoDataValue(NODATA)
    band.SetUnitType(unit)
    band.WriteArray(np.where(np.isnan(values), NODATA, values))
    del band, dataset
    return path


def mirror(source: Path, path: Path, side: int) -> Path:
    """Write a square DEM: a smaller one and its mirror images, without a seam."""
    import numpy as np
    from osgeo import gdal

    small = gdal.Open(str(source))
    values = small.ReadAsArray()
    rows, columns = values.shape
    padding = [(0, max(side - size, 0)) for size in (rows, columns)]
    large = np.pad(values, padding, mode="symmetric")[:side, :side]
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), side, side, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform(small.GetGeoTransform())
    dataset.SetProjection(small.GetProjection())
    dataset.GetRasterBand(1).WriteArray(large)
    del dataset
    return path
