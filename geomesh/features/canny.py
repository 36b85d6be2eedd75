"""Stage 2: Canny edges, tile by tile, with exact hysteresis across tiles.

Gradients and non-maximum suppression depend on a few pixels only, but hysteresis follows an
edge over any distance. So each tile labels its components of weak pixels, marks those that
contain a strong pixel, and lists the pixels that neighbouring tiles see too. Components that
share a pixel are one component. A component with a strong pixel in any tile is an edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from geomesh.parallel.tiles import Tile, plan_tiles
from geomesh.raster.grid import Window

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from geomesh.arrays.types import Gray
    from geomesh.features.gray_image import GrayImage
    from geomesh.recipe import Recipe

# Automatic thresholds. High: twice the median of the gradients above 0, but at most 0.9 times
# their 99th percentile, because in a mask all edges are equally strong. Low: half of the high
# one.
_MEDIANS = 2.0
_STRONGEST = 99
_OF_STRONGEST = 0.9

# Edges may cross nodata within this distance of data: single pixels, but not a wide border.
_BRIDGE = np.ones((5, 5), np.uint8)

# Upper limit of the thresholds, the same as in OpenCV.
_GREATEST = 32_767

Gradients = tuple[NDArray[np.int16], NDArray[np.int16]]


@dataclass(frozen=True)
class Thresholds:
    """Hysteresis thresholds on the gradient, in gray levels, for the L2 norm or the L1 norm."""

    low: float
    high: float
    l2: bool


class WeakEdges(NamedTuple):
    """The components of weak edge pixels of a tile.

    Attributes
    ----------
    labels : int32 (h, w)
        Number of the component of each pixel in `window`, from 1; 0 is no edge.
    window : Window
        The tile's core and a seam around it.
    rows, cols : int64 (P,)
        The edge pixels, in pixels of the image.
    magnitude : int32 (P,)
        Their gradients: see `_magnitude`.
    """

    labels: NDArray[np.int32]
    window: Window
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    magnitude: NDArray[np.int32]


@dataclass(frozen=True)
class EdgePartial:
    """The data about the components of one tile that `unite` needs. It is small.

    Attributes
    ----------
    strong : bool (K + 1,)
        Whether component k contains a strong pixel in this tile.
    seam_pixels : int64 (S,)
        Weak pixels that other tiles see too, each as row * image width + column.
    seam_labels : int32 (S,)
        The component of each of these pixels.
    """

    strong: NDArray[np.bool_]
    seam_pixels: NDArray[np.int64]
    seam_labels: NDArray[np.int32]


def canny_edges(
    gray: Gray, thresholds: Thresholds, valid: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return the Canny edges of a whole 8-bit image (H, W).

    Edges do not continue into pixels that are not `valid` (H, W).
    """
    if valid is None:
        valid = np.ones(gray.shape, np.bool_)
    height, width = gray.shape
    whole = Window(0, 0, width, height)
    weak, partial = tile_edges(
        gray, valid, Tile(whole, whole), thresholds, image_width=width, seam=1
    )
    edges: NDArray[np.bool_] = partial.strong[weak.labels]
    return edges


def _gradients(gray: Gray) -> Gradients:
    """Return the 3x3 Sobel derivatives, with the border rule of cv2.Canny."""
    border = cv2.BORDER_REPLICATE
    dx = cv2.Sobel(gray, cv2.CV_16S, 1, 0, ksize=3, borderType=border)
    dy = cv2.Sobel(gray, cv2.CV_16S, 0, 1, ksize=3, borderType=border)
    return dx, dy  # type: ignore[return-value]


def _magnitude(gradients: Iterable[NDArray[np.int16]], l2: bool) -> NDArray[np.int32]:
    """Return the magnitude that cv2.Canny compares: the L1 norm, or the square of the L2 norm."""
    dx, dy = (g.astype(np.int32) for g in gradients)
    return dx * dx + dy * dy if l2 else np.abs(dx) + np.abs(dy)


def automatic_thresholds(samples: Sequence[tuple[Gray, NDArray[np.bool_]]], l2: bool) -> Thresholds:
    """Return thresholds that are computed from the median gradient.

    Parameters
    ----------
    samples : sequence of (gray (h, w), valid (h, w))
        Blocks of the image at its own resolution.
    l2 : bool
        True: L2 norm of the gradient. False: L1 norm.
    """
    magnitudes = [np.zeros(0, np.int32)]
    for gray, valid in samples:
        magnitude = _magnitude(_gradients(gray), l2)
        magnitudes.append(magnitude[valid & (magnitude > 0)])
    pooled: NDArray[Any] = np.concatenate(magnitudes)
    if len(pooled) == 0:
        return Thresholds(0.0, 0.0, l2)
    median, strongest = np.percentile(np.sqrt(pooled) if l2 else pooled, (50, _STRONGEST))
    high = min(_MEDIANS * float(median), _OF_STRONGEST * float(strongest))
    return Thresholds(high / 2, high, l2)


def tile_edges(
    gray: Gray,
    valid: NDArray[np.bool_],
    tile: Tile,
    thresholds: Thresholds,
    *,
    image_width: int,
    seam: int,
) -> tuple[WeakEdges, EdgePartial]:
    """Return the weak edges of a tile, and the data about them for `unite`.

    Parameters
    ----------
    gray : uint8 (h, w)
        Gray levels of the pixels of `tile.read`.
    valid : bool (h, w)
        Valid pixels. Edges cross single pixels of nodata, but do not continue into larger
        areas, because the gray levels filled in far from data depend on the tile.
    tile : Tile
    thresholds : Thresholds
    image_width : int
        Number of columns of the whole image.
    seam : int
        Width of the seam around the core, in pixels, at least 1.
    """
    gradients = _gradients(gray)
    low, l2 = thresholds.low, thresholds.l2
    near_data = cv2.dilate(valid.view(np.uint8), _BRIDGE)
    weak = cv2.Canny(*gradients, low, low, L2gradient=l2) * near_data
    window = tile.core.pad(seam).clip(tile.read)
    block = window.slices(tile.read)
    high = min(thresholds.high, _GREATEST)
    limit = int(high**2) if l2 else int(high)
    count, components = cv2.connectedComponents(weak[block], connectivity=8, ltype=cv2.CV_32S)
    labels: NDArray[np.int32] = np.asarray(components, np.int32)
    rows, cols = np.nonzero(weak[block])
    label = labels[rows, cols]
    magnitude = _magnitude((gradient[block][rows, cols] for gradient in gradients), l2)
    strong = np.zeros(count, np.bool_)
    strong[label[magnitude > limit]] = True
    rows, cols = rows + window.row, cols + window.col
    inner = tile.core.pad(-seam)  # no other tile sees these pixels
    shared = (rows < inner.row) | (rows >= inner.stop_row)
    shared |= (cols < inner.col) | (cols >= inner.stop_col)
    pixels = rows[shared].astype(np.int64) * image_width + cols[shared]
    weak_edges = WeakEdges(labels, window, rows, cols, magnitude)
    return weak_edges, EdgePartial(strong, pixels, label[shared])


def unite(partials: Sequence[EdgePartial]) -> list[NDArray[np.bool_]]:
    """Return, for each tile, which of its components are edges: bool (K + 1,)."""
    from scipy.sparse import coo_array  # slow to import, like csgraph
    from scipy.sparse.csgraph import connected_components

    starts = np.cumsum([0] + [len(p.strong) for p in partials])
    pixels = np.concatenate([p.seam_pixels for p in partials])
    labels = np.concatenate(
        [p.seam_labels + start for p, start in zip(partials, starts, strict=False)]
    )
    order = np.argsort(pixels, kind="stable")
    same = np.flatnonzero(np.diff(pixels[order]) == 0)
    one, other = labels[order[same]], labels[order[same + 1]]
    total = int(starts[-1])
    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(total, total))
    _, component = connected_components(links, directed=False)
    strong = np.concatenate([p.strong for p in partials])
    has_strong = np.zeros(component.max(initial=-1) + 1, np.bool_)
    has_strong[component[strong]] = True
    # Label 0 of each tile is "no edge": it is not linked to others and never strong.
    is_edge = has_strong[component]
    return [is_edge[a:b] for a, b in pairwise(starts)]


# Automatic thresholds use the whole image up to this side, in pixels. Of a larger image they use
# one block in each cell of a grid. The thresholds then differ by a few percent from those of all
# pixels.
_SAMPLE_SIZE = 1024

# Cells per side of the grid; side of a block in pixels; smallest number of valid pixels to use.
_SAMPLE_CELLS = 7
_SAMPLE_BLOCK = 192
_SAMPLE_PIXELS = 65_536

# Position of the block in its cell: a sequence that covers a square evenly (Roberts 2018, "R2").
# Blocks at equal distances could always hit the same part of a repeated pattern.
_STEPS = 0.7548776662466927, 0.5698402909980532


def canny_thresholds(image: GrayImage, recipe: Recipe) -> Thresholds:
    """Return the Canny thresholds of the recipe. If one is None, compute it from the image."""
    low, high = recipe.canny_low, recipe.canny_high
    if low is None or high is None:
        automatic = automatic_thresholds(_samples(image), recipe.canny_l2)
        # If only one threshold is given, it limits the automatic one.
        high = max(automatic.high, low or 0) if high is None else high
        low = min(automatic.low, high) if low is None else low
    return Thresholds(low, high, recipe.canny_l2)


def _samples(image: GrayImage) -> list[tuple[Gray, NDArray[np.bool_]]]:
    """Return blocks of the image that together have enough valid pixels for the thresholds."""
    blocks, valid_pixels = [], 0
    windows = _sample_windows(image.extent)
    if len(windows) > 1:  # if most pixels are invalid, read tiles until there are enough
        windows += [tile.core for tile in plan_tiles(image.extent)]
    for count, window in enumerate(windows):
        if count >= _SAMPLE_CELLS**2 and valid_pixels >= _SAMPLE_PIXELS:
            break
        gray, valid = image.read(window)
        valid_pixels += int(np.count_nonzero(valid))
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
