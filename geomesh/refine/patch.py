"""Patch: a part of a mesh that compiled loops change in place.

Coordinates are those of pixel centres: the centre of the pixel (row, col) of the patch's image
is (col, row). All nodes lie on the lattice of 1/256 pixel, where scan lines are exact (see
`geomesh.zonal.rasterize`), so every pixel has one owner whatever is changed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from geomesh.arrays.jit import boolean, inner, int64, named, uint8, writes
from geomesh.arrays.jit import float64 as f8

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Points

# In `Patch.across`: nothing lies behind a side, or a triangle that belongs to another patch.
BORDER = -1
OTHER_PATCH = -2

# In `Patch.held`: nodes that may not move, and nodes that may not change at all: those of sides
# that the patch shares with another one. The last two belong to two separate fans of triangles,
# of which `around` finds only one: fans of the patch, and of the mesh where its outline touches
# itself.
FREE, STAYS, SHARED, SHARED_TWICE, TWO_FANS = 0, 1, 2, 3, 4


class Patch(NamedTuple):
    """Triangles that compiled loops change in place. Arrays have room for more.

    Attributes
    ----------
    points : float64 (n, 2)
        Positions of the nodes; those without a triangle are unused.
    triangles : int64 (m, 3)
        Corners, ordered so that ``(b - a) x (c - a)`` is positive in (x, y) with y down.
    across : int64 (m, 3)
        Number of the triangle across the side opposite to corner k, `BORDER` or `OTHER_PATCH`.
    hard : uint8 (m, 3)
        1 where the side opposite to corner k must stay an edge: the outline and breaklines.
    at : int64 (n,)
        One triangle of each node; -1 if the node is not used.
    alive : bool (m,)
        Whether a triangle exists.
    held : uint8 (n,)
        What a node may do: `FREE`, `STAYS`, `SHARED`, `SHARED_TWICE` or `TWO_FANS`.
    size : int64 (2,)
        Rows in use: of the nodes, and of the triangles.
    """

    points: Points
    triangles: Counts
    across: Counts
    hard: NDArray[np.uint8]
    at: Counts
    alive: NDArray[np.bool_]
    held: NDArray[np.uint8]
    size: NDArray[np.int64]


PATCH = named(
    *(Patch, writes(f8, 2), writes(int64, 2), writes(int64, 2), writes(uint8, 2)),
    *(writes(int64, 1), writes(boolean, 1), writes(uint8, 1), writes(int64, 1)),
)


@inner
def corner_of(triangles: Counts, t: int, v: int) -> int:
    """Return which corner of triangle `t` the node `v` is."""
    if triangles[t, 0] == v:
        return 0
    return 1 if triangles[t, 1] == v else 2


@inner
def side_of(across: Counts, t: int, u: int) -> int:
    """Return which side of triangle `t` it shares with triangle `u`."""
    if across[t, 0] == u:
        return 0
    return 1 if across[t, 1] == u else 2


@inner
def relink(across: Counts, t: int, old: int, new: int) -> None:
    """Make `new` the neighbour of `t` where it was `old`. `t` may be `BORDER` or the like."""
    if t >= 0:
        for k in range(3):
            if across[t, k] == old:
                across[t, k] = new
                return


def room_for(patch: Patch, nodes: int) -> bool:
    """Return whether `nodes` more nodes fit into the arrays of a patch."""
    used, rows = patch.size.tolist()
    return bool(used + nodes <= len(patch.points) and rows + 4 * nodes <= len(patch.triangles))
