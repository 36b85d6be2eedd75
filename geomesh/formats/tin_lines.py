"""The lines of a TIN: its outline as rings, and the breaklines inside of it as chains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geomesh.formats.tin import Tin
    from geomesh.mesh.triangle_mesh import TriangleMesh

    Line = NDArray[np.intp]

_NONE = -1
_SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")


@dataclass(frozen=True)
class TinLines:
    """Lines along the edges of a TIN, as rows of its points.

    Parameters
    ----------
    outer : tuple of int (R,)
        The rings around the parts, counter-clockwise on the map. The first point is not repeated.
    holes : tuple of int (R,)
        The rings around the holes, clockwise on the map.
    breaklines : tuple of int (P,)
        The longest chains of constraints that have triangles on both sides, without branches. The
        first point of a closed one is repeated at its end.
    """

    outer: tuple[Line, ...]
    holes: tuple[Line, ...]
    breaklines: tuple[Line, ...]


def lines_of(mesh: TriangleMesh, tin: Tin) -> TinLines:
    """Return the outline of a TIN, and the breaklines of its mesh that lie inside of it."""
    starts = tin.triangles.ravel().astype(np.int64)
    stops = np.roll(tin.triangles, -1, axis=1).ravel().astype(np.int64)
    keys = _keys(starts, stops, len(tin.points))
    order = np.argsort(keys, kind="stable")
    twins = _twins(keys, order)
    outer: list[Line] = []
    holes: list[Line] = []
    for ring in _rings(starts, twins):
        x, y = tin.points[ring, :2].T - tin.points[ring[0], :2, None]
        area = x @ np.roll(y, -1) - y @ np.roll(x, -1)
        (outer if area > 0 else holes).append(ring)
    place = np.full(len(mesh.nodes), _NONE, np.int64)
    place[tin.nodes] = np.arange(len(tin.nodes))
    ends = place[mesh.constraints]
    ends = ends[(ends != _NONE).all(axis=1)]
    found = np.unique(_keys(ends[:, 0], ends[:, 1], len(tin.points)))
    # An edge inside of the TIN has two half-edges.
    first, last = (np.searchsorted(keys[order], found, side) for side in _SIDES)
    pairs = np.column_stack(np.divmod(found[last - first == 2], len(tin.points)))
    return TinLines(tuple(outer), tuple(holes), tuple(_chains(pairs)))


def _keys(starts: NDArray[np.int64], stops: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return a number for each edge that does not depend on its direction."""
    keys: NDArray[np.int64] = np.minimum(starts, stops) * count + np.maximum(starts, stops)
    return keys


def _twins(keys: NDArray[np.int64], order: NDArray[np.intp]) -> NDArray[np.int64]:
    """Return the opposite half-edge of each half-edge, or `_NONE` on the outline."""
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    twins = np.full(len(keys), _NONE, np.int64)
    twins[order[same]] = order[same + 1]
    twins[order[same + 1]] = order[same]
    return twins


def _next(half_edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the next half-edges of the same triangles."""
    return np.where(half_edges % 3 == 2, half_edges - 2, half_edges + 1)


def _rings(starts: NDArray[np.int64], twins: NDArray[np.int64]) -> Iterable[Line]:
    """Yield the rings of the outline, with the triangles to their left; no ring touches itself.

    Where rings touch in a point, each follows the triangles on its left around this point, so
    that rings do not cross.
    """
    border = np.flatnonzero(twins == _NONE)
    following = _next(border)
    while (inside := np.flatnonzero(twins[following] != _NONE)).size:
        following[inside] = _next(twins[following[inside]])
    successor = dict(zip(border.tolist(), following.tolist(), strict=True))
    origin = dict(zip(border.tolist(), starts[border].tolist(), strict=True))
    while successor:
        first = half_edge = next(iter(successor))
        path: list[int] = []
        at: dict[int, int] = {}
        while True:
            point = origin[half_edge]
            if point in at:  # the path has come back to this point: a ring of its own
                yield np.array(path[at[point] :], np.intp)
                for left in path[at[point] + 1 :]:
                    del at[left]
                del path[at[point] :]
            at[point] = len(path)
            path.append(point)
            half_edge = successor.pop(half_edge)
            if half_edge == first:
                break
        yield np.array(path, np.intp)


def _chains(pairs: NDArray[np.int64]) -> Iterable[Line]:
    """Yield the longest chains of edges (E, 2) that have no branches."""
    neighbours: dict[int, list[int]] = {}
    for start, stop in pairs.tolist():
        neighbours.setdefault(start, []).append(stop)
        neighbours.setdefault(stop, []).append(start)
    forks = {point for point, others in neighbours.items() if len(others) != 2}
    # Chains between ends and forks first; what is left after that are closed chains.
    for point in [*sorted(forks), *sorted(set(neighbours) - forks)]:
        while neighbours[point]:
            chain = [point]
            while True:
                other = neighbours[chain[-1]].pop()
                neighbours[other].remove(chain[-1])
                chain.append(other)
                if other in forks or other == point:
                    break
            yield np.array(chain, np.intp)
