"""Statistics of one tile: the pixels of its triangles, and the values at its nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.jit import contiguous
from geomesh.zonal.kernels import blend_pixels, collect_pixels, find_moments
from geomesh.zonal.tile_mesh import triangles_in_box, triangles_inside_box
from geomesh.zonal.value_counts import (
    OrderStatistics,
    ValueCounts,
    count_values,
    order_statistics,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Ids, Points, Triangles
    from geomesh.raster.grid import Window


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
    complete : tuple of OrderStatistics
        For each counted band: of the triangles that have no pixel outside the core.
    counts : tuple of ValueCounts
        For each counted band: of the other triangles.
    """

    index: Ids
    pixels: Counts
    count: Counts
    moments: Floats
    centroid_index: Ids
    centroid_values: Floats
    node_index: Ids
    node_values: Floats
    complete: tuple[OrderStatistics, ...] = ()
    counts: tuple[ValueCounts, ...] = ()

    def renumbered(self, triangle_ids: Ids, node_ids: Ids) -> TilePartial:
        """Return the results with other ids of triangles (T,) and nodes (N,)."""
        return replace(
            self,
            index=triangle_ids[self.index],
            centroid_index=triangle_ids[self.centroid_index],
            node_index=node_ids[self.node_index],
            complete=tuple(each.renumbered(triangle_ids) for each in self.complete),
            counts=tuple(each.renumbered(triangle_ids) for each in self.counts),
        )


def measure_tile(
    nodes: Points,
    triangles: Triangles,
    bands: NDArray[Any],
    valid: NDArray[np.bool_],
    window: Window,
    core: Window,
    *,
    counted: Sequence[int] = (),
    classes: Sequence[int] = (),
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
    counted, classes : sequence of int
        As in `measure_scene`.

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
    sides = core.col, core.stop_col, core.row, core.stop_row
    near = triangles_in_box(nodes, triangles, sides)
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
    complete, counts = [], []
    for k, (band, found, at_nodes) in enumerate(zip(bands, moments, node_values, strict=True)):
        values.reshape(valid.shape)[:] = band
        find_moments(values, members, stops, found)
        if k in classes:
            at_nodes[:] = sample_nearest(points, band, valid, window)
        else:
            blend_pixels(points, values, valid, origin, at_nodes)
        if k in counted:
            occurring = count_values(values[members[: count.sum()]], stops)
            done = triangles_inside_box(nodes, triangles[near], sides)
            complete.append(order_statistics(occurring.of(done)).renumbered(near))
            counts.append(occurring.of(~done).renumbered(near))
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
        complete=tuple(complete),
        counts=tuple(counts),
    )


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


def sample_nearest(
    points: Points, band: NDArray[Any], valid: NDArray[np.bool_], window: Window
) -> Floats:
    """Return the value (P,) of the pixel that contains each point, or of another one near it.

    If that pixel is not valid, it is the nearest valid one of the four pixels whose centres
    are around the point; NaN if there is none. A point on a border of pixels is in the pixel
    to its right, or below it.

    Parameters
    ----------
    points : float64 (P, 2)
        Pixel-edge coordinates.
    band : any real dtype, (h, w)
        Values of the pixels of `window`.
    valid : bool (h, w)
    window : Window
    """
    corner = np.floor(points - 0.5)
    nearest, found = np.full(len(points), np.inf), np.full(len(points), np.nan)
    for right, down in ((1, 1), (0, 1), (1, 0), (0, 0)):
        centre = corner + np.array([right + 0.5, down + 0.5])
        distance = np.square(points - centre).sum(axis=1)
        value = sample(centre[:, 0], centre[:, 1], band[None], valid, window)[0]
        better = ~np.isnan(value) & (distance < nearest)
        nearest[better], found[better] = distance[better], value[better]
    return found
