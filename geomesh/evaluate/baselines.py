"""Baselines: other ways to choose the nodes of a mesh, to compare the presets with.

Each baseline is a pure function that places a given number of nodes on the valid pixels of
an 8-bit gray image. It does not make a mesh: later, the Delaunay triangulation of the
convex hull of its nodes is made, as for the keypoints of the published system.

If an image does not have enough edge pixels, corners or valid pixels, a baseline returns
fewer nodes; a comparison has to report the number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import cv2
import numpy as np

from geomesh.arrays.jit import boolean, float64, kernel, reads, void, writes
from geomesh.arrays.types import Floats, Gray, Mask, Points
from geomesh.features.canny import canny_edges, canny_thresholds
from geomesh.features.gray_image import ArrayGray
from geomesh.raster.grid import snap
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from numpy.typing import NDArray

Baseline = Callable[[Gray, Mask, int], Points]

GREEDY = "greedy insertion"

# Fixed seed: every run draws the same pixels.
_SEED = 0

# A low quality limit, so that weak corners count too; and the minimum distance of feature nodes.
_CORNER_QUALITY = 1e-6
_CORNER_DISTANCE = 2.0

# Maximum number of bisection steps to find the density of error diffusion.
_STEPS = 40


def regular_grid(gray: Gray, valid: Mask, n: int) -> Points:  # noqa: ARG001
    """Place nodes on equally spaced rows, from the first to the last row with valid pixels.

    In each row, nodes are equally spaced along its valid pixels, from end to end. Their
    number is proportional to the number of valid pixels, so that the spacing is the same in
    both directions.

    Parameters
    ----------
    gray : uint8 (H, W)
        The image; some baselines do not use it.
    valid : bool (H, W)
        Pixels on which nodes can be placed.
    n : int
        Number of nodes to place.

    Returns
    -------
    float64 (N, 2)
        Distinct pixel-edge coordinates. All baselines have the same parameters and result.
    """
    filled = np.flatnonzero(valid.any(axis=1))
    if not len(filled):
        return np.empty((0, 2))
    height = filled[-1] - filled[0] + 1
    # Choose the number of rows so that, in a row of mean width, the spacing of the nodes is
    # equal to the spacing of the rows.
    lines = round(height * np.sqrt(n / np.count_nonzero(valid)))
    y = np.linspace(filled[0], filled[-1], min(max(lines, 2), height)) + 0.5
    rows = [np.flatnonzero(valid[row]) for row in y.astype(int)]
    widths = np.array([len(row) for row in rows])
    ends = np.rint(np.cumsum(widths) * (n / widths.sum())).astype(int)
    points = [
        np.column_stack([_along(row, count), np.full(count, middle)])
        for row, count, middle in zip(rows, np.diff(ends, prepend=0), y, strict=True)
    ]
    return np.unique(snap(np.concatenate(points)), axis=0)


def _along(columns: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Return `count` equally spaced x coordinates along the pixels `columns`, without gaps."""
    last = len(columns) - 1
    places = 0.5 + (np.linspace(0, last, count) if count > 1 else np.full(count, last / 2))
    pixel = places.astype(int)
    along: NDArray[np.float64] = columns[pixel] + (places - pixel)
    return along


def random_pixels(gray: Gray, valid: Mask, n: int) -> Points:  # noqa: ARG001
    """Place nodes on randomly drawn valid pixels, without replacement."""
    return _draw(valid, n)


def canny_pixels(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes on randomly drawn pixels of Canny edges: uniform sampling of the edges.

    The thresholds are those of the `features` preset.
    """
    thresholds = canny_thresholds(ArrayGray.whole(gray, valid), Recipe())
    return _draw(canny_edges(gray, thresholds, valid) & valid, n)


def shi_tomasi(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes on the strongest corners, at least 2 pixels apart (Shi and Tomasi 1994)."""
    corners = cv2.goodFeaturesToTrack(
        gray, n, _CORNER_QUALITY, _CORNER_DISTANCE, mask=valid.view(np.uint8)
    )
    if corners is None:
        return np.empty((0, 2))
    return np.asarray(corners, np.float64).reshape(-1, 2) + 0.5


def yang_error_diffusion(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes by error diffusion of the second derivative (Yang et al. 2003).

    The feature map is the largest second directional derivative (the larger eigenvalue of
    the Hessian, by magnitude) of the image, smoothed by a Gaussian of 1 pixel. Floyd-Steinberg
    error diffusion, with rows in alternating directions, places nodes with a density
    proportional to the map. Bisection finds the density that gives `n` nodes. If there are
    a few nodes too many, the nodes with the lowest values of the map are removed.
    """
    density = _second_derivative(gray) * valid
    if not density.any():
        return np.empty((0, 2))
    density *= n / density.sum()
    low, high = 0.0, 1.0
    while np.count_nonzero(_diffuse(density * high)) < n and high < 2**_STEPS:
        low, high = high, 2 * high
    for _ in range(_STEPS):
        middle = (low + high) / 2
        found = np.count_nonzero(_diffuse(density * middle))
        low, high = (middle, high) if found < n else (low, middle)
        if found == n:
            break
    row, col = np.nonzero(_diffuse(density * high))
    strongest = np.argsort(-density[row, col], kind="stable")[:n]
    return _centres(row[strongest], col[strongest])


def _second_derivative(gray: Gray) -> NDArray[np.float64]:
    smooth = cv2.GaussianBlur(gray.astype(np.float64), (0, 0), 1.0)
    xx, yy, xy = (
        np.asarray(cv2.Sobel(smooth, cv2.CV_64F, dx, dy, ksize=3), np.float64)
        for dx, dy in ((2, 0), (0, 2), (1, 1))
    )
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    largest: NDArray[np.float64] = np.abs(mean) + spread
    return largest


def _diffuse(density: Floats) -> Mask:
    """Return where error diffusion of a density (H, W), in nodes per pixel, places a node.

    Pixels without density get no node, but pass the error on.
    """
    placed = np.zeros(density.shape, np.bool_)
    _diffuse_errors(np.ascontiguousarray(density), density.copy(), placed)
    return placed


@kernel(void(reads(float64, 2), writes(float64, 2), writes(boolean, 2)))
def _diffuse_errors(density: Floats, due: Floats, placed: Mask) -> None:
    height, width = density.shape
    for row in range(height):
        step = 1 if row % 2 == 0 else -1
        for k in range(width):
            col = k if step == 1 else width - 1 - k
            error = due[row, col]
            if error >= 0.5 and density[row, col] > 0:
                placed[row, col] = True
                error -= 1.0
            ahead, behind = col + step, col - step
            if 0 <= ahead < width:
                due[row, ahead] += error * (7 / 16)
            if row + 1 < height:
                due[row + 1, col] += error * (5 / 16)
                if 0 <= behind < width:
                    due[row + 1, behind] += error * (3 / 16)
                if 0 <= ahead < width:
                    due[row + 1, ahead] += error * (1 / 16)


def greedy_insertion(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes one by one where the current mesh errs most (Garland and Heckbert 1995).

    pydelatin does this. It starts with the corners of the image and does not support a mask.
    Pixels that are not valid were filled with the nearest valid values; nodes on them are
    removed.
    """
    from pydelatin import Delatin

    height, width = gray.shape
    if min(height, width) < 2:
        return np.empty((0, 2))
    # In pydelatin the y axis points up.
    heights = np.ascontiguousarray(gray[::-1], dtype=np.float32)
    limit = n
    while True:
        # Vertices are in order of insertion, so a larger set starts with the same vertices.
        x, y, _ = Delatin(heights, max_error=0.0, max_points=limit).vertices.T.astype(int)
        kept = np.flatnonzero(valid[y, x])[:n]
        if len(kept) == n or len(x) < limit:
            return _centres(y[kept], x[kept])
        limit *= 2


def _draw(mask: Mask, n: int) -> Points:
    """Return the centres of `n` random pixels of a mask, or of all if there are fewer.

    They are in the order of the pixels.
    """
    pixels = np.flatnonzero(mask)
    rng = np.random.default_rng(_SEED)
    chosen = rng.choice(pixels, min(n, len(pixels)), replace=False, shuffle=False)
    row, col = np.divmod(np.sort(chosen), mask.shape[1])
    return _centres(row, col)


def _centres(row: NDArray[np.integer], col: NDArray[np.integer]) -> Points:
    centres: Points = np.column_stack([col, row]).astype(np.float64) + 0.5
    return centres


def baselines() -> Mapping[str, Baseline]:
    """Return the baselines by name; greedy insertion only if pydelatin is installed."""
    known: dict[str, Baseline] = {
        "regular grid": regular_grid,
        "random": random_pixels,
        "uniform Canny": canny_pixels,
        "Shi-Tomasi": shi_tomasi,
        "Yang error diffusion": yang_error_diffusion,
    }
    return known | {GREEDY: greedy_insertion} if has_pydelatin() else known


def has_pydelatin() -> bool:
    """Return whether pydelatin, which greedy insertion needs, is installed."""
    try:
        import pydelatin  # noqa: F401
    except ImportError:
        return False
    return True
