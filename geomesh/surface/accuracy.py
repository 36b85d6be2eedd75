"""Accuracy: how far the valid pixels are from a mesh's surface, in all and triangle by triangle.

One walk over the pixels, tile by tile, in the raster's own units. It uses only the finished
arrays of the mesh, so it does not depend on how the surface was found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.jit import contiguous
from geomesh.arrays.plain import plain_json
from geomesh.arrays.table import read_only
from geomesh.errors import EmptyError
from geomesh.mesh.refinement import BandAccuracy
from geomesh.surface.fidelity import find_peak, psnr
from geomesh.surface.fit import Surface, SurfaceTile, walk
from geomesh.surface.kernels import measure_errors
from geomesh.surface.paint import check

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.parameters import Model
    from geomesh.raster.grid import Window
    from geomesh.raster.scene import Scene


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How far the valid pixels of a scene are from a surface; the arrays are read-only.

    All values but `psnr` are in the units of the band. A pixel at which the surface is not
    finite has an infinite error.

    Parameters
    ----------
    bands : tuple of str
        Names of the bands.
    pixels : int
        Number of valid pixels that a triangle owns: all of these are compared.
    max_error, rmse : float64 (B,)
        Greatest absolute error, and root mean square error.
    low, high : float64 (B,)
        Minimum and maximum of the compared pixels.
    peak, psnr : float64 (B,)
        As in `geomesh.surface.fidelity.Fidelity`.
    count : int64 (T,)
        Number of compared pixels of each triangle.
    triangle_max_error, triangle_rmse : float64 (B, T)
        Of the pixels of each triangle; NaN where `count` is 0.
    """

    bands: tuple[str, ...]
    pixels: int
    max_error: Floats
    rmse: Floats
    low: Floats
    high: Floats
    peak: Floats
    psnr: Floats
    count: Counts
    triangle_max_error: Floats
    triangle_rmse: Floats

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, read_only(value))

    def summary(self) -> dict[str, Any]:
        """Return the figures of each band as plain JSON values; what is infinite becomes None."""
        names = ("max_error", "rmse", "psnr", "peak")
        figures = zip(self.bands, *(getattr(self, name) for name in names), strict=True)
        bands = {band: dict(zip(names, rest, strict=True)) for band, *rest in figures}
        summary: dict[str, Any] = plain_json({"pixels": self.pixels, "bands": bands})
        return summary

    def of_bands(self) -> tuple[BandAccuracy, ...]:
        """Return the figures of each band for the provenance of a mesh."""
        figures = zip(self.bands, self.max_error, self.rmse, self.peak, strict=True)
        return tuple(BandAccuracy(name, *map(float, rest)) for name, *rest in figures)


@dataclass(frozen=True, eq=False)
class TileErrors:
    """The errors of the pixels of one tile.

    Parameters
    ----------
    index : int32 (K,)
        The triangles that own a valid pixel of the tile.
    count : int64 (K,)
        Number of these pixels.
    errors : float64 (B, 2, K)
        Their greatest error, and the square root of the sum of their squared errors.
    limits : float64 (B, 2)
        Minimum and maximum of all of them.
    """

    index: Ids
    count: Counts
    errors: Floats
    limits: Floats


def measure_accuracy(
    nodes: Points,
    triangles: Triangles,
    values: Floats,
    scene: Scene,
    workers: Workers,
    progress: Progress,
    *,
    model: Model,
) -> Accuracy:
    """Return how far the valid pixels of a scene are from a surface.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates in the scene's grid.
    triangles : int32 (T, 3)
    values : float64
        "linear": (N, B), at the nodes. "constant": (T, B), of the triangles.
    scene : Scene
        With B bands.
    workers : Workers
        The result is the same to the last bit for any workers.
    progress : callable(fraction, message)
    model : {"linear", "constant"}

    Raises
    ------
    ValueError
        If the model is unknown, or the shape of `values` does not fit.
    EmptyError
        If no valid pixel of the scene is in a triangle.
    """
    check(model=model)
    shape = (len(nodes if model == "linear" else triangles), len(scene.bands))
    if values.shape != shape:
        raise ValueError(f"values {values.shape} of a {model} model: expected {shape}")
    surface = Surface(nodes, triangles, contiguous(values, np.float64), model)
    work = walk(_measure_tile, surface, scene, workers, progress, "Measuring errors")
    return merge_errors(((part.triangle_ids, found) for part, found in work), len(triangles), scene)


def _measure_tile(task: SurfaceTile) -> TileErrors:
    scene, tile, surface = task
    bands, valid = scene.read(tile.core)
    return tile_errors(surface, bands, valid, tile.core)


def tile_errors(
    surface: Surface, bands: NDArray[Any], valid: NDArray[np.bool_], window: Window
) -> TileErrors:
    """Return the errors of the valid pixels in a window, band by band to save memory.

    Parameters
    ----------
    surface : Surface
    bands : any real dtype, (B, h, w)
        Values of the pixels of `window`.
    valid : bool (h, w)
    window : Window
    """
    nodes = contiguous(surface.nodes, np.float64)
    triangles = contiguous(surface.triangles, np.int32)
    rows = triangles if surface.model == "linear" else np.arange(len(triangles))[:, None]
    count = np.zeros(len(triangles), np.int64)
    errors = np.zeros((len(bands), 2, len(triangles)))
    limits = np.tile([math.inf, -math.inf], (len(bands), 1))
    for k, band in enumerate(bands):
        at_corners = np.broadcast_to(surface.values[rows, k], triangles.shape)
        measure_errors(
            nodes,
            triangles,
            contiguous(at_corners, np.float64),
            contiguous(band, np.float64),
            contiguous(valid, np.bool_),
            window.row,
            window.col,
            count,
            errors[k],
            limits[k],
        )
    own = np.flatnonzero(count)
    return TileErrors(own.astype(np.int32), count[own], errors[:, :, own], limits)


def merge_errors(
    parts: Iterable[tuple[Ids, TileErrors]], n_triangles: int, scene: Scene
) -> Accuracy:
    """Merge the errors of the tiles of a scene, in the given order.

    `parts` are pairs: the ids of a tile's triangles in the whole mesh, and their errors.
    """
    n_bands = len(scene.bands)
    count = np.zeros(n_triangles, np.int64)
    greatest, norm = np.zeros((2, n_bands, n_triangles))
    limits = np.tile([math.inf, -math.inf], (n_bands, 1))
    for triangle_ids, part in parts:
        t = triangle_ids[part.index]
        count[t] += part.count
        greatest[:, t] = np.maximum(greatest[:, t], part.errors[:, 0])
        norm[:, t] = np.hypot(norm[:, t], part.errors[:, 1])
        limits[:, 0] = np.minimum(limits[:, 0], part.limits[:, 0])
        limits[:, 1] = np.maximum(limits[:, 1], part.limits[:, 1])
    pixels = int(count.sum())
    if pixels == 0:
        raise EmptyError(
            f"no valid pixel of {scene.name} is in a triangle, so there is nothing to compare; "
            "use the raster from which the mesh was made"
        )
    low, high = limits.T
    rmse = np.array([_norm(each) for each in norm]) / math.sqrt(pixels)
    peak = find_peak(scene.dtype, low, high)
    none = count == 0
    triangle_rmse = norm / np.sqrt(np.maximum(count, 1))
    max_error = greatest.max(axis=1)
    greatest[:, none] = triangle_rmse[:, none] = np.nan
    return Accuracy(
        tuple(band.name for band in scene.bands),
        *(pixels, max_error, rmse, low, high, peak, psnr(rmse, peak)),
        *(count, greatest, triangle_rmse),
    )


def _norm(values: Floats) -> float:
    """Return the square root of the sum of squares of values >= 0, without overflow."""
    largest = float(values.max(initial=0))
    if not 0 < largest < math.inf:
        return largest
    return largest * math.sqrt(float(np.square(values / largest).sum()))
