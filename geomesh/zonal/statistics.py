"""What the raster holds in each triangle and at each node.

A scene is measured tile by tile (`measure_scene`): each by itself (`measure_tile`),
and the partial results are merged in the order of the tile plan (`merge`), so that
the outcome is the same to the last bit whichever process measured which tile.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import plain_bands
from geomesh.arrays.table import read_only
from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
from geomesh.parallel.progress import Progress
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.parallel.workers import Workers
from geomesh.raster.grid import Window
from geomesh.raster.scene import Scene
from geomesh.zonal.kernels import add, bin_triangles, blend, near_box, scan_triangles


@dataclass(frozen=True, eq=False)
class TilePartial:
    """What one tile adds to the statistics of a mesh.

    Parameters
    ----------
    index : int32 (K,)
        The triangles that may own a pixel of the tile's core, each once.
    pixels, count : int64 (K,)
        Pixels of the core that they do own, and the valid ones among them.
    moments : float64 (4, B, K)
        Mean, sum of squared deviations from it, least and greatest value of the
        valid pixels; without meaning where the count is 0.
    centroid_index : int32 (C,)
        The triangles without valid pixel here whose centroid lies in the core.
    centroid_values : float64 (B, C)
        Value of the pixel that holds the centroid, NaN if it is not valid.
    node_index : int32 (M,)
        The nodes in the core.
    node_values : float64 (B, M)
        Value at the node, NaN if no pixel around it is valid.
    """

    index: Ids
    pixels: Counts
    count: Counts
    moments: Floats
    centroid_index: Ids
    centroid_values: Floats
    node_index: Ids
    node_values: Floats


@dataclass(frozen=True, eq=False)
class TileMesh:
    """The part of a mesh that meets the core of a tile.

    Parameters
    ----------
    nodes : float64 (n, 2)
    triangles : int32 (K, 3)
        Indices into `nodes`.
    node_ids : int32 (n,)
    triangle_ids : int32 (K,)
        What they are called in the mesh.
    """

    nodes: Points
    triangles: Triangles
    node_ids: Ids
    triangle_ids: Ids

    def measure(
        self, bands: NDArray[Any], valid: NDArray[np.bool_], window: Window, core: Window
    ) -> TilePartial:
        """Return what the tile adds to the statistics of the mesh: see `measure_tile`."""
        part = measure_tile(self.nodes, self.triangles, bands, valid, window, core)
        return replace(
            part,
            index=self.triangle_ids[part.index],
            centroid_index=self.triangle_ids[part.centroid_index],
            node_index=self.node_ids[part.node_index],
        )


def split_by_tiles(
    nodes: Points, triangles: Triangles, tiles: Sequence[Tile]
) -> Iterator[TileMesh]:
    """Yield the share of each tile, in their order, made one at a time.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    tiles : sequence of Tile
        A whole plan: row by row, as `geomesh.parallel.tiles.plan_tiles` has it.
    """
    cols = np.unique([tile.core.col for tile in tiles]).astype(np.float64)
    rows = np.unique([tile.core.row for tile in tiles]).astype(np.float64)
    starts, met = bin_triangles(nodes, triangles, cols, rows)
    for start, stop in pairwise(starts):
        ids = met[start:stop]
        node_ids, local = np.unique(triangles[ids], return_inverse=True)
        yield TileMesh(nodes[node_ids], local.reshape(-1, 3).astype(np.int32), node_ids, ids)


@dataclass(frozen=True, eq=False)
class Statistics:
    """Band statistics of a mesh; read-only.

    Parameters
    ----------
    pixels, count : int64 (T,)
        Pixels whose centre the triangle owns, and the valid ones among them.
    mean, std, min, max : float64 (B, T)
        Of the valid pixels; `std` is that of the population (divided by the
        count). A triangle without valid pixel has the value of the pixel that
        holds its centroid and `std` 0; NaN if that is not valid either.
    node_values : float64 (B, N)
        Bilinear between pixel centres, over the valid ones; NaN where none is.
    """

    pixels: Counts
    count: Counts
    mean: Floats
    std: Floats
    min: Floats
    max: Floats
    node_values: Floats

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, read_only(getattr(self, field.name)))


def measure_scene(
    nodes: Points, triangles: Triangles, scene: Scene, workers: Workers, progress: Progress
) -> Statistics:
    """Return what a scene holds in each triangle and at each node of a mesh of it."""
    tiles = plan_tiles(scene.grid.extent, halo=1)
    shares = zip(tiles, split_by_tiles(nodes, triangles, tiles), strict=True)
    partials = map_tiles(
        _read_and_measure,
        ((scene.excerpt(tile.read), tile, share) for tile, share in shares),
        len(tiles),
        workers,
        progress=progress,
        message="Measuring triangles",
    )
    return merge(partials, len(triangles), len(nodes), len(scene.bands))


def _read_and_measure(task: tuple[Scene, Tile, TileMesh]) -> TilePartial:
    scene, tile, share = task
    bands, valid = scene.read(tile.read)
    return share.measure(bands, valid, tile.read, tile.core)


def measure_tile(
    nodes: Points,
    triangles: Triangles,
    bands: NDArray[Any],
    valid: NDArray[np.bool_],
    window: Window,
    core: Window,
) -> TilePartial:
    """Measure the pixels, centroids and nodes in the core of a tile.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates of the whole mesh.
    triangles : int32 (T, 3)
        All triangles, of either orientation.
    bands : any real dtype, (B, h, w)
        Values as read, finite where valid; taken as float64.
    valid : bool (h, w)
    window : Window
        What `bands` and `valid` cover: the core and at least one pixel around it,
        save where the image ends. A core without a pixel beyond it on some side
        is taken to end with the image there.
    core : Window
        The pixels that this tile answers for.

    Raises
    ------
    ValueError
        If the shapes do not fit the window, or the core is not inside it.
    """
    if bands.ndim != 3 or bands.shape[1:] != window.shape or valid.shape != window.shape:
        raise ValueError(f"bands {bands.shape} and valid {valid.shape} do not cover {window}")
    if window.clip(core) != core:
        raise ValueError(f"the core {core} is not inside {window}")
    bands, valid = plain_bands(bands), np.ascontiguousarray(valid, dtype=np.bool_)
    near = near_box(nodes, triangles, (core.col, core.stop_col, core.row, core.stop_row))
    pixels, count = np.zeros((2, len(near)), np.int64)
    moments = np.zeros((4, len(bands), len(near)))
    origin = (window.row, window.col)
    box = (core.row, core.stop_row, core.col, core.stop_col)
    flat = bands.reshape(len(bands), -1)
    scan_triangles(nodes, triangles, near, flat, valid, origin, box, pixels, count, moments)
    without = near[count == 0]
    centroids = nodes[triangles[without]].mean(axis=1)
    held = _inside(centroids, window, core)
    mine = np.flatnonzero(_inside(nodes, window, core)).astype(np.int32)
    node_values = np.empty((len(bands), len(mine)))
    blend(nodes[mine], bands, valid, origin, node_values)
    return TilePartial(
        index=near,
        pixels=pixels,
        count=count,
        moments=moments,
        centroid_index=without[held],
        centroid_values=sample(centroids[held, 0], centroids[held, 1], bands, valid, window),
        node_index=mine,
        node_values=node_values,
    )


def merge(
    partials: Iterable[TilePartial], n_triangles: int, n_nodes: int, n_bands: int
) -> Statistics:
    """Merge the partial results of the tiles of an image, in the order given.

    Means and squared deviations are combined pairwise (Chan, Golub and LeVeque
    1983), so that no squares of the values themselves are ever subtracted.
    """
    pixels, count = np.zeros((2, n_triangles), np.int64)
    moments = np.zeros((4, n_bands, n_triangles))
    moments[2:] = np.array([np.inf, -np.inf])[:, None, None]
    centroid = np.full((n_bands, n_triangles), np.nan)
    node_values = np.full((n_bands, n_nodes), np.nan)
    for part in partials:
        add(part.index, part.pixels, part.count, part.moments, pixels, count, moments)
        centroid[:, part.centroid_index] = part.centroid_values
        node_values[:, part.node_index] = part.node_values
    mean, m2, low, high = moments
    std = np.sqrt(m2 / np.maximum(count, 1))
    none = np.flatnonzero(count == 0)
    for result in (mean, low, high):
        result[:, none] = centroid[:, none]
    std[:, none] = np.where(np.isnan(centroid[:, none]), np.nan, 0.0)
    return Statistics(pixels, count, mean, std, low, high, node_values)


def _inside(points: Points, window: Window, core: Window) -> NDArray[np.bool_]:
    """Tell which points the core holds: half-open, but without limit where the image ends.

    So a node on the image's right or lower border has a tile, too.
    """
    left = -np.inf if core.col == window.col else core.col
    right = np.inf if core.stop_col == window.stop_col else core.stop_col
    top = -np.inf if core.row == window.row else core.row
    bottom = np.inf if core.stop_row == window.stop_row else core.stop_row
    x, y = points.T
    inside: NDArray[np.bool_] = (x >= left) & (x < right) & (y >= top) & (y < bottom)
    return inside


def sample(
    x: Floats, y: Floats, bands: NDArray[Any], valid: NDArray[np.bool_], window: Window
) -> Floats:
    """Return the values (B, P) of the pixels at x, y; NaN where not valid or not there."""
    col, row = np.floor(x).astype(np.intp) - window.col, np.floor(y).astype(np.intp) - window.row
    there = (col >= 0) & (col < window.width) & (row >= 0) & (row < window.height)
    col, row = np.where(there, col, 0), np.where(there, row, 0)
    return np.where(there & valid[row, col], bands[:, row, col].astype(np.float64), np.nan)
