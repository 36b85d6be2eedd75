"""Make scenes of any size from a real image, mirrored repeatedly to keep the same texture."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rasterio
from rasterio.windows import Window

if TYPE_CHECKING:
    from numpy.typing import NDArray

SAMPLE = Path(__file__).parent.parent / "data_samples" / "iguacu_landsat8_rgb_uint16.tif"

_BLOCK = 512


def make_scene(size: int, path: Path) -> None:
    """Write a GeoTIFF of `size` x `size` pixels, tiled and compressed as in archives."""
    with rasterio.open(SAMPLE) as sample:
        bands, profile = sample.read(), sample.profile
    block = {"tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK} if size >= _BLOCK else {}
    profile.update(
        **{"driver": "GTiff", "width": size, "height": size, "tiled": False} | block,
        compress="deflate",
        predictor=2,
        bigtiff="if_safer",
        num_threads="all_cpus",
    )
    cols = _mirrored(0, size, bands.shape[2])
    with rasterio.open(path, "w", **profile) as scene:
        for top in range(0, size, _BLOCK):
            height = min(_BLOCK, size - top)
            rows = _mirrored(top, height, bands.shape[1])
            strip = np.take(np.take(bands, rows, axis=1), cols, axis=2)
            scene.write(strip, window=Window(0, top, size, height))


def _mirrored(start: int, count: int, length: int) -> NDArray[np.intp]:
    """Return the source pixels (of `length`) for `start`, `start` + 1, ..., back and forth."""
    place = np.arange(start, start + count) % (2 * length)
    return np.minimum(place, 2 * length - 1 - place)


if __name__ == "__main__":
    make_scene(int(sys.argv[1]), Path(sys.argv[2]))
