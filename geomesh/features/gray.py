"""Stage 1: convert bands to the 8-bit gray image, the input of Canny and SIFT."""

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

# The weights of ITU-R BT.601. OpenCV's conversion from RGB to gray uses them too.
LUMA = (0.299, 0.587, 0.114)

# Rows to convert at a time. With few rows, temporary arrays stay in the processor's cache.
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
        Their values are used by "pca" only.
    method : {"auto", "luma", "mean", "pca"} or "band:N"
        N is one of `numbers`.
    valid : bool (H, W), optional
        Pixels that the principal component is computed from. Default: all.
    rgb : (int, int, int), optional
        Positions of red, green and blue. "luma" needs them; "auto" uses luma if they are
        given.
    numbers : sequence of int, optional
        Numbers of the bands in the file. Default: 1, 2, ...

    Returns
    -------
    float64 (B,)
        Not negative, and their sum is 1. For "pca": a unit vector whose sum is 0 or more, so
        that bright pixels stay bright.
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
                "`bidx`, if there are three, or set `gray` to mean, pca or band:N"
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
    """Return the first principal axis (B,) of values (B, n). Bright pixels stay bright."""
    centred = values - values.mean(axis=1, keepdims=True)
    # Not with BLAS, because the last bits of its results depend on its number of threads.
    _, axes = np.linalg.eigh(np.einsum("in,jn->ij", centred, centred))
    axis: NDArray[np.float64] = axes[:, -1]
    return axis if axis.sum() >= 0 else -axis


def to_gray(bands: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[Any]:
    """Return the weighted sum (H, W) of bands (B, H, W), in the units of the bands.

    8-bit red, green and blue give exactly the 8-bit gray of OpenCV (its fixed-point
    arithmetic). A single band of weight 1 keeps its type. All other results are float64.
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
    # Not with BLAS, because the last bits of its results depend on its number of threads.
    total = np.zeros(bands.shape[1:])
    with np.errstate(invalid="ignore", over="ignore"):
        for band, weight in zip(bands, weights, strict=True):
            total += weight * band.astype(np.float64)
    return total


def stretch_to_uint8(values: NDArray[Any], black: float, white: float) -> Gray:
    """Return `values` scaled so that `black` becomes 0 and `white` becomes 255, and clipped."""
    if not white > black:
        return np.zeros(values.shape, np.uint8)
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = (values.astype(np.float64) - black) * (255 / (white - black))
        clipped = np.nan_to_num(np.clip(scaled, 0, 255), nan=0.0)
    return np.rint(clipped).astype(np.uint8)


@dataclass(frozen=True)
class Tone:
    """How pixel values become gray levels. It is the same for every tile of a scene.

    Parameters
    ----------
    weights : tuple of float
        Weight of each band.
    band_ranges : tuple of (black, white), optional
        Range of each band that is stretched to 8 bits before the weighted sum.
    gray_range : (black, white), optional
        Range of the gray image that is stretched to 8 bits.
    display_ranges : tuple of (black, white), optional
        Range of each band that is stretched for display as a colour. None: the bands have 8
        bits and are shown without a stretch.
    """

    weights: tuple[float, ...]
    band_ranges: tuple[tuple[float, float], ...] | None
    gray_range: tuple[float, float] | None
    display_ranges: tuple[tuple[float, float], ...] | None

    def gray(self, bands: NDArray[Any], valid: NDArray[np.bool_]) -> Gray:
        """Return the 8-bit gray image of bands (B, H, W), with nodata filled from nearby data."""
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
    """Return the Tone of a scene, computed from decimated pixels of the whole scene.

    Parameters
    ----------
    bands : (B, H, W)
    valid : bool (H, W)
        At least one pixel.
    recipe : Recipe
        Its gray, stretch and stretch_gray are used.
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
    # If no weight is negative and their sum is 1, the sum of 8-bit bands fits into 8 bits.
    fits = bool((weights >= 0).all() and abs(weights.sum() - 1) < 1e-9)
    gray_range = None
    if recipe.stretch_gray or not fits:
        gray = to_gray(seen.astype(np.float64)[:, None], weights)
        gray_range = _percentiles(gray, recipe.stretch)
    return Tone(tuple(map(float, weights)), band_ranges, gray_range, ranges)


def _percentiles(values: NDArray[Any], percentiles: tuple[float, float]) -> tuple[float, float]:
    black, white = np.percentile(values.astype(np.float64), percentiles)
    if black == white:  # most pixels have one value, as in a mask: use the whole range
        black, white = float(values.min()), float(values.max())
    return float(black), float(white)
