"""Write small rasters of real data, with any size, data type and georeference."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from affine import Affine

from support.samples import OLINDA

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ROWS, COLS = 48, 64
SIZE = ROWS * COLS
UTM = "EPSG:32725"
NORTH_UP = Affine(30, 0, 288_000, 0, -30, 9_120_000)
MARS = "IAU_2015:49900"
GEOSTATIONARY = "+proj=geos +lon_0=-75 +h=35786023 +sweep=x"
FLOAT32_MIN = float(np.finfo(np.float32).min)


@cache
def landsat() -> np.ndarray:
    with rasterio.open(OLINDA) as dataset:
        return dataset.read()


def picture(bands: int = 1, rows: int = ROWS, cols: int = COLS) -> np.ndarray:
    """Return real data of any size, uint8 (bands, rows, cols), without the value 0."""
    source = landsat()
    down, across = (reflected(*sizes) for sizes in zip((rows, cols), source.shape[1:], strict=True))
    return np.maximum(source[np.arange(bands) % 3][:, down[:, None], across], 1)


def reflected(count: int, size: int) -> np.ndarray:
    """Return `count` indices that run from 0 to size - 1, back to 0, and so on."""
    turn = np.arange(count) % (2 * size)
    return np.where(turn < size, turn, 2 * size - 1 - turn)


def write_raster(
    folder: Path,
    name: str = "scene.tif",
    data: np.ndarray | None = None,
    *,
    change: Callable[[Any], None] | None = None,
    **profile: Any,
) -> str:
    """Write a raster and return its path. Default: UTM, pixels of 30 m."""
    data = picture() if data is None else data
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    profile = {
        "driver": "GTiff",
        "crs": UTM,
        "transform": NORTH_UP,
        "count": len(data),
        "height": data.shape[1],
        "width": data.shape[2],
        "dtype": data.dtype,
    } | profile
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(data)
        if change is not None:
            change(dataset)
    return str(path)


def raster(data: np.ndarray | None = None, **options: Any) -> Callable[[Path], str]:
    """Return a function that writes the raster; see `write_raster`."""
    return partial(write_raster, data=data, **options)


def holed(value: float, dtype: str = "uint8", bands: int = 1) -> np.ndarray:
    """Return the picture with `value` in 12 x 10 = 120 pixels, and nowhere else."""
    data = picture(bands).clip(2, 200).astype(dtype)
    data[:, 10:22, 20:30] = value
    return data


def constant(rows: int, cols: int) -> np.ndarray:
    return np.full((1, rows, cols), 7, np.uint8)
