"""Fit the values of a mesh surface to a raster, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import tee
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.raster.scene import Scene
from geomesh.surface.least_squares import NormalEquations, complete, normal_equations, solve
from geomesh.surface.paint import Fit, check, reconstruct
from geomesh.zonal.statistics import measure_scene
from geomesh.zonal.tile_mesh import TileMesh, split_by_tiles
from geomesh.zonal.tile_statistics import sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from geomesh.arrays.types import Floats, Points, Triangles
    from geomesh.parallel.workers import Workers
    from geomesh.parameters import Model
    from geomesh.raster.grid import Window

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh with values that can be painted as an image.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    values : float64
        Linear model: (N, B), at the nodes. Constant model: (T, B), of the triangles.
    model : {"linear", "constant"}
    """

    nodes: Points
    triangles: Triangles
    values: Floats
    model: Model

    def image(self, window: Window) -> Floats:
        """Return the image (B, h, w) in a window: see `geomesh.surface.paint.reconstruct`."""
        return reconstruct(self.nodes, self.triangles, self.values, window, self.model)

    def cut(self, part: TileMesh) -> Surface:
        """Return the part of the surface in a tile."""
        ids = part.node_ids if self.model == "linear" else part.triangle_ids
        return Surface(part.nodes, part.triangles, self.values[ids], self.model)


SurfaceTile = tuple[Scene, Tile, Surface]


def fit_surface(
    nodes: Points,
    triangles: Triangles,
    scene: Scene,
    *,
    model: Model = "linear",
    fit: Fit = "least_squares",
    workers: Workers,
    progress: Progress,
) -> Surface:
    """Return a mesh with values fitted to a scene.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates in the scene's grid.
    triangles : int32 (T, 3)
    scene : Scene
    model : {"linear", "constant"}
    fit : {"least_squares", "sampled"}
        "sampled": a node gets the bilinear interpolation between pixel centres. A triangle
        gets the value of the pixel that contains its centroid, or the mean of its valid
        pixels if that pixel is not valid. "least_squares": the values minimise the squared
        errors of the valid pixels; in the constant model, the value is the mean of the
        triangle's pixels. See `geomesh.surface.least_squares.solve`.
    workers : Workers
        The values are the same to the last bit for any workers.
    progress : callable(fraction, message)

    Returns
    -------
    Surface
        The values of nodes and triangles without valid pixels nearby are NaN.
    """
    check(model=model, fit=fit)
    statistics = measure_scene(nodes, triangles, scene, workers, part_of(progress, 0, 0.5))
    mean = np.ascontiguousarray(statistics.mean.T)
    more = part_of(progress, 0.5, 1)
    if model == "constant":
        surface = Surface(nodes, triangles, mean, model)
        return surface if fit == "least_squares" else _sampled(surface, scene, workers, more)
    values = complete(statistics.node_values.T, triangles, statistics.count, mean)
    surface = Surface(nodes, triangles, values, model)
    if fit == "sampled":
        return surface
    return replace(surface, values=fit_values(surface, scene, workers, more))


def fit_values(surface: Surface, scene: Scene, workers: Workers, progress: Progress) -> Floats:
    """Return the node values (N, B) of a linear surface that minimise the squared errors.

    See `geomesh.surface.least_squares.solve`. The values of `surface` are the start.
    """
    gram = np.zeros((len(surface.triangles), 6))
    moments = np.zeros(surface.values.shape)
    work = walk(_project_tile, surface, scene, workers, part_of(progress, 0, 0.9), "Fitting nodes")
    for part, found in work:
        gram[part.triangle_ids] += found.gram
        moments[part.node_ids] += found.moments
    progress(0.9, "Fitting nodes: solving")
    corrections = solve(surface.triangles, NormalEquations(gram, moments))
    fitted: Floats = surface.values + corrections
    return fitted


def _project_tile(task: SurfaceTile) -> NormalEquations:
    scene, tile, surface = task
    bands, valid = scene.read(tile.core)
    return normal_equations(
        surface.nodes, surface.triangles, surface.values, bands, valid, tile.core
    )


def _sampled(surface: Surface, scene: Scene, workers: Workers, progress: Progress) -> Surface:
    """Return the surface with the value of the pixel at each centroid, if that is valid."""
    values = surface.values.copy()
    work = walk(_sample_tile, surface, scene, workers, progress, "Sampling centroids")
    for part, found in work:
        known = ~np.isnan(found).any(axis=1)
        values[part.triangle_ids[known]] = found[known]
    return replace(surface, values=values)


def _sample_tile(task: SurfaceTile) -> Floats:
    scene, tile, surface = task
    bands, valid = scene.read(tile.core)
    x, y = surface.nodes[surface.triangles].mean(axis=1).T
    return sample(x, y, bands, valid, tile.core).T


def walk(
    function: Callable[[SurfaceTile], Result],
    surface: Surface,
    scene: Scene,
    workers: Workers,
    progress: Progress,
    message: str,
) -> Iterator[tuple[TileMesh, Result]]:
    """Yield the part of the mesh in each tile, with the result of `function`, in tile order.

    `function` gets the scene, a tile without halo, and the part of the surface in that tile.
    """
    tiles = plan_tiles(scene.grid.extent, halo=0)
    parts, kept = tee(split_by_tiles(surface.nodes, surface.triangles, tiles))
    tasks = (
        (scene.excerpt(tile.core), tile, surface.cut(part))
        for tile, part in zip(tiles, parts, strict=True)
    )
    results = map_tiles(function, tasks, len(tiles), workers, progress=progress, message=message)
    return zip(kept, results, strict=True)
