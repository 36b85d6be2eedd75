"""A mesh as a surface of values, fitted to its raster tile by tile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import tee
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.raster.scene import Scene
from geomesh.surface.least_squares import NormalEquations, complete, normal_equations, solve
from geomesh.surface.paint import Fit, Model, check, reconstruct
from geomesh.zonal.statistics import measure_scene, sample
from geomesh.zonal.tile_mesh import TileMesh, split_by_tiles

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from geomesh.arrays.types import Floats, Points, Triangles
    from geomesh.parallel.workers import Workers
    from geomesh.raster.grid import Window

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh with the values that make a picture of it.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    values : float64
        (N, B) at the nodes for the linear model, (T, B) of the triangles for the constant one.
    model : {"linear", "constant"}
    """

    nodes: Points
    triangles: Triangles
    values: Floats
    model: Model

    def image(self, window: Window) -> Floats:
        """Return the picture (B, h, w) in a window: see `geomesh.surface.paint.reconstruct`."""
        return reconstruct(self.nodes, self.triangles, self.values, window, self.model)

    def cut(self, part: TileMesh) -> Surface:
        """Return the part of it in a tile."""
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
    """Return a mesh with the values that show a scene.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates in the scene's grid.
    triangles : int32 (T, 3)
    scene : Scene
    model : {"linear", "constant"}
    fit : {"least_squares", "sampled"}
        "sampled": bilinear between pixel centres at a node; of the pixel that holds the
        centroid of a triangle, or the mean of its valid pixels if that is not valid.
        "least_squares": so that the squared errors of the valid pixels are least; for a
        triangle of one value that is their mean. See `geomesh.surface.least_squares.solve`.
    workers : Workers
        The values are the same to the last bit whoever does the work.
    progress : callable(fraction, message)

    Returns
    -------
    Surface
        NaN at the nodes, and of the triangles, near which no pixel is valid.
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
    return surface if fit == "sampled" else _corrected(surface, scene, workers, more)


def _corrected(surface: Surface, scene: Scene, workers: Workers, progress: Progress) -> Surface:
    """Return the surface over the nodes with which the pixels err least."""
    gram = np.zeros((len(surface.triangles), 6))
    moments = np.zeros(surface.values.shape)
    work = walk(_project_tile, surface, scene, workers, part_of(progress, 0, 0.9), "Fitting nodes")
    for part, found in work:
        gram[part.triangle_ids] += found.gram
        moments[part.node_ids] += found.moments
    progress(0.9, "Fitting nodes: solving")
    corrections = solve(surface.triangles, NormalEquations(gram, moments))
    return replace(surface, values=surface.values + corrections)


def _project_tile(task: SurfaceTile) -> NormalEquations:
    scene, tile, surface = task
    bands, valid = scene.read(tile.core)
    return normal_equations(
        surface.nodes, surface.triangles, surface.values, bands, valid, tile.core
    )


def _sampled(surface: Surface, scene: Scene, workers: Workers, progress: Progress) -> Surface:
    """Return the surface with the pixel at each triangle's centroid, where that is valid."""
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
    """Yield the part of the mesh in each tile and what `function` gives there, in their order.

    It gets the scene, a tile without halo, and the part of the surface there.
    """
    tiles = plan_tiles(scene.grid.extent, halo=0)
    parts, kept = tee(split_by_tiles(surface.nodes, surface.triangles, tiles))
    tasks = (
        (scene.excerpt(tile.core), tile, surface.cut(part))
        for tile, part in zip(tiles, parts, strict=True)
    )
    results = map_tiles(function, tasks, len(tiles), workers, progress=progress, message=message)
    return zip(kept, results, strict=True)
