"""Segments joined into longest lines: by the ids of what they share, never by coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, int64, kernel, reads, writes

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Mask

_NONE = -1


class Chains(NamedTuple):
    """Lines, as the crossings that they visit.

    Attributes
    ----------
    visits : int64 (V,)
    offsets : int64 (K + 1,)
        Where each line begins in `visits`.
    closed : bool (K,)
        Whether the last visit of a line is its first again.
    """

    visits: Counts
    offsets: Counts
    closed: Mask


def join(
    begin: Counts, end: Counts, point: Counts, node: Counts, level: Counts, nodes: int
) -> Chains:
    """Return the segments of contours as lines.

    Parameters
    ----------
    begin, end : int64 (S,)
        The crossings of an edge and a level between which segments go. At most one segment
        begins at a crossing, and at most one ends there.
    point : int64 (C,)
        The point of each crossing: crossings at a node have its id, others one of their own
        edge, which is `nodes` or more.
    node : int64 (C,)
        The node at which a crossing is; -1 if at none.
    level : int64 (S,)
    nodes : int
        Number of nodes.
    """
    following = np.full(len(point), _NONE, np.int64)
    following[begin] = np.arange(len(begin))
    after = following[end]
    over = _cancelled(point[begin], point[end], level, nodes)
    live = np.flatnonzero(over == _NONE)
    # Past a segment without length comes what follows it; past one of a pair, what follows the
    # other: the contour turns around at the node to which the pair led.
    after = after[live]
    past = np.flatnonzero((after >= 0) & (over[after] >= 0))
    while len(past):
        after[past] = following[end[over[after[past]]]]
        past = past[(after[past] >= 0) & (over[after[past]] >= 0)]
    number = np.full(len(begin) + 1, _NONE, np.int64)  # the last is for `_NONE`
    number[live] = np.arange(len(live))
    after = number[after]
    is_first = np.ones(len(live), np.bool_)
    is_first[after[after >= 0]] = False
    visits = np.empty(2 * len(live), np.int64)
    offsets = np.zeros(len(live) + 1, np.int64)
    closed = np.zeros(len(live), np.bool_)
    count = _follow(
        after,
        begin[live],
        end[live],
        node,
        np.concatenate([np.flatnonzero(is_first), np.arange(len(live))]),
        np.full(nodes, _NONE, np.int64),
        np.zeros(len(live), np.bool_),
        np.empty(len(live) + 1, np.int64),
        visits,
        offsets,
        closed,
    )
    return Chains(visits[: offsets[count]], offsets[: count + 1], closed[:count])


def _cancelled(start: Counts, stop: Counts, level: Counts, nodes: int) -> Counts:
    """Return for segments what is taken away with them: themselves, a second one, or -1: nothing.

    A segment from a point to itself has no length. Two of a level that go from one point to
    another and back enclose nothing. They have a node in common, so they are few.
    """
    over = np.full(len(start), _NONE, np.int64)
    none = np.flatnonzero(start == stop)
    over[none] = none
    low, high = np.minimum(start, stop), np.maximum(start, stop)
    rows = np.flatnonzero((start != stop) & (low < nodes))
    rows = rows[np.lexsort((high[rows], low[rows], level[rows]))]
    one, other = rows[:-1], rows[1:]
    same = (level[one] == level[other]) & (low[one] == low[other]) & (high[one] == high[other])
    over[one[same]], over[other[same]] = other[same], one[same]
    return over


@kernel(
    int64(
        reads(int64, 1),
        reads(int64, 1),
        reads(int64, 1),
        reads(int64, 1),
        reads(int64, 1),
        writes(int64, 1),
        writes(boolean, 1),
        writes(int64, 1),
        writes(int64, 1),
        writes(int64, 1),
        writes(boolean, 1),
    )
)
def _follow(  # noqa: PLR0912  (compiled loops are one piece)
    after: Counts,
    begin: Counts,
    end: Counts,
    node: Counts,
    firsts: Counts,
    position: Counts,
    used: Mask,
    stack: Counts,
    visits: Counts,
    offsets: Counts,
    closed: Mask,
) -> int:
    """Fill `visits`, `offsets` and `closed`, and return the number of lines.

    Follow from each of `firsts` what has not been `used`. `stack` holds the visits of the line so
    far, and `position` where in it each node is: a line that comes to a node again leaves a ring
    behind, and goes on from there as if it had not been around.
    """
    filled, lines = 0, 0
    for first in firsts:
        if used[first]:
            continue
        stack[0] = begin[first]
        if node[stack[0]] >= 0:
            position[node[stack[0]]] = 0
        depth, here = 1, first
        while here >= 0 and not used[here]:
            used[here] = True
            at = end[here]
            here = after[here]
            back = -1
            if node[at] >= 0:
                back = position[node[at]]
            elif at == stack[0]:
                back = 0
            if back < 0:
                if node[at] >= 0:
                    position[node[at]] = depth
                stack[depth] = at
                depth += 1
                continue
            for k in range(back, depth):
                visits[filled] = stack[k]
                filled += 1
                if k > back and node[stack[k]] >= 0:
                    position[node[stack[k]]] = -1
            visits[filled] = stack[back]
            filled += 1
            closed[lines] = True
            lines += 1
            offsets[lines] = filled
            depth = back + 1
        for k in range(depth):
            if depth > 1:
                visits[filled] = stack[k]
                filled += 1
            if node[stack[k]] >= 0:
                position[node[stack[k]]] = -1
        if depth > 1:
            lines += 1
            offsets[lines] = filled
    return lines
