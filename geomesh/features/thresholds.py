"""Canny's thresholds: the recipe's, or such as suit the gradients of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.features.canny import Thresholds, automatic_thresholds
from geomesh.features.gray import Gray
from geomesh.features.gray_image import GrayImage
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.grid import Window
from geomesh.recipe import Recipe

# Automatic thresholds look at the whole image up to this size, else at a block of it in each
# cell of a grid, for thresholds within a few percent of those of all pixels.
_SAMPLE_SIZE = 1024
_SAMPLE_CELLS = 7
_SAMPLE_BLOCK = 192
_SAMPLE_PIXELS = 65_536

# Where in its cell a block lies: a sequence that fills a square evenly (Roberts 2018, "R2"). At
# even distances the blocks might meet the same part of a pattern again and again.
_STEPS = 0.7548776662466927, 0.5698402909980532


def canny_thresholds(image: GrayImage, recipe: Recipe) -> Thresholds:
    """Return the recipe's Canny thresholds; those it leaves open come from the image."""
    low, high = recipe.canny_low, recipe.canny_high
    if low is None or high is None:
        found = automatic_thresholds(_samples(image), recipe.canny_l2)
        # A threshold given alone bounds the automatic one.
        high = max(found.high, low or 0) if high is None else high
        low = min(found.low, high) if low is None else low
    return Thresholds(low, high, recipe.canny_l2)


def _samples(image: GrayImage) -> list[tuple[Gray, NDArray[np.bool_]]]:
    """Blocks of the image that hold enough valid pixels to know its gradients by."""
    blocks, found = [], 0
    windows = _sample_windows(image.extent)
    if len(windows) > 1:  # where data are sparse, go through the tiles until there are enough
        windows += [tile.core for tile in plan_tiles(image.extent)]
    for count, window in enumerate(windows):
        if count >= _SAMPLE_CELLS**2 and found >= _SAMPLE_PIXELS:
            break
        gray, valid = image.read(window)
        found += int(np.count_nonzero(valid))
        blocks.append((gray, valid))
    return blocks


def _sample_windows(extent: Window) -> list[Window]:
    if max(extent.width, extent.height) <= _SAMPLE_SIZE:
        return [extent]
    windows = []
    for k in range(_SAMPLE_CELLS**2):
        row, col = divmod(k, _SAMPLE_CELLS)
        x = (col + k * _STEPS[0] % 1) * extent.width / _SAMPLE_CELLS
        y = (row + k * _STEPS[1] % 1) * extent.height / _SAMPLE_CELLS
        corner = round(x) - _SAMPLE_BLOCK // 2, round(y) - _SAMPLE_BLOCK // 2
        windows.append(Window(*corner, _SAMPLE_BLOCK, _SAMPLE_BLOCK).clip(extent))
    return windows
