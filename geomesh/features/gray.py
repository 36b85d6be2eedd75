"""Stage 1: from bands to the 8-bit gray image that the detectors look at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from geomesh.errors import BandError
from geomesh.features.filters import fill_invalid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray
    from geomesh.recipe import Recipe

# ITU-R BT.601, the weights of OpenCV's RGB to gray conversion.
LUMA = (0.299, 0.587, 0.114)

# Rows that are made gray at a time: temporary arrays then stay in the processor's cache.
_ROWS = 32


def gray_weights(
    bands: NDArray[Any],
    method: str = "auto",
    *,
    valid: NDArray[np.bool_] | None = None,
    rgb: tuple[int, int, int] | None = None,
    numbers: Sequence[int] | None = None,
) -> NDArray[np.float64]:
    """Return the weight of each band in the gray image.

    Parameters
    ----------
    bands : (B, H, W)
        Read only by "pca".
    method : {"auto", "luma", "mean", "pca"} or "band:N"
        N is one of `numbers`.
    valid : bool (H, W), optional
        Pixels that the principal component is fitted to; all by default.
    rgb : (int, int, int), optional
        Positions of red, green and blue; needed by "luma", and what "auto" goes by.
    numbers : sequence of int, optional
        What the bands are called in the file; 1, 2, ... by default.

    Returns
    -------
    float64 (B,)
        Non-negative and adding up to 1, except for "pca": a unit vector whose
        components add up to 0 or more, so that bright stays bright.
    """
    count = len(bands)
    if method == "auto":
        method = "luma" if rgb is not None else "mean" if count == 1 else "pca"
    weights = np.zeros(count)
    if method == "mean":
        weights[:] = 1 / count
    elif method == "luma":
        if rgb is None:
            raise BandError(
                f"luma needs red, green and blue among the {count} bands: choose three with "
                "`bidx`, or set `gray` to mean, pca or band:N"
            )
        weights[list(rgb)] = LUMA
    elif method == "pca":
        values = bands.reshape(count, -1) if valid is None else bands[:, valid]
        weights = _principal_axis(values.astype(np.float64))
    else:
        number = int(method.removeprefix("band:"))
        known = list(numbers or range(1, count + 1))
        if number not in known:
            raise BandError(
                f"`gray={method}`: band {number} is not among the chosen bands "
                f"({', '.join(map(str, known))})"
            )
        weights[known.index(number)] = 1
    return weights


def _principal_axis(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """First principal axis of values (B, n), with a sign that keeps bright bright."""
    centred = values - values.mean(axis=1, keepdims=True)
    # Not by BLAS, whose last bits depend on its number of threads.
    _, axes = np.linalg.eigh(np.einsum("in,jn->ij", centred, centred))
    axis: NDArray[np.float64] = axes[:, -1]
    return axis if axis.sum() >= 0 else -axis


def to_gray(bands: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[Any]:
    """Return the weighted sum of bands (B, H, W): (H, W) in the bands' own units.

    8-bit red, green and blue give exactly OpenCV's 8-bit gray (its fixed-point
    arithmetic); everything else is float64.
    """
    used = np.flatnonzero(weights)
    if bands.dtype == np.uint8 and len(used) == 3 and set(weights[used]) == set(LUMA):
        order = [int(np.flatnonzero(weights == share)[0]) for share in LUMA]
        return cv2.cvtColor(
            np.ascontiguousarray(np.moveaxis(bands[order], 0, -1)), cv2.COLOR_RGB2GRAY
        )
    if len(used) == 1 and weights[used[0]] == 1:
        only: NDArray[Any] = bands[used[0]]
        return only
    return _weighted_sum(bands, weights)


def _weighted_sum(bands: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    # Not by BLAS, whose last bits depend on its number of threads.
    total = np.zeros(bands.shape[1:])
    with np.errstate(invalid="ignore", over="ignore"):
        for band, weight in zip(bands, weights, strict=True):
            total += weight * band.astype(np.float64)
    return total


def stretch_to_uint8(values: NDArray[Any], black: float, white: float) -> Gray:
    """Return `values` scaled so that `black` becomes 0 and `white` 255, and clipped."""
    if not white > black:
        return np.zeros(values.shape, np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = (values.astype(np.float64) - black) * (255 / (white - black))
        clipped = np.nan_to_num(np.clip(scaled, 0, 255), nan=0.0)
    return np.rint(clipped).astype(np.uint8)


@dataclass(frozen=True)
class Tone:
    """How pixel values become gray levels: the same for every tile of a scene.

    Parameters
    ----------
    weights : tuple of float
        Of each band.
    band_ranges : tuple of (black, white), optional
        Each band is stretched to 8 bits before weighing.
    gray_range : (black, white), optional
        The gray image is stretched to 8 bits.
    display_ranges : tuple of (black, white), optional
        Stretch for showing each band as a colour; None shows 8-bit bands as they are.
    """

    weights: tuple[float, ...]
    band_ranges: tuple[tuple[float, float], ...] | None
    gray_range: tuple[float, float] | None
    display_ranges: tuple[tuple[float, float], ...] | None

    def gray(self, bands: NDArray[Any], valid: NDArray[np.bool_]) -> Gray:
        """Return the 8-bit gray image of bands (B, H, W), nodata filled by its nearest data."""
        weights = np.array(self.weights)
        if self.band_ranges is not None:
            bands = _stretch_bands(bands, self.band_ranges)
        if self.gray_range is not None:
            gray = self._stretched(bands, weights, self.gray_range)
        else:
            gray = np.rint(to_gray(bands, weights)).astype(np.uint8)
        return fill_invalid(gray, valid)

    def _stretched(
        self, bands: NDArray[Any], weights: NDArray[np.float64], levels: tuple[float, float]
    ) -> Gray:
        gray = np.empty(bands.shape[1:], np.uint8)
        for start in range(0, len(gray), _ROWS):
            rows = slice(start, start + _ROWS)
            gray[rows] = stretch_to_uint8(_weighted_sum(bands[:, rows], weights), *levels)
        return gray

    def display(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Return band values (B, ...) as 8-bit levels for display."""
        if self.display_ranges is None:
            levels: NDArray[Any] = np.rint(np.clip(np.nan_to_num(values), 0, 255))
            return levels.astype(np.uint8)
        return _stretch_bands(values, self.display_ranges)


def _stretch_bands(
    bands: NDArray[Any], ranges: tuple[tuple[float, float], ...]
) -> NDArray[np.uint8]:
    return np.stack([stretch_to_uint8(b, *r) for b, r in zip(bands, ranges, strict=True)])


def fit_tone(
    bands: NDArray[Any],
    valid: NDArray[np.bool_],
    recipe: Recipe,
    *,
    rgb: tuple[int, int, int] | None = None,
    numbers: Sequence[int] | None = None,
) -> Tone:
    """Return the Tone of a scene from one decimated read of it.

    Parameters
    ----------
    bands : (B, H, W)
    valid : bool (H, W)
        At least one pixel.
    recipe : Recipe
        Its gray, stretch and stretch_gray are followed.
    rgb, numbers : optional
        As in `gray_weights`.
    """
    values = bands[:, valid]
    ranges = None
    if bands.dtype != np.uint8:
        ranges = tuple(_percentiles(band, recipe.stretch) for band in values)
    band_ranges = None if recipe.stretch_gray else ranges
    seen = values if band_ranges is None else _stretch_bands(values, band_ranges)
    weights = gray_weights(seen[:, None], recipe.gray, rgb=rgb, numbers=numbers)
    # Weights of one sign that add up to 1 keep 8-bit bands within 8 bits.
    fits = bool((weights >= 0).all() and abs(weights.sum() - 1) < 1e-9)
    gray_range = None
    if recipe.stretch_gray or not fits:
        gray = to_gray(seen.astype(np.float64)[:, None], weights)
        gray_range = _percentiles(gray, recipe.stretch)
    return Tone(tuple(map(float, weights)), band_ranges, gray_range, ranges)


def _percentiles(values: NDArray[Any], percentiles: tuple[float, float]) -> tuple[float, float]:
    black, white = np.percentile(values.astype(np.float64), percentiles)
    if black == white:  # mostly one value, a mask perhaps: stretch what there is
        black, white = float(values.min()), float(values.max())
    return float(black), float(white)
