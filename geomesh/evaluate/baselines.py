"""Baselines: other ways to choose the nodes of a mesh, to compare the presets with.

Each is a pure function of an 8-bit gray image that places so many nodes on its valid
pixels. None knows of a mesh: the Delaunay triangulation of their convex hull follows, as
it does for the keypoints of the published system.

Where an image does not have so many places (edge pixels, corners, pixels at all), there
are fewer nodes; whoever compares has to tell the number.
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

# Fixed seed: the same draws in every run.
_SEED = 0

# The strongest corners, however weak, no closer to each other than feature nodes are.
_CORNER_QUALITY = 1e-6
_CORNER_DISTANCE = 2.0

# Steps to the density of error diffusion that gives so many nodes.
_STEPS = 40


def regular_grid(gray: Gray, valid: Mask, n: int) -> Points:  # noqa: ARG001
    """Place nodes on equally spaced rows, from the first to the last with valid pixels.

    In each row they are equally spaced along its valid pixels, from end to end; how many
    follows from the number of these pixels, so the spacing is the same in both directions.

    Parameters
    ----------
    gray : uint8 (H, W)
        Read by those baselines that look at the image.
    valid : bool (H, W)
        Where nodes may lie.
    n : int
        Nodes wanted.

    Returns
    -------
    float64 (N, 2)
        Distinct pixel-edge coordinates; every baseline takes and returns the same.
    """
    filled = np.flatnonzero(valid.any(axis=1))
    if not len(filled):
        return np.empty((0, 2))
    height = filled[-1] - filled[0] + 1
    # As many rows as keep the spacing in a row, at its mean width, the same as between rows.
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
    """Return `count` equally spaced places along pixels in `columns`, gaps left out."""
    last = len(columns) - 1
    places = 0.5 + (np.linspace(0, last, count) if count > 1 else np.full(count, last / 2))
    pixel = places.astype(int)
    along: NDArray[np.float64] = columns[pixel] + (places - pixel)
    return along


def random_pixels(gray: Gray, valid: Mask, n: int) -> Points:  # noqa: ARG001
    """Place nodes on valid pixels drawn by lot, each at most once."""
    return _draw(valid, n)


def canny_pixels(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes on pixels of Canny edges drawn by lot: uniform sampling of the edges.

    The thresholds are those that the `features` preset takes.
    """
    thresholds = canny_thresholds(ArrayGray.whole(gray, valid), Recipe())
    return _draw(canny_edges(gray, thresholds, valid) & valid, n)


def shi_tomasi(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes on the strongest corners, two pixels apart (Shi and Tomasi 1994)."""
    corners = cv2.goodFeaturesToTrack(
        gray, n, _CORNER_QUALITY, _CORNER_DISTANCE, mask=valid.view(np.uint8)
    )
    if corners is None:
        return np.empty((0, 2))
    return np.asarray(corners, np.float64).reshape(-1, 2) + 0.5


def yang_error_diffusion(gray: Gray, valid: Mask, n: int) -> Points:
    """Place nodes by error diffusion of the second derivative (Yang et al. 2003).

    The feature map is the greatest second directional derivative (the larger eigenvalue of
    the Hessian, by magnitude) of the image smoothed by a Gaussian of 1 pixel. Floyd and
    Steinberg's error diffusion, rows in alternating directions, turns it into nodes as
    dense as the map is high. The density that gives `n` nodes is found by bisection;
    of a few too many, those where the map is lowest go.
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
    """Return where error diffusion of a density (H, W), in nodes a pixel, places a node.

    Where there is no density there is no node; the error goes on across it.
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
    """Place nodes one by one where the mesh so far errs most (Garland and Heckbert 1995).

    By pydelatin. It begins with the corners of the image and knows of no mask: nodes on
    pixels that are not valid, which were filled with their nearest data, are left out.
    """
    from pydelatin import Delatin

    height, width = gray.shape
    if min(height, width) < 2:
        return np.empty((0, 2))
    # Its y axis points up.
    heights = np.ascontiguousarray(gray[::-1], dtype=np.float32)
    limit = n
    while True:
        # In the order of insertion, so that more of them begin with the same ones.
        x, y, _ = Delatin(heights, max_error=0.0, max_points=limit).vertices.T.astype(int)
        kept = np.flatnonzero(valid[y, x])[:n]
        if len(kept) == n or len(x) < limit:
            return _centres(y[kept], x[kept])
        limit *= 2


def _draw(mask: Mask, n: int) -> Points:
    """Return the centres of `n` pixels of a mask, or of all if there are fewer, in their order."""
    pixels = np.flatnonzero(mask)
    lots = np.random.default_rng(_SEED)
    chosen = lots.choice(pixels, min(n, len(pixels)), replace=False, shuffle=False)
    row, col = np.divmod(np.sort(chosen), mask.shape[1])
    return _centres(row, col)


def _centres(row: NDArray[np.integer], col: NDArray[np.integer]) -> Points:
    centres: Points = np.column_stack([col, row]).astype(np.float64) + 0.5
    return centres


def baselines() -> Mapping[str, Baseline]:
    """Return the baselines under their names; greedy insertion where pydelatin is installed."""
    known: dict[str, Baseline] = {
        "regular grid": regular_grid,
        "random": random_pixels,
        "uniform Canny": canny_pixels,
        "Shi-Tomasi": shi_tomasi,
        "Yang error diffusion": yang_error_diffusion,
    }
    return known | {GREEDY: greedy_insertion} if has_pydelatin() else known


def has_pydelatin() -> bool:
    """Tell whether greedy insertion can be had."""
    try:
        import pydelatin  # noqa: F401
    except ImportError:
        return False
    return True
