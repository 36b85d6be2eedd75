"""Evaluate presets and baselines on any images, as in the paper's Table 1."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from geomesh.delaunay.triangulate import delaunay
from geomesh.errors import EmptyError, GeomeshError, GeomeshWarning, one_line
from geomesh.evaluate.baselines import GREEDY, has_pydelatin
from geomesh.evaluate.comparison import MEASURES, Comparison, Failure, Figures, Record
from geomesh.evaluate.images import find_images
from geomesh.evaluate.planes import PLANES, Plane, PlaneMesh
from geomesh.mesh.quality import ki, measure
from geomesh.parallel.progress import Progress, reporting, silent
from geomesh.parallel.workers import Workers, open_workers
from geomesh.parameters import MODELS, Model
from geomesh.raster.open import open_scene
from geomesh.surface.fidelity import compare
from geomesh.surface.fit import fit_surface
from geomesh.surface.paint import FITS, Fit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from concurrent.futures import Executor

    from geomesh.parameters import Alpha
    from geomesh.raster.grid import Grid
    from geomesh.raster.scene import Scene


def evaluate(
    sources: str | PathLike[str] | Iterable[str | PathLike[str]],
    *,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    alpha: Alpha = "mask",
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | Progress = False,
) -> Comparison:
    """Measure the presets and the baselines on images.

    Parameters
    ----------
    sources : path, or iterable of paths
        Files, folders and patterns: see `geomesh.evaluate.images.find_images`.
    bidx : sequence of int, optional
        1-based bands to use; by default all except alpha.
    nodata : float, optional
        Replaces the nodata values of the files.
    alpha : {"mask", "data"}
        As in `geomesh.mesh_raster`.
    workers : int, optional
        Number of images to process at the same time; by default one per core. The figures
        are the same to the last bit for any number of workers.
    executor : concurrent.futures.Executor, optional
        Used instead of geomesh's own threads.
    progress : bool or callable(fraction, message)
        True shows a progress bar; a callable may raise an exception to cancel.

    Returns
    -------
    Comparison
        An image that fails is in `failures`; the other images are evaluated anyway.

    Raises
    ------
    SourceError
        If there is nothing to evaluate.

    Examples
    --------
    >>> from geomesh.evaluate.run import evaluate
    >>> comparison = evaluate("data_samples/olinda_landsat7_rgb_uint8.tif")
    >>> found = {average.method: average.mean for average in comparison.overall()[:5]}
    >>> round(found["paper"].ki, 2), round(found["random"].ki, 2)
    (11.25, 12.41)
    """
    named = [sources] if isinstance(sources, str | PathLike) else sources
    images = find_images(named)
    if not has_pydelatin():
        why = "pydelatin is not installed (pip install 'geomesh-toolkit[evaluate]')"
        warnings.warn(f"{why}: {GREEDY} is left out", GeomeshWarning, stacklevel=2)
    with reporting(progress) as report, open_workers(workers, executor) as pool:
        report(0.0, f"Evaluating {len(images)} images")
        parts = []
        for part in pool.map(_EvaluateImage(bidx, nodata, alpha), images):
            parts.append(part)
            report(len(parts) / len(images), f"Evaluating: image {len(parts)} of {len(images)}")
    comparison = Comparison(
        tuple(record for part in parts for record in part.records),
        tuple(failure for part in parts for failure in part.failures),
    )
    for (image, plane), methods in _without_mesh(comparison).items():
        why = f"no nodes that span an area in the plane {plane}"
        missing = f"no figures of {', '.join(methods)}"
        warnings.warn(f"{image}: {why}, so {missing}", GeomeshWarning, stacklevel=2)
    return comparison


def _without_mesh(comparison: Comparison) -> dict[tuple[str, str], list[str]]:
    """Return the methods without any triangle, by image and plane."""
    found: dict[tuple[str, str], list[str]] = {}
    for record in comparison.records:
        if not record.figures.triangles:
            found.setdefault((record.image, record.plane), []).append(record.method)
    return found


@dataclass(frozen=True)
class _EvaluateImage:
    """Evaluate one image; errors are part of the result, so that other images continue."""

    bidx: Sequence[int] | None
    nodata: float | None
    alpha: Alpha

    def __call__(self, image: str) -> Comparison:
        records: list[Record] = []
        failures: list[Failure] = []
        try:
            scene = open_scene(image, bidx=self.bidx, nodata=self.nodata, alpha=self.alpha)
            # Own threads: a worker that waits for tasks in its own pool could wait forever.
            with open_workers(1) as workers, scene.open():
                for name, find_plane in PLANES.items():
                    try:
                        records += _records(image, name, find_plane(scene, workers), workers)
                    except GeomeshError as error:
                        failures.append(_failure(image, name, error))
        except Exception as error:  # an unexpected error in one image must not stop the others
            failures.append(_failure(image, "", error))
        return Comparison(tuple(records), tuple(failures))


def _failure(image: str, plane: str, error: Exception) -> Failure:
    if isinstance(error, GeomeshError):
        return Failure(image, plane, str(error), error.code)
    why, code = f"{type(error).__name__}: {one_line(error)} (a defect of geomesh)", "internal"
    if isinstance(error, MemoryError):
        why, code = "not enough memory; use fewer workers", "memory"
    return Failure(image, plane, " ".join(f"{image}: {why}".splitlines()), code)


def _records(image: str, name: str, plane: Plane, workers: Workers) -> Iterator[Record]:
    height, width = plane.gray.shape
    for method, mesh in plane.meshes():
        figures = measure_figures(plane, mesh, workers)
        yield Record(image, name, method, width, height, plane.wanted, figures)


def measure_figures(plane: Plane, mesh: PlaneMesh, workers: Workers) -> Figures:
    """Return the figures of a mesh in a plane."""
    points, triangles = mesh
    height, width = plane.gray.shape
    if not len(triangles):
        return Figures(**{**dict.fromkeys(MEASURES, math.nan), "nodes": 0.0, "triangles": 0.0})
    summary = measure(points, triangles, size=(width, height)).summary()
    measures, sides = summary["measures"], summary["mean_sides"]
    angles = measures["min_angle"]
    return Figures(
        nodes=float(len(points)),
        triangles=float(len(triangles)),
        **sides,
        ki=measures["ki"]["mean"],
        ki_mean=measures["ki_mean"]["mean"],
        ki_min=measures["ki_min"]["mean"],
        ki_median=measures["ki"]["median"],
        ki_of_sides=float(ki(**sides)),
        ki_normalised=summary["ki_normalised"],
        angle_mean=angles["mean"],
        angle_median=angles["median"],
        angle_p5=angles["p5"],
        angle_under_10=summary["share_min_angle_under"]["10"],
        **_fidelity(plane, mesh, workers),
    )


def _fidelity(plane: Plane, mesh: PlaneMesh, workers: Workers) -> dict[str, float]:
    """Return the share of valid pixels in triangles, and PSNR of these and of all pixels."""
    scene = open_scene((np.ma.array(plane.gray, mask=~plane.valid), None, None))
    figures = {}
    for model in MODELS:
        for fit in FITS:
            figures[f"psnr_{model}_{fit}"], pixels = _psnr(mesh, scene, model, fit, workers)
    figures["covered"] = pixels / np.count_nonzero(plane.valid)
    figures["psnr_whole"] = figures["psnr_linear_least_squares"]
    if figures["covered"] < 1:
        spread = _with_corners(mesh, scene.grid)
        figures["psnr_whole"], _ = _psnr(spread, scene, "linear", "least_squares", workers)
    return figures


def _psnr(
    mesh: PlaneMesh, scene: Scene, model: Model, fit: Fit, workers: Workers
) -> tuple[float, int]:
    """Return PSNR in dB, and the number of pixels."""
    surface = fit_surface(*mesh, scene, model=model, fit=fit, workers=workers, progress=silent)
    try:
        found = compare(surface, scene, workers, silent)
    except EmptyError:  # the triangles are so small that they contain no pixel centre
        return math.nan, 0
    return found.overall, found.pixels


def _with_corners(mesh: PlaneMesh, grid: Grid) -> PlaneMesh:
    """Return the Delaunay triangulation of the nodes together with the image's corners."""
    w, h = grid.width, grid.height
    points = np.unique(np.concatenate([mesh[0], [(0, 0), (w, 0), (0, h), (w, h)]]), axis=0)
    return points, delaunay(points).triangles
