"""Split a mesh into one part for each tile."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.order import stable_order
from geomesh.arrays.table import blocks

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Ids, Points, Triangles
    from geomesh.parallel.tiles import Tile


@dataclass(frozen=True, eq=False)
class TileMesh:
    """The part of a mesh that may overlap the core of a tile.

    Parameters
    ----------
    nodes : float64 (n, 2)
    triangles : int32 (K, 3)
        Indices into `nodes`.
    node_ids : int32 (n,)
        Ids of these nodes in the whole mesh.
    triangle_ids : int32 (K,)
        Ids of these triangles in the whole mesh.
    """

    nodes: Points
    triangles: Triangles
    node_ids: Ids
    triangle_ids: Ids


def split_by_tiles(
    nodes: Points, triangles: Triangles, tiles: Sequence[Tile]
) -> Iterator[TileMesh]:
    """Yield the part of a mesh in each tile, in the order of the tiles.

    Parts are made one at a time, which saves memory.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    tiles : sequence of Tile
        All tiles of a plan, row by row, as `geomesh.parallel.tiles.plan_tiles` returns them.
    """
    cols = np.unique([tile.core.col for tile in tiles]).astype(np.float64)
    rows = np.unique([tile.core.row for tile in tiles]).astype(np.float64)
    starts, met = _bin_triangles(nodes, triangles, cols, rows)
    for start, stop in pairwise(starts):
        ids = met[start:stop]
        node_ids, local = np.unique(triangles[ids], return_inverse=True)
        yield TileMesh(nodes[node_ids], local.reshape(-1, 3).astype(np.int32), node_ids, ids)


def triangles_in_box(
    nodes: Points, triangles: Triangles, box: tuple[float, float, float, float]
) -> Ids:
    """Return the triangles whose bounding box touches the box (left, right, top, bottom)."""
    left, right, top, bottom = box
    low_x, high_x = _range(nodes[:, 0], triangles)
    low_y, high_y = _range(nodes[:, 1], triangles)
    met = (low_x <= right) & (high_x >= left) & (low_y <= bottom) & (high_y >= top)
    return np.flatnonzero(met).astype(np.int32)


def triangles_inside_box(
    nodes: Points, triangles: Triangles, box: tuple[float, float, float, float]
) -> NDArray[np.bool_]:
    """Return for each triangle whether it is in the box (left, right, top, bottom)."""
    left, right, top, bottom = box
    low_x, high_x = _range(nodes[:, 0], triangles)
    low_y, high_y = _range(nodes[:, 1], triangles)
    inside: NDArray[np.bool_] = (
        (low_x >= left) & (high_x <= right) & (low_y >= top) & (high_y <= bottom)
    )
    return inside


def _range(values: Floats, triangles: Triangles) -> tuple[Floats, Floats]:
    """Return the minimum and maximum of the values (N,) at the corners of each triangle."""
    a, b, c = (values[triangles[:, k]] for k in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _bin_triangles(
    nodes: Points, triangles: Triangles, cols: Floats, rows: Floats
) -> tuple[NDArray[np.int64], Ids]:
    """Return which triangles' bounding boxes touch each tile, in compressed sparse rows.

    Tiles start at `cols` and `rows`; the last tiles have no end. A border belongs to the
    tiles on both sides, so the result includes everything that `triangles_in_box` finds.
    """
    first, stop = np.empty((2, len(triangles), 2), np.int32)  # column and row of tiles
    for block in blocks(len(triangles)):
        for axis, starts in enumerate((cols, rows)):
            low, high = _range(nodes[:, axis], triangles[block])
            before = np.searchsorted(starts, low, side="left") - 1
            after = np.searchsorted(starts, high, side="right")
            first[block, axis], stop[block, axis] = np.maximum(before, 0), np.maximum(after, 1)
    size = stop - first
    count = size[:, 0] * size[:, 1]
    ids = np.repeat(np.arange(len(triangles), dtype=np.int32), count)
    turn = np.arange(len(ids)) - np.repeat(np.cumsum(count) - count, count)
    row, col = np.divmod(turn, size[ids, 0])
    tile = ((first[ids, 1] + row) * len(cols) + first[ids, 0] + col).astype(np.int32)
    tiles = len(cols) * len(rows)
    ends = np.cumsum(np.bincount(tile, minlength=tiles))
    return np.append(0, ends), ids[stable_order(tile, tiles)]
