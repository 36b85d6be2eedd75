"""Paint a mesh: turn values at its nodes or of its triangles into the pixels of an image.

There are two models. "linear" interpolates linearly in each triangle between values at the
nodes; "constant" has one value per triangle. There are two fits, ways to get the values from
the raster. "sampled" takes them at one place; "least_squares" minimises the squared errors of
the pixels. A mesh may also have values of its own: see `geomesh.surface.stored`.

The functions here work on arrays, for one window at a time. `geomesh.surface.fit` and
`geomesh.surface.fidelity` use them for the tiles of a scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geomesh.arrays.jit import contiguous
from geomesh.parameters import MODELS, Model
from geomesh.raster.nodata import is_nodata, stored_range

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points, Triangles
    from geomesh.raster.grid import Window
    from geomesh.raster.nodata import Number

Fit = Literal["least_squares", "sampled"]
FITS: tuple[Fit, ...] = ("least_squares", "sampled")


def reconstruct(
    nodes: Points, triangles: Triangles, values: Floats, window: Window, model: Model
) -> Floats:
    """Return the image of a mesh in a window.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
        In either orientation.
    values : float64
        "linear": (N, B), at the nodes; a pixel gets the value at its centre of the plane
        through the three corners of its triangle. "constant": (T, B), of the triangles.
    window : Window
    model : {"linear", "constant"}

    Returns
    -------
    float64 (B, height, width)
        NaN where no triangle owns the pixel (see `geomesh.zonal.rasterize`), or where the
        value is NaN.

    Raises
    ------
    ValueError
        If the model is unknown, or `values` does not have one row per node or triangle.
    """
    check(model=model)
    rows = len(nodes) if model == "linear" else len(triangles)
    if values.ndim != 2 or len(values) != rows:
        raise ValueError(f"values {values.shape} of a {model} model: expected ({rows}, bands)")
    # Imported here: to make a mesh, these kernels need not be compiled.
    if model == "constant":
        from geomesh.zonal.owners import find_owners

        # A pixel without an owner has the id FILL, which is -1: it gets the last row, NaN.
        padded = np.vstack([values, np.full(values.shape[1], np.nan)])
        return np.ascontiguousarray(
            np.moveaxis(padded[find_owners(nodes, triangles, window)], -1, 0)
        )
    from geomesh.surface.paint_kernel import paint_linear

    image = np.full((values.shape[1], *window.shape), np.nan)
    paint_linear(
        contiguous(nodes, np.float64),
        contiguous(triangles, np.int32),
        contiguous(values, np.float64),
        window.row,
        window.col,
        image,
    )
    return image


def check(*, model: str = MODELS[0], fit: str = FITS[0]) -> None:
    """Raise ValueError if the model or the fit is unknown."""
    if model not in MODELS:
        raise ValueError(f"model is {model!r}: choose {' or '.join(MODELS)}")
    if fit not in FITS:
        raise ValueError(f"fit is {fit!r}: choose {' or '.join(FITS)}")


def to_pixels(image: Floats, dtype: np.dtype[Any], nodata: Number | None) -> NDArray[Any]:
    """Return an image in the data type of a raster.

    Parameters
    ----------
    image : float64 (B, h, w)
    dtype : numpy.dtype
        For integers, values are rounded. Values outside the limits of the type are clipped.
    nodata : int, float or None
        A value of the type. Replaces NaN (0 if None). Any other pixel that equals it gets the
        next value of the type that does not, as GDAL does when it warps.
    """
    limits = np.finfo(dtype) if dtype.kind == "f" else np.iinfo(dtype)
    least, most = float(limits.min), float(limits.max)
    if most > limits.max:  # as a float, the limit of a 64-bit integer is rounded up
        most = float(np.nextafter(most, 0))
    unknown = np.isnan(image)
    known = np.where(unknown, 0.0, image)
    pixels: NDArray[Any] = np.clip(known if dtype.kind == "f" else np.rint(known), least, most)
    pixels = pixels.astype(dtype)
    if nodata is not None:
        reserved = dtype.type(nodata)
        if dtype.kind == "f":
            low, high = stored_range(dtype, nodata) or (reserved, reserved)
            other = np.nextafter(high if reserved <= 0 else low, dtype.type(0 if reserved else 1))
        else:
            other = reserved + 1 if reserved < limits.max else reserved - 1
        pixels[is_nodata(pixels, nodata)] = other
        pixels[unknown] = reserved
    return pixels
