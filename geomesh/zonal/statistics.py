"""Statistics of the raster in each triangle, and its values at each node.

`measure_scene` measures a scene tile by tile. `measure_tile` measures one tile by itself,
and `merge` merges the partial results in the order of the tile plan. So the result is the
same to the last bit, no matter which process measured which tile.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.jit import contiguous
from geomesh.arrays.table import read_only
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.zonal.kernels import blend_pixels, collect_pixels, find_moments
from geomesh.zonal.tile_mesh import TileMesh, split_by_tiles, triangles_in_box

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.grid import Window
    from geomesh.raster.scene import Scene


@dataclass(frozen=True, eq=False)
class TilePartial:
    """The statistics of one tile.

    Parameters
    ----------
    index : int32 (K,)
        The triangles that may own a pixel of the tile's core, each once.
    pixels, count : int64 (K,)
        Number of pixels of the core that they own, and of the valid pixels among them.
    moments : float64 (4, B, K)
        Mean, sum of squared deviations from it, minimum and maximum of the valid pixels;
        undefined where `count` is 0.
    centroid_index : int32 (C,)
        The triangles that have no valid pixel in the core and their centroid in it.
    centroid_values : float64 (B, C)
        Value of the pixel that contains the centroid; NaN if it is not valid.
    node_index : int32 (M,)
        The nodes in the core.
    node_values : float64 (B, M)
        Value at the node; NaN if no pixel around it is valid.
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
class Statistics:
    """Band statistics of a mesh; read-only.

    Parameters
    ----------
    pixels, count : int64 (T,)
        Number of pixels that the triangle owns, and of the valid pixels among them.
    mean, std, min, max : float64 (B, T)
        Of the valid pixels; `std` is that of the population (divided by the count). A
        triangle without a valid pixel has the value of the pixel that contains its
        centroid, and `std` 0. If that pixel is not valid either, all four are NaN.
    node_values : float64 (B, N)
        Bilinear interpolation between the centres of valid pixels; NaN if there are none
        around the node.
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
    """Return the band statistics of a scene in the triangles and at the nodes of its mesh."""
    tiles = plan_tiles(scene.grid.extent, halo=1)
    parts = zip(tiles, split_by_tiles(nodes, triangles, tiles), strict=True)
    partials = map_tiles(
        _read_and_measure,
        ((scene.excerpt(tile.read), tile, part) for tile, part in parts),
        len(tiles),
        workers,
        progress=progress,
        message="Measuring triangles",
    )
    return merge(partials, len(triangles), len(nodes), len(scene.bands))


def _read_and_measure(task: tuple[Scene, Tile, TileMesh]) -> TilePartial:
    scene, tile, part = task
    bands, valid = scene.read(tile.read)
    found = measure_tile(part.nodes, part.triangles, bands, valid, tile.read, tile.core)
    return replace(
        found,
        index=part.triangle_ids[found.index],
        centroid_index=part.triangle_ids[found.centroid_index],
        node_index=part.node_ids[found.node_index],
    )


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
        All triangles, in either orientation.
    bands : any real dtype, (B, h, w)
        Values of the pixels, finite where valid; converted to float64.
    valid : bool (h, w)
    window : Window
        The pixels of `bands` and `valid`: the core and at least one pixel around it, except
        where the image ends. On a side without a pixel around the core, the image is
        assumed to end there.
    core : Window
        The pixels that this tile measures.

    Raises
    ------
    ValueError
        If the shapes do not fit the window, or the core is not inside it.
    """
    if bands.ndim != 3 or bands.shape[1:] != window.shape or valid.shape != window.shape:
        raise ValueError(f"bands {bands.shape} and valid {valid.shape} do not cover {window}")
    if window.clip(core) != core:
        raise ValueError(f"the core {core} is not inside {window}")
    nodes, triangles = contiguous(nodes, np.float64), contiguous(triangles, np.int32)
    valid = contiguous(valid, np.bool_)
    near = triangles_in_box(nodes, triangles, (core.col, core.stop_col, core.row, core.stop_row))
    pixels, stops = np.zeros((2, len(near)), np.int64)
    members = np.empty(core.width * core.height + 1, np.int32)
    origin = np.array([window.row, window.col])
    box = np.array([core.row, core.stop_row, core.col, core.stop_col])
    collect_pixels(nodes, triangles[near], valid, origin, box, pixels, stops, members)
    count = np.diff(stops, prepend=0)
    held = np.flatnonzero(_inside(nodes, window, core)).astype(np.int32)
    points = nodes[held]
    moments, node_values = np.zeros((len(bands), 4, len(near))), np.empty((len(bands), len(held)))
    values = np.empty(valid.size)
    for band, found, blended in zip(bands, moments, node_values, strict=True):
        values.reshape(valid.shape)[:] = band
        find_moments(values, members, stops, found)
        blend_pixels(points, values, valid, origin, blended)
    without = near[count == 0]
    centroids = nodes[triangles[without]].mean(axis=1)
    inside = _inside(centroids, window, core)
    return TilePartial(
        index=near,
        pixels=pixels,
        count=count,
        moments=moments.swapaxes(0, 1),
        centroid_index=without[inside],
        centroid_values=sample(centroids[inside, 0], centroids[inside, 1], bands, valid, window),
        node_index=held,
        node_values=node_values,
    )


def merge(
    partials: Iterable[TilePartial], n_triangles: int, n_nodes: int, n_bands: int
) -> Statistics:
    """Merge the partial results of the tiles of an image, in the given order.

    Means and squared deviations are combined pairwise (Chan, Golub and LeVeque 1983). So
    squares of the values themselves, which lose precision, are never subtracted.
    """
    pixels, count = np.zeros((2, n_triangles), np.int64)
    moments = np.zeros((4, n_bands, n_triangles))
    moments[2:] = np.array([np.inf, -np.inf])[:, None, None]
    centroid = np.full((n_bands, n_triangles), np.nan)
    node_values = np.full((n_bands, n_nodes), np.nan)
    for part in partials:
        _add(part, pixels, count, moments)
        centroid[:, part.centroid_index] = part.centroid_values
        node_values[:, part.node_index] = part.node_values
    mean, m2, low, high = moments
    std = np.sqrt(m2 / np.maximum(count, 1))
    none = np.flatnonzero(count == 0)
    for result in (mean, low, high):
        result[:, none] = centroid[:, none]
    std[:, none] = np.where(np.isnan(centroid[:, none]), np.nan, 0.0)
    return Statistics(pixels, count, mean, std, low, high, node_values)


def _add(part: TilePartial, pixels: Counts, count: Counts, moments: Floats) -> None:
    """Add the results of one tile to the totals (T,), (T,) and (4, B, T), in place."""
    pixels[part.index] += part.pixels
    own = part.count > 0
    t, more = part.index[own], part.count[own]
    before = count[t]
    count[t] = before + more
    share = more / count[t]
    mean, m2, low, high = part.moments[:, :, own]
    with np.errstate(invalid="ignore", over="ignore"):
        delta = mean - moments[0][:, t]
        moments[0][:, t] += delta * share
        moments[1][:, t] += m2 + delta * (before * share) * delta
    moments[2][:, t] = np.minimum(moments[2][:, t], low)
    moments[3][:, t] = np.maximum(moments[3][:, t], high)


def _inside(points: Points, window: Window, core: Window) -> NDArray[np.bool_]:
    """Return which points are in the core: half-open, but unlimited where the image ends.

    So a node on the right or lower border of the image also belongs to a tile.
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
    """Return the values (B, P) of the pixels at x, y; NaN if invalid or outside the window."""
    col, row = np.floor(x).astype(np.intp) - window.col, np.floor(y).astype(np.intp) - window.row
    there = (col >= 0) & (col < window.width) & (row >= 0) & (row < window.height)
    col, row = np.where(there, col, 0), np.where(there, row, 0)
    return np.where(there & valid[row, col], bands[:, row, col].astype(np.float64), np.nan)
