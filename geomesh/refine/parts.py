"""Parts: cut a mesh into blocks of triangles, and join the refined blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.order import stable_order
from geomesh.refine.patch import OTHER_PATCH, SHARED, SHARED_TWICE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Ids, Points, Triangles


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles with everything that refinement knows about them.

    Parameters
    ----------
    ids : int32 (n,)
        Numbers of the nodes in the node table of the start; -1 for nodes added since.
    points : float64 (n, 2)
    values : float64 (n, B)
    held : uint8 (n,)
        See `Patch.held`. Nodes that other parts have too come first.
    triangles, across : int32 (m, 3)
        See `Patch`.
    hard : uint8 (m, 3)
    """

    ids: Ids
    points: Points
    values: Floats
    held: NDArray[np.uint8]
    triangles: Triangles
    across: Ids
    hard: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Partition:
    """A mesh divided into blocks of triangles.

    Parameters
    ----------
    whole : Part
    order : int32 (m,)
        Triangles, block by block.
    starts : int32 (k + 1,)
        Where in `order` each block begins; the last entry is m.
    local : int32 (m, 3)
        Neighbours, numbered within the block; `OTHER_PATCH` across a border of the block.
    shared : bool (n,)
        Nodes that several blocks have.
    """

    whole: Part
    order: Ids
    starts: Ids
    local: Ids
    shared: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.starts) - 1

    def own(self) -> NDArray[np.int64]:
        """Return the number of nodes that only one block has, for each block."""
        whole = self.whole
        block = np.empty(len(self.order), np.int64)
        block[self.order] = np.repeat(np.arange(len(self)), np.diff(self.starts))
        of_node = np.full(len(whole.points), -1, np.int64)
        of_node[whole.triangles.ravel()] = np.repeat(block, 3)
        return np.bincount(of_node[(of_node >= 0) & ~self.shared], minlength=len(self))

    def part(self, b: int) -> tuple[Part, Ids]:
        """Return one block, and the numbers of its nodes in the whole; shared ones come first."""
        whole = self.whole
        rows = self.order[self.starts[b] : self.starts[b + 1]]
        nodes, corners = np.unique(whole.triangles[rows], return_inverse=True)
        order = np.argsort(~self.shared[nodes], kind="stable")
        number = np.empty(len(order), np.int32)
        number[order] = np.arange(len(order), dtype=np.int32)
        nodes = nodes[order]
        triangles = number[corners.reshape(-1, 3)]
        across = self.local[rows]
        held = whole.held[nodes]
        held[self.shared[nodes]] = SHARED
        held[(held == SHARED) & has_two_fans(triangles, across, len(nodes))] = SHARED_TWICE
        part = Part(
            whole.ids[nodes],
            whole.points[nodes],
            whole.values[nodes],
            held,
            triangles,
            across,
            whole.hard[rows],
        )
        return part, nodes

    def join(self, refined: list[Part]) -> Part:
        """Return the mesh of the refined blocks. Its nodes are the shared ones, then each block's.

        Parameters
        ----------
        refined : list of Part
            One for each block, in order. All blocks of a shared node give it the same values.
        """
        whole = self.whole
        shared = np.flatnonzero(self.shared)
        place = np.full(len(whole.points), -1, np.int64)
        place[shared] = np.arange(len(shared))
        values = whole.values[shared]
        count, rows = len(shared), 0
        triangles, across, own = [], [], []
        for b, part in enumerate(refined):
            nodes = self.shared_nodes(b)
            k = len(nodes)
            values[place[nodes]] = part.values[:k]
            number = np.concatenate([place[nodes], count + np.arange(len(part.points) - k)])
            triangles.append(number[part.triangles].astype(np.int32))
            across.append(np.where(part.across >= 0, part.across + rows, part.across))
            own.append(slice(k, None))
            count += len(part.points) - k
            rows += len(part.triangles)
        parts = list(zip(refined, own, strict=True))
        joined = Part(
            ids=np.concatenate([whole.ids[shared], *(p.ids[s] for p, s in parts)]),
            points=np.concatenate([whole.points[shared], *(p.points[s] for p, s in parts)]),
            values=np.concatenate([values, *(p.values[s] for p, s in parts)]),
            held=np.concatenate([whole.held[shared], *(p.held[s] for p, s in parts)]),
            triangles=np.concatenate(triangles),
            across=np.concatenate(across).astype(np.int32),
            hard=np.concatenate([p.hard for p in refined]),
        )
        _pair(joined)
        return joined

    def shared_nodes(self, b: int) -> Ids:
        """Return the nodes of block `b` that it shares, as `part` orders them."""
        rows = self.order[self.starts[b] : self.starts[b + 1]]
        nodes = np.unique(self.whole.triangles[rows])
        return nodes[self.shared[nodes]]


def has_two_fans(triangles: Triangles, across: Ids, count: int) -> NDArray[np.bool_]:
    """Return which of `count` nodes have more than one fan: more than two sides at the border."""
    row, side = np.nonzero(across < 0)
    ends = np.concatenate([triangles[row, (side + 1) % 3], triangles[row, (side + 2) % 3]])
    several: NDArray[np.bool_] = np.bincount(ends, minlength=count) > 2
    return several


def divide(whole: Part, size: float, shift: tuple[float, float]) -> Partition:
    """Divide a mesh into blocks of triangles by their centroids.

    Parameters
    ----------
    whole : Part
    size : float
        Side of the square blocks in pixels.
    shift : (float, float)
        Position of the blocks, as a share of their side.
    """
    centres = whole.points[whole.triangles].mean(axis=1)
    low, high = whole.points.min(axis=0), whole.points.max(axis=0)
    if (high - low <= size).all():
        shift = (0.0, 0.0)  # one block, whatever the position
        centres = centres - low
    cells = np.floor(centres / size + shift).astype(np.int64)
    cells -= cells.min(axis=0)
    label = cells[:, 1] * (int(cells[:, 0].max()) + 1) + cells[:, 0]
    order = stable_order(label, int(label.max()) + 1)
    in_order = label[order]
    begins = np.flatnonzero(np.append(True, in_order[1:] != in_order[:-1]))
    starts = np.append(begins, len(order)).astype(np.int32)
    position = np.empty(len(order), np.int32)
    position[order] = np.arange(len(order)) - np.repeat(starts[:-1], np.diff(starts))
    across = whole.across
    apart = (across >= 0) & (label[across] != label[:, None])
    local = np.where(across < 0, across, np.where(apart, OTHER_PATCH, position[across]))
    # Not only the ends of borders: two blocks may touch at a node where the outline does.
    of_node = np.zeros(len(whole.points), label.dtype)
    of_node[whole.triangles.ravel()] = np.repeat(label, 3)
    shared = np.zeros(len(whole.points), np.bool_)
    shared[whole.triangles[of_node[whole.triangles] != label[:, None]]] = True
    return Partition(whole, order, starts, local.astype(np.int32), shared)


def _pair(mesh: Part) -> None:
    """Link the triangles on both sides of borders between blocks, in place."""
    row, side = np.nonzero(mesh.across == OTHER_PATCH)
    one = mesh.triangles[row, (side + 1) % 3].astype(np.int64)
    other = mesh.triangles[row, (side + 2) % 3].astype(np.int64)
    keys = np.minimum(one, other) * len(mesh.points) + np.maximum(one, other)
    order = np.argsort(keys, kind="stable")
    first, second = order[::2], order[1::2]
    if len(row) % 2 or (keys[first] != keys[second]).any():
        raise AssertionError("a border between blocks was changed")
    mesh.across[row[first], side[first]] = row[second]
    mesh.across[row[second], side[second]] = row[first]
