"""The start of a refined mesh: outline, lines, some features, and a grid in between."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.delaunay.grade import Graded, grade
from geomesh.raster.grid import LATTICE

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids, Points
    from geomesh.pipeline.nodes import NodeSet
    from geomesh.raster.grid import Grid

# Distance between the nodes of the grid, in pixels: from the first to the last. Triangles are
# then small enough to be refined block by block.
_SPACING = 64.0, 128.0

# The grid has at most this share of the wanted nodes.
_SHARE = 0.1

# Angles of the start are a little above the smallest angle, so that nodes can move.
_MARGIN = 1.5


def grid_spacing(pixels: int, nodes: int) -> float:
    """Return the distance between the nodes of the grid for a mesh of so many nodes."""
    low, high = _SPACING
    return min(max(low, math.sqrt(pixels / (_SHARE * max(nodes, 1)))), high)


def start_nodes(
    nodes: NodeSet, grid: Grid, spacing: float, min_angle: float, threads: Executor
) -> NodeSet:
    """Return nodes with a grid between them, and without small angles as far as possible.

    Parameters
    ----------
    nodes : NodeSet
        Its points are kept; segments may be split.
    grid : Grid
        The pixel grid of the source.
    spacing : float
        Distance between the nodes of the grid, in pixels.
    min_angle : float
        In degrees.
    threads : Executor
    """
    points, segments, owner = _divided(nodes.points, nodes.segments, spacing)
    points = np.concatenate([points, _lattice(grid, spacing, points)])
    is_line = nodes.is_breakline[owner]
    graded = grade(points, segments, is_line, min_angle + _MARGIN if min_angle else 0.0, threads)
    return _joined(nodes, graded)


def _divided(points: Points, segments: Ids, spacing: float) -> tuple[Points, Ids, NDArray[np.intp]]:
    """Return points and segments, divided into pieces of at most `spacing` where they can be.

    New points lie exactly on the segments and on the lattice. The third result is the number of
    the segment of which each piece is a part.
    """
    one, other = (np.rint(points[segments[:, k]] * LATTICE).astype(np.int64) for k in (0, 1))
    side = other - one
    steps = np.maximum(np.gcd(np.abs(side[:, 0]), np.abs(side[:, 1])), 1)
    pieces = np.ceil(np.hypot(*side.T) / LATTICE / spacing).astype(np.int64)
    pieces = np.clip(pieces, 1, steps)
    row = np.repeat(np.arange(len(segments)), pieces - 1)
    turn = np.arange(len(row)) - np.repeat(np.cumsum(pieces - 1) - (pieces - 1), pieces - 1) + 1
    step = np.rint(turn * steps[row] / pieces[row]).astype(np.int64)
    added = (one[row] + side[row] // steps[row, None] * step[:, None]) / LATTICE
    # The chain of each segment: its first end, the new points, its last end.
    number = len(points) + np.arange(len(row))
    starts = np.concatenate([segments[:, 0], number])
    position = np.concatenate([np.zeros(len(segments), np.int64), turn])
    owner = np.concatenate([np.arange(len(segments)), row])
    order = np.lexsort((position, owner))
    chain = starts[order]
    ends = np.append(chain[1:], 0)
    last = np.append(owner[order][1:] != owner[order][:-1], True)
    ends[last] = segments[owner[order][last], 1]
    divided = np.column_stack([chain, ends]).astype(np.int32)
    return np.concatenate([points, added]), divided, owner[order]


def _lattice(grid: Grid, spacing: float, points: Points) -> Points:
    """Return the nodes of a regular grid that are not near any of the points."""
    from scipy.spatial import cKDTree  # takes a while to import

    axes = []
    for size in (grid.width, grid.height):
        count = max(math.ceil(size / spacing), 1)
        axes.append(np.rint(np.arange(count + 1) * (size * LATTICE / count)) / LATTICE)
    x, y = (axis.ravel() for axis in np.meshgrid(*axes))
    lattice = np.column_stack([x, y])
    distance, _ = cKDTree(points).query(lattice)
    chosen: Points = lattice[distance > spacing / 2]
    return chosen


def _joined(nodes: NodeSet, graded: Graded) -> NodeSet:
    """Return the node set with more points, sorted by y, then x."""
    points, segments = graded.points, graded.segments
    order = np.lexsort((points[:, 0], points[:, 1]))
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    old = len(nodes.points)
    columns: dict[str, NDArray[Any]] = {
        "kind": np.full(len(points), "refined", nodes.table["kind"].dtype)
    }
    columns["kind"][segments[graded.is_line]] = "breakline"
    columns["kind"][segments[~graded.is_line]] = "border"
    columns["kind"][:old] = nodes.table["kind"]
    for name in ("scale", "response", "octave", "angle"):
        columns[name] = np.full(len(points), np.nan, np.float32)
        columns[name][:old] = nodes.table[name]
    return replace(
        nodes,
        points=points[order],
        segments=number[segments],
        is_breakline=graded.is_line,
        table=Table(columns).take(order),
    )
