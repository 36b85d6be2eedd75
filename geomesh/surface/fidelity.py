"""Fidelity: how well a mesh shows its raster, as PSNR and errors, tile by tile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.plain import plain_json
from geomesh.errors import EmptyError
from geomesh.parallel.progress import Progress, part_of, reporting
from geomesh.parallel.workers import Workers, open_workers
from geomesh.surface.fit import Surface, SurfaceTile, walk
from geomesh.surface.original import open_original
from geomesh.surface.stored import choose, find_surface

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from geomesh.arrays.types import Floats
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import Alpha, Model
    from geomesh.raster.open import Source
    from geomesh.raster.scene import Scene
    from geomesh.surface.stored import Shown


@dataclass(frozen=True)
class Fidelity:
    """How well a mesh shows its raster.

    Only the valid pixels of the raster that a triangle owns are compared.

    Parameters
    ----------
    bands : tuple of str
    pixels : int
        Number of pixels that were compared.
    peak : tuple of float
        The reference value of PSNR for each band: 255 for uint8, else the maximum minus
        the minimum of the compared pixels.
    rmse, psnr : tuple of float
        Root mean square error in the units of the band, and peak signal-to-noise ratio in
        decibels: 20 log10(peak / rmse), infinite if there is no error.
    overall : float
        PSNR of all bands together, from the mean of their (rmse / peak)^2.
    """

    bands: tuple[str, ...]
    pixels: int
    peak: tuple[float, ...]
    rmse: tuple[float, ...]
    psnr: tuple[float, ...]
    overall: float

    def summary(self) -> dict[str, Any]:
        """Return the fidelity as plain JSON values; an infinite PSNR becomes None."""
        figures = zip(self.bands, self.psnr, self.rmse, self.peak, strict=True)
        summary: dict[str, Any] = plain_json(
            {
                "pixels": self.pixels,
                "psnr": self.overall,
                "bands": {
                    name: {"psnr": decibels, "rmse": rmse, "peak": peak}
                    for name, decibels, rmse, peak in figures
                },
            }
        )
        return summary


def measure_fidelity(
    mesh: TriangleMesh,
    source: Source,
    *,
    model: Model | None = None,
    fit: Shown | None = None,
    bidx: Sequence[int] | None = None,
    alpha: Alpha | None = None,
    crs: Any = None,
    workers: int | None = None,
    progress: bool | Progress = False,
) -> Fidelity:
    """Return how well a mesh shows a raster: see `geomesh.Mesh.psnr`.

    Parameters
    ----------
    mesh : TriangleMesh
    source : str, PathLike, rasterio dataset, or (array, transform, crs)
        The raster from which the mesh was made, or another raster with the same pixels; it
        may be larger than the mesh.
    model : {"linear", "constant"}, optional
        Linear interpolation in each triangle between values at the nodes, or one value per
        triangle. Default: the model of a refined mesh, else linear.
    fit : {"least_squares", "sampled", "stored"}, optional
        How the values are computed from the raster: see `geomesh.surface.fit.fit_surface`.
        "stored": they are those in the columns of the mesh, at the nodes or, in the constant
        model, `<band>_mean`. Default: stored if the mesh was refined for this model and
        `bidx` is not given, else least_squares.
    bidx : sequence of int, optional
        1-based bands to use instead of the bands from which the mesh was made.
    alpha : {"mask", "data"}, optional
        As in `geomesh.mesh_raster`. Default: as when the mesh was made.
    crs : str, int or pyproj.CRS, optional
        Replaces the CRS of the raster, as when the mesh was made.
    workers, progress
        As in `geomesh.mesh_raster`.

    Raises
    ------
    GeomeshError
        If the raster cannot be read, the mesh does not have its pixels, no valid pixel is in
        a triangle, or the mesh has no stored values.

    Examples
    --------
    >>> import geomesh
    >>> scene = "data_samples/olinda_landsat7_rgb_uint8.tif"
    >>> fidelity = geomesh.mesh_raster(scene).psnr(scene)
    >>> round(fidelity.overall, 1)
    29.7
    """
    scene = open_original(mesh, source, bidx=bidx, alpha=alpha, crs=crs)
    model, fit = choose(mesh, model, fit, bidx)
    share = 0.0 if fit == "stored" else 0.7
    with reporting(progress) as report, open_workers(workers) as pool, scene.open():
        surface = find_surface(
            mesh,
            scene,
            model=model,
            fit=fit,
            bidx=bidx,
            workers=pool,
            progress=part_of(report, 0, share),
        )
        return compare(surface, scene, pool, part_of(report, share, 1))


def compare(surface: Surface, scene: Scene, workers: Workers, progress: Progress) -> Fidelity:
    """Return how well a surface shows a scene.

    Raises
    ------
    EmptyError
        If no valid pixel of the scene is in a triangle.
    """
    work = walk(_compare_tile, surface, scene, workers, progress, "Comparing")
    return summarise(scene, (errors for _, errors in work))


def _compare_tile(task: SurfaceTile) -> ErrorSums:
    scene, tile, surface = task
    bands, valid = scene.read(tile.core)
    return sum_errors(surface.image(tile.core), bands, valid)


def summarise(scene: Scene, parts: Iterable[ErrorSums]) -> Fidelity:
    """Return the fidelity of a scene from the errors of its tiles, added in the given order."""
    errors = reduce(add, parts)
    if errors.pixels == 0:
        raise EmptyError(
            f"no valid pixel of {scene.name} is in a triangle, so there is nothing to compare; "
            "use the raster from which the mesh was made"
        )
    rmse = errors.norm / math.sqrt(errors.pixels)
    peak = find_peak(scene.dtype, errors.low, errors.high)
    # A band with only one value has no range; then it usually has no error either.
    share = np.divide(rmse, peak, out=rmse.copy(), where=peak > 0)
    return Fidelity(
        bands=tuple(band.name for band in scene.bands),
        pixels=errors.pixels,
        peak=tuple(peak.tolist()),
        rmse=tuple(rmse.tolist()),
        psnr=tuple(psnr(rmse, peak).tolist()),
        overall=float(psnr(math.sqrt(np.square(share).mean()), 1.0)),
    )


@dataclass(frozen=True, eq=False)
class ErrorSums:
    """The errors of an image; the sums of several tiles can be added.

    Parameters
    ----------
    pixels : int
        Number of valid pixels that have a value in the image.
    norm : float64 (B,)
        Square root of the sum of the squared errors of these pixels.
    low, high : float64 (B,)
        Minimum and maximum of their true values.
    """

    pixels: int
    norm: Floats
    low: Floats
    high: Floats

    def __add__(self, other: ErrorSums) -> ErrorSums:
        return ErrorSums(
            self.pixels + other.pixels,
            np.hypot(self.norm, other.norm),
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
        )


def sum_errors(image: NDArray[Any], bands: NDArray[Any], valid: NDArray[np.bool_]) -> ErrorSums:
    """Return the errors of an image (B, h, w) where it is not NaN and `bands` are valid."""
    known = valid & ~np.isnan(image).any(axis=0)
    norm = np.zeros(len(bands))
    low, high = np.full(len(bands), np.inf), np.full(len(bands), -np.inf)
    for band, (shown, true) in enumerate(zip(image, bands, strict=True)):
        pixels = true[known].astype(np.float64)
        errors = np.abs(shown[known] - pixels)
        largest = errors.max(initial=0)
        if largest > 0:  # scaled, because squares of large errors could overflow
            norm[band] = largest * np.sqrt(np.square(errors / largest).sum())
        low[band], high[band] = pixels.min(initial=np.inf), pixels.max(initial=-np.inf)
    return ErrorSums(int(known.sum()), norm, low, high)


def find_peak(dtype: np.dtype[Any], low: Floats, high: Floats) -> Floats:
    """Return the reference value of PSNR for each band: 255 for uint8, else its range."""
    return np.full(len(low), 255.0) if dtype == np.uint8 else high - low


def psnr(rmse: ArrayLike, peak: ArrayLike) -> Floats:
    """Return the peak signal-to-noise ratio in decibels: 20 log10(peak / rmse).

    It is infinite where the root mean square error is 0.
    """
    rmse, peak = np.asarray(rmse, np.float64), np.asarray(peak, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        decibels: Floats = np.where(rmse == 0, np.inf, 20 * (np.log10(peak) - np.log10(rmse)))
    return decibels
