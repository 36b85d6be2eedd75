"""A closed solid below a surface: the surface, side walls, and a flat base."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.mesh.topology import FILL, neighbours

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Triangles


class Solid(NamedTuple):
    """The surface of a solid.

    Attributes
    ----------
    points : float64 (P, 3)
    triangles : int32 (F, 3)
        Counter-clockwise seen from outside. The triangles of the surface come first, in their
        order, then those of the base, then the walls.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]


def closed_solid(points: NDArray[np.float64], triangles: Triangles, base: float) -> Solid:
    """Return the solid between a surface and a flat base.

    Each edge belongs to two triangles, which have it in opposite directions. That is so too
    where the outline touches itself in a node. There four or more walls meet in one vertical
    edge, and a reader could not tell which belong together. So the walls of all parts but the
    first have a point of their own on this edge, each at another height.

    Parameters
    ----------
    points : float64 (N, 3)
        Each in a triangle, and above the base.
    triangles : int32 (T, 3)
        Counter-clockwise seen from above; no edge is in more than two.
    base : float
        The height of the base.
    """
    count = len(points)
    start, stop, start_part, stop_part = _outline(triangles)
    owner, part = np.concatenate([start, stop]), np.concatenate([start_part, stop_part])
    extra, at = np.unique(np.column_stack([owner, part])[part > 0], axis=0, return_inverse=True)
    middle = np.full(len(owner), FILL, np.int64)
    middle[part > 0] = 2 * count + at.ravel()
    below = points.copy()
    below[:, 2] = base
    parts = np.zeros(count, np.int64)
    np.maximum.at(parts, owner, part)
    share = (extra[:, 1] / (parts[extra[:, 0]] + 1))[:, None]
    between = below[extra[:, 0]] + share * (points - below)[extra[:, 0]]
    walls = _walls(start, stop, middle[: len(start)], middle[len(start) :], count)
    faces = np.concatenate([triangles, triangles[:, ::-1] + count, walls])
    return Solid(np.concatenate([points, below, between]), faces.astype(np.int32))


def _walls(
    start: NDArray[np.int64],
    stop: NDArray[np.int64],
    start_middle: NDArray[np.int64],
    stop_middle: NDArray[np.int64],
    count: int,
) -> NDArray[np.int64]:
    r"""Return the triangles of the walls below the edges of the outline.

    stop---start    seen from outside; the diagonal goes from the upper stop to the lower start,
      |  \     |     and each half is cut in two if there is a point on its vertical edge
    stop---start
    """
    lower_start, lower_stop = start + count, stop + count
    faces = []
    for far, one, other, middle in (
        (stop, start, lower_start, start_middle),
        (lower_start, lower_stop, stop, stop_middle),
    ):
        cut = middle != FILL
        faces += [
            np.column_stack([far, one, other])[~cut],
            np.column_stack([far, one, middle])[cut],
            np.column_stack([far, middle, other])[cut],
        ]
    return np.concatenate(faces)


def _outline(
    triangles: Triangles,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the directed edges of the outline, and to which part at a node their ends belong.

    The interior is on the left. Parts of a node are the sets of its triangles that are joined by
    edges at this node, numbered from 0; nearly every node has one.

    Returns
    -------
    start, stop, start_part, stop_part : int64 (B,)
    """
    beside = neighbours(triangles)[:, [2, 0, 1]]  # across the side from corner k to corner k + 1
    triangle, corner = np.nonzero(beside == FILL)
    following = (corner + 1) % 3
    start = triangles[triangle, corner].astype(np.int64)
    stop = triangles[triangle, following].astype(np.int64)
    ends = np.concatenate([3 * triangle + corner, 3 * triangle + following])
    part = _parts(triangles, beside, np.bincount(start, minlength=triangles.max() + 1) > 1)[ends]
    return start, stop, part[: len(start)], part[len(start) :]


def _parts(
    triangles: Triangles, beside: NDArray[np.int32], touched: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return for each corner (3 T,) the number of its part at its node.

    Parameters
    ----------
    triangles, beside : int32 (T, 3)
    touched : bool (N,)
        Nodes at which there may be several parts.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    part = np.zeros(triangles.size, np.int64)
    if not touched.any():
        return part
    joined = []
    for shift in (0, 1):
        # Corner k, then corner k + 1, is the same node as a corner of the triangle across.
        node = np.roll(triangles, -shift, axis=1)
        triangle, side = np.nonzero((beside != FILL) & touched[node])
        other = beside[triangle, side]
        same = (triangles[other] == node[triangle, side][:, None]).argmax(axis=1)
        joined.append((3 * triangle + (side + shift) % 3, 3 * other.astype(np.int64) + same))
    one, two = (np.concatenate(ends) for ends in zip(*joined, strict=True))
    links = coo_array((np.ones(len(one), np.bool_), (one, two)), (triangles.size,) * 2)
    _, label = connected_components(links, directed=False)
    corners = np.flatnonzero(touched[triangles.ravel()])
    pairs, at = np.unique(
        np.column_stack([triangles.ravel()[corners], label[corners]]), axis=0, return_inverse=True
    )
    first = np.searchsorted(pairs[:, 0], pairs[:, 0])
    part[corners] = (np.arange(len(pairs)) - first)[at.ravel()]
    return part
