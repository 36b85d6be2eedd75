"""The picture that a mesh gives: values at its nodes or of its triangles, as pixels again.

Two models: "linear" is a surface over the nodes, linear in each triangle; "constant" is
one value a triangle. Two ways to the values: "sampled" takes them from the raster at one
place, "least_squares" chooses them so that the pixels err least.

Everything here is on arrays, for one window at a time; `geomesh.surface.fit` and
`geomesh.surface.fidelity` walk over the tiles of a scene with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geomesh.arrays.jit import plain_bands
from geomesh.mesh.topology import Triangles
from geomesh.raster.grid import Points, Window
from geomesh.surface.kernels import paint_linear, project
from geomesh.zonal.rasterize import owner

Floats = NDArray[np.float64]

Model = Literal["linear", "constant"]
Fit = Literal["least_squares", "sampled"]
MODELS: tuple[Model, ...] = ("linear", "constant")
FITS: tuple[Fit, ...] = ("least_squares", "sampled")

# What the value that a node begins with weighs, in pixels that lie on the node.
RIDGE = 0.01

# What may be left of the moments in the solution.
_TOLERANCE = 1e-10

# The 3 x 3 matrix of a triangle in what NormalEquations holds of it.
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]


def reconstruct(
    nodes: Points, triangles: Triangles, values: Floats, window: Window, model: Model
) -> Floats:
    """Return the picture that a mesh gives in a window.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
        Of either orientation.
    values : float64
        "linear": (N, B), at the nodes; a pixel gets what the plane through the three
        corners of its triangle has at the pixel's centre. "constant": (T, B), of the
        triangles.
    window : Window
    model : {"linear", "constant"}

    Returns
    -------
    float64 (B, height, width)
        NaN where no triangle owns the pixel (see `geomesh.zonal.rasterize`), or its value is NaN.

    Raises
    ------
    ValueError
        If the model is unknown, or there is not a row of values for each node or triangle.
    """
    check(model=model)
    rows = len(nodes) if model == "linear" else len(triangles)
    if values.ndim != 2 or len(values) != rows:
        raise ValueError(f"values {values.shape} of a {model} model: expected ({rows}, bands)")
    if model == "constant":
        # A pixel without owner has the number FILL, which is -1: it takes the last row.
        padded = np.vstack([values, np.full(values.shape[1], np.nan)])
        return np.ascontiguousarray(np.moveaxis(padded[owner(nodes, triangles, window)], -1, 0))
    image = np.full((values.shape[1], *window.shape), np.nan)
    paint_linear(nodes, triangles, np.ascontiguousarray(values), window.row, window.col, image)
    return image


def check(*, model: str = MODELS[0], fit: str = FITS[0]) -> None:
    """Raise ValueError if there is no such model or way to its values."""
    if model not in MODELS:
        raise ValueError(f"model is {model!r}: choose {' or '.join(MODELS)}")
    if fit not in FITS:
        raise ValueError(f"fit is {fit!r}: choose {' or '.join(FITS)}")


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What some pixels say of how a surface over the nodes should be corrected.

    Parameters
    ----------
    gram : float64 (T, 6)
        For each triangle the upper half, row by row, of the 3 x 3 matrix of the sums of
        products of two barycentric coordinates over its pixels.
    moments : float64 (N, B)
        For each node the sums of its barycentric coordinate times what the pixels are
        above the surface.
    """

    gram: Floats
    moments: Floats


def normal_equations(
    nodes: Points,
    triangles: Triangles,
    values: Floats,
    bands: NDArray[Any],
    valid: NDArray[np.bool_],
    window: Window,
) -> NormalEquations:
    """Return the normal equations of the valid pixels in a window.

    Those of windows that share no pixel add up.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    values : float64 (N, B)
        At the nodes: the surface to correct.
    bands : any real dtype, (B, h, w)
        Values of the pixels of `window`.
    valid : bool (h, w)
    window : Window
    """
    gram, moments = np.zeros((len(triangles), 6)), np.zeros(values.shape)
    bands, valid = plain_bands(bands), np.ascontiguousarray(valid, dtype=np.bool_)
    start = np.ascontiguousarray(values, dtype=np.float64)
    project(nodes, triangles, start, bands, valid, window.row, window.col, gram, moments)
    return NormalEquations(gram, moments)


def solve(triangles: Triangles, equations: NormalEquations) -> Floats:
    """Return the correction at each node, (N, B), with which the pixels err least.

    It minimises the sum of the squared errors plus `RIDGE` times the sum of the squared
    corrections. So there is one solution, always: a node without a pixel in its triangles
    is left alone, and one that has few, all far from it, is not sent far away for a little.
    And the errors never grow, for at the start they are all there is. That weight costs
    0.002 dB where there is a node for five pixels, and nothing that shows where there are
    fewer.

    Solved by conjugate gradients, scaled by the diagonal: for such matrices the number of
    steps does not grow with the mesh (Wathen 1987).
    """
    from scipy import sparse
    from scipy.sparse.linalg import cg

    count = len(equations.moments)
    entries = (np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel())
    gram = sparse.csr_array((equations.gram[:, _FULL].ravel(), entries), shape=(count, count))
    matrix = gram + RIDGE * sparse.eye_array(count, format="csr")
    scale = sparse.diags_array(1 / matrix.diagonal())
    corrections = np.zeros_like(equations.moments)
    for band, moments in enumerate(equations.moments.T):
        largest = np.abs(moments).max(initial=0)
        if largest > 0:  # squares of values as they are may be beyond float64
            found, _ = cg(matrix, moments / largest, rtol=_TOLERANCE, atol=0.0, M=scale)
            corrections[:, band] = found * largest
    return corrections


def complete(
    values: Floats, triangles: Triangles, count: NDArray[np.int64], mean: Floats
) -> Floats:
    """Return values at nodes, (N, B), that every pixel's triangle has at all its corners.

    A node that has none (NaN), as there is no valid pixel around it, gets the mean of the
    valid pixels of its triangles. It stays NaN if these have none either.

    Parameters
    ----------
    values : float64 (N, B)
        At the nodes.
    triangles : int32 (T, 3)
    count : int64 (T,)
        Valid pixels of each triangle.
    mean : float64 (T, B)
        Of these.
    """
    empty = np.flatnonzero(np.isnan(values).any(axis=1))
    if not len(empty):
        return values
    rows = np.isin(triangles, empty).any(axis=1) & (count > 0)
    corners, weights = triangles[rows].ravel(), np.repeat(count[rows], 3)
    total = np.bincount(corners, weights, minlength=len(values))[empty]
    completed = values.copy()
    for band in range(values.shape[1]):
        products = weights * np.repeat(mean[rows, band], 3)
        sums = np.bincount(corners, products, minlength=len(values))[empty]
        with np.errstate(invalid="ignore"):
            completed[empty, band] = sums / total
    return completed


@dataclass(frozen=True, eq=False)
class Errors:
    """What a picture errs by; the errors of parts add up.

    Parameters
    ----------
    pixels : int
        Valid pixels that have a value in the picture.
    norm : float64 (B,)
        Root of the sum of the squared errors of these.
    low, high : float64 (B,)
        Least and greatest of their true values.
    """

    pixels: int
    norm: Floats
    low: Floats
    high: Floats

    def __add__(self, other: Errors) -> Errors:
        return Errors(
            self.pixels + other.pixels,
            np.hypot(self.norm, other.norm),
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
        )


def find_errors(image: NDArray[Any], bands: NDArray[Any], valid: NDArray[np.bool_]) -> Errors:
    """Return what a picture (B, h, w) errs by, where it is not NaN and `bands` are valid."""
    known = valid & ~np.isnan(image).any(axis=0)
    norm = np.zeros(len(bands))
    low, high = np.full(len(bands), np.inf), np.full(len(bands), -np.inf)
    for band, (shown, true) in enumerate(zip(image, bands, strict=True)):
        pixels = true[known].astype(np.float64)
        errors = np.abs(shown[known] - pixels)
        largest = errors.max(initial=0)
        if largest > 0:  # squares of errors as they are may be beyond float64
            norm[band] = largest * np.sqrt(np.square(errors / largest).sum())
        low[band], high[band] = pixels.min(initial=np.inf), pixels.max(initial=-np.inf)
    return Errors(int(known.sum()), norm, low, high)


def psnr(rmse: ArrayLike, peak: ArrayLike) -> Floats:
    """Return the peak signal-to-noise ratio in decibels: 20 log10(peak / rmse).

    Infinite where the root mean square error is 0.
    """
    rmse, peak = np.asarray(rmse, np.float64), np.asarray(peak, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        decibels: Floats = np.where(rmse == 0, np.inf, 20 * (np.log10(peak) - np.log10(rmse)))
    return decibels


def to_pixels(image: Floats, dtype: np.dtype[Any], nodata: float | None) -> NDArray[Any]:
    """Return a picture in the type of a raster.

    Parameters
    ----------
    image : float64 (B, h, w)
    dtype : numpy.dtype
        Integers are rounded; what is beyond the type's limits is cut off there.
    nodata : float or None
        What NaN becomes (0 if None). Any other pixel that would be it becomes the
        next value that the type has, as GDAL does when it warps.
    """
    limits = np.finfo(dtype) if dtype.kind == "f" else np.iinfo(dtype)
    least, most = float(limits.min), float(limits.max)
    if most > limits.max:  # 64 bits have no such float
        most = float(np.nextafter(most, 0))
    unknown = np.isnan(image)
    known = np.where(unknown, 0.0, image)
    pixels: NDArray[Any] = np.clip(known if dtype.kind == "f" else np.rint(known), least, most)
    pixels = pixels.astype(dtype)
    if nodata is not None:
        reserved = dtype.type(nodata)
        if dtype.kind == "f":
            other = np.nextafter(reserved, dtype.type(0 if reserved else 1))
        else:
            other = reserved + 1 if reserved < limits.max else reserved - 1
        pixels[pixels == reserved] = other
        pixels[unknown] = reserved
    return pixels
