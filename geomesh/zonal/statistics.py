"""Statistics of the raster in each triangle, and its values at each node.

`measure_scene` measures a scene tile by tile. `measure_tile` measures one tile by itself
(see `geomesh.zonal.tile_statistics`), and `merge` merges the partial results in the order of
the tile plan. So the result is the
same to the last bit, no matter which process measured which tile.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.table import read_only
from geomesh.parallel.tiles import Tile, map_tiles, plan_tiles
from geomesh.zonal.tile_mesh import TileMesh, split_by_tiles
from geomesh.zonal.tile_statistics import TilePartial, measure_tile
from geomesh.zonal.value_counts import OrderTotals

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene


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
        around the node. Of a band of classes: the value of the nearest valid pixel.
    counted : tuple of int
        Positions of the C bands that have the following three.
    majority, median : float64 (C, T)
        The most frequent of the valid pixels' values (of equally frequent ones the lowest),
        and the middle one. A triangle without a valid pixel: as for the mean.
    variety : int32 (C, T)
        Number of distinct values; 0 if the other two are NaN.
    """

    pixels: Counts
    count: Counts
    mean: Floats
    std: Floats
    min: Floats
    max: Floats
    node_values: Floats
    counted: tuple[int, ...]
    majority: Floats
    median: Floats
    variety: Ids

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "counted":
                object.__setattr__(self, field.name, read_only(getattr(self, field.name)))


def measure_scene(
    nodes: Points,
    triangles: Triangles,
    scene: Scene,
    workers: Workers,
    progress: Progress,
    *,
    counted: Sequence[int] = (),
    classes: Sequence[int] = (),
) -> Statistics:
    """Return the band statistics of a scene in the triangles and at the nodes of its mesh.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    scene : Scene
    workers : Workers
    progress : callable(fraction, message)
    counted : sequence of int
        Positions, in increasing order, of the bands that need majority, variety and median.
    classes : sequence of int
        Positions of the bands of classes, which are not interpolated.
    """
    tiles = plan_tiles(scene.grid.extent, halo=1)
    parts = zip(tiles, split_by_tiles(nodes, triangles, tiles), strict=True)
    partials = map_tiles(
        partial(_read_and_measure, counted=tuple(counted), classes=tuple(classes)),
        ((scene.excerpt(tile.read), tile, part) for tile, part in parts),
        len(tiles),
        workers,
        progress=progress,
        message="Measuring triangles",
    )
    return merge(partials, len(triangles), len(nodes), len(scene.bands), counted=counted)


def _read_and_measure(
    task: tuple[Scene, Tile, TileMesh], *, counted: Sequence[int], classes: Sequence[int]
) -> TilePartial:
    scene, tile, part = task
    bands, valid = scene.read(tile.read)
    found = measure_tile(
        *(part.nodes, part.triangles, bands, valid, tile.read, tile.core),
        counted=counted,
        classes=classes,
    )
    return found.renumbered(part.triangle_ids, part.node_ids)


def merge(
    partials: Iterable[TilePartial],
    n_triangles: int,
    n_nodes: int,
    n_bands: int,
    *,
    counted: Sequence[int] = (),
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
    order = OrderTotals.of(len(counted), n_triangles)
    for part in partials:
        _add(part, pixels, count, moments)
        order.add(part.complete, part.counts)
        centroid[:, part.centroid_index] = part.centroid_values
        node_values[:, part.node_index] = part.node_values
    mean, m2, low, high = moments
    std = np.sqrt(m2 / np.maximum(count, 1))
    none = np.flatnonzero(count == 0)
    for result in (mean, low, high):
        result[:, none] = centroid[:, none]
    std[:, none] = np.where(np.isnan(centroid[:, none]), np.nan, 0.0)
    order.finish(centroid[list(counted)], none)
    return Statistics(
        *(pixels, count, mean, std, low, high, node_values),
        *(tuple(counted), order.majority, order.median, order.variety),
    )


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
