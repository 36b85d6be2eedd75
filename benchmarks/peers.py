"""Other ways to place the nodes of a mesh, each with exactly the given number of nodes.

The mesh of a peer must cover all valid pixels. So four of its nodes are the corners of the box
around them. All others are where the method wants them. The mesh is the Delaunay triangulation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.delaunay.triangulate import delaunay
from geomesh.evaluate.baselines import (
    greedy_insertion,
    random_pixels,
    regular_grid,
    yang_error_diffusion,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from benchmarks.scoring import Raster
    from geomesh.arrays.types import Mask, Points, Triangles

# The baselines are for 8-bit images, but work with floats too.
PLAIN: Mapping[str, Callable[[NDArray[Any], Mask, int], Points]] = {
    "regular grid": regular_grid,
    "random": random_pixels,
}
GUIDED: Mapping[str, Callable[[NDArray[Any], Mask, int], Points]] = {
    "Yang error diffusion": yang_error_diffusion,
    "greedy insertion": greedy_insertion,
}
PEERS = (*PLAIN, *GUIDED)


def place(method: str, raster: Raster, count: int) -> Iterator[Points]:
    """Yield sets of `count` nodes of a peer, of which the best counts.

    A method that looks at one band yields one set for each of the raster's guides.
    """
    guides = raster.guides
    if method in PLAIN:
        guides = {"gray": guides["gray"]}
    function = {**PLAIN, **GUIDED}[method]
    for guide in guides.values():
        yield with_corners(function(guide, raster.valid, count - 4), raster.valid)


def with_corners(points: Points, valid: Mask) -> Points:
    """Return the points and the corners of the smallest box around the valid pixels.

    Each point is there once.
    """
    rows, cols = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
    x0, y0, x1, y1 = cols[0], rows[0], cols[-1] + 1, rows[-1] + 1
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], np.float64)
    return np.unique(np.concatenate([corners, points]), axis=0)


def triangulate(points: Points) -> tuple[Points, Triangles]:
    """Return the Delaunay triangulation: the nodes in use, and the triangles."""
    triangles, used = delaunay(points)
    return points[used], np.searchsorted(used, triangles).astype(np.int32)
