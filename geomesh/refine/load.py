"""Turn parts of a mesh into patches, which compiled loops change, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.refine.parts import Part
from geomesh.refine.patch import BORDER, OTHER_PATCH, SHARED, TWO_FANS, Patch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Ids


def patch_of(part: Part, room: int) -> Patch:
    """Return the triangles of a part as a patch with room for more nodes."""
    nodes, triangles = len(part.points), len(part.triangles)
    n, m = nodes + room, triangles + 4 * room + 64
    at = np.full(n, -1, np.int64)
    at[part.triangles.ravel()] = np.repeat(np.arange(triangles), 3)
    return Patch(
        grown(part.points, n),
        grown(part.triangles.astype(np.int64), m),
        grown(part.across.astype(np.int64), m),
        grown(part.hard, m),
        at,
        grown(np.ones(triangles, np.bool_), m),
        grown(part.held, n),
        np.array([nodes, triangles], np.int64),
    )


def part_of(patch: Patch, values: Floats, ids: Ids) -> Part:
    """Return the triangles of a patch without unused nodes; shared nodes stay first, in order."""
    nodes, rows = patch.size.tolist()
    alive = np.flatnonzero(patch.alive[:rows])
    place = np.full(rows + 2, OTHER_PATCH, np.int32)
    place[BORDER] = BORDER
    place[alive] = np.arange(len(alive), dtype=np.int32)
    across = patch.across[alive]
    used = np.flatnonzero((patch.at[:nodes] >= 0) | (patch.held[:nodes] >= SHARED))
    number = np.full(nodes, -1, np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    return Part(
        ids=ids[used],
        points=patch.points[used],
        values=values[used],
        held=patch.held[used],
        triangles=number[patch.triangles[alive]],
        across=np.where(across >= 0, place[across], across).astype(np.int32),
        hard=patch.hard[alive],
    )


def own_nodes(patch: Patch) -> int:
    """Return the number of nodes that only this patch has."""
    nodes = patch.size[0]
    used, held = patch.at[:nodes] >= 0, patch.held[:nodes]
    return int(np.count_nonzero(used & ((held < SHARED) | (held == TWO_FANS))))


def ids_of(part: Part, rows: int) -> Ids:
    """Return the numbers of a part's nodes, and -1 for nodes that may follow."""
    ids = np.full(rows, -1, np.int32)
    ids[: len(part.ids)] = part.ids
    return ids


def grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    """Return a copy of an array with more rows, which are zero."""
    more = np.zeros((rows, *array.shape[1:]), array.dtype)
    more[: len(array)] = array
    return more
