"""Chains of Canny edge pixels: long, strong edges as lines, the same for any tiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import boolean, int32, int64, kernel, reads, writes
from geomesh.features.edge_pixels import SHORTEST_CHAIN

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats, Ids, Mask, Points
    from geomesh.features.edge_pixels import EdgePixels, Strengths

# Branches with fewer pixels and a free end are cut off, so that they do not divide long chains.
_SPUR = 8

# Two chains at a branch are in line if the cosine of the angle between them is below this. Their
# directions are taken over this many pixels.
_IN_LINE = -0.5
_REACH = 6

# Chains of so many pixels are followed at once: they need about 170 bytes each. Chains of images
# with more are cut at some rows of the image.
_AT_ONCE = 2_000_000

_NONE = -1


class Chain(NamedTuple):
    """A chain of edge pixels.

    Attributes
    ----------
    xy : float64 (k, 2)
        Centres of the pixels, in pixel-edge coordinates.
    strength : float
        Mean of the gradients, in gray levels, times the diagonal of the box around the chain.
    """

    xy: Points
    strength: float


def follow_chains(edges: EdgePixels, width: int) -> list[Chain]:
    """Return the chains of at least `SHORTEST_CHAIN` pixels, the strongest first.

    Neighbours along rows and columns are joined, and diagonal ones that have no such neighbour
    in common. At a branch, the two chains that are most in line go on as one. Chains end at free
    ends and at branches; closed ones return to their first pixel.

    Parameters
    ----------
    edges : EdgePixels
        In order of `place`.
    width : int
        Width of the image.
    """
    chains = [
        chain
        for part in _stripes(edges.place, width)
        for chain in _chains_of(edges.place[part], edges.strength[part], width)
    ]
    return sorted(chains, key=lambda chain: (-chain.strength, *chain.xy[0, ::-1].tolist()))


def _stripes(place: Counts, width: int) -> list[slice]:
    """Return stripes of whole rows with about `_AT_ONCE` pixels. Two share a row, where they meet.

    So the two parts of a chain meet in a pixel.
    """
    stripes, start = [], 0
    while start < len(place):
        last = place[min(start + _AT_ONCE, len(place)) - 1] // width
        stop = int(np.searchsorted(place, (last + 1) * width))
        again = int(np.searchsorted(place, last * width))
        stripes.append(slice(start, stop))
        start = again if start < again and stop < len(place) else stop
    return stripes


def _chains_of(place: Counts, strength: Strengths, width: int) -> list[Chain]:
    """Return the chains of a part of the pixels, in no particular order: see `follow_chains`."""
    visits, starts = _walk(_links(place, width))
    uses = np.bincount(visits, minlength=len(place))
    sizes, first, last = np.diff(starts), visits[starts[:-1]], visits[starts[1:] - 1]
    # A spur has one end to which nothing else is joined, and branches off at the other end.
    spur = (sizes < _SPUR) & ((uses[first] == 1) != (uses[last] == 1))
    kept = np.ones(len(place), np.bool_)
    kept[visits[np.repeat(spur, sizes) & (uses[visits] == 1)]] = False
    place, strength = place[kept], strength[kept]
    around = _links(place, width)
    xy = np.column_stack(np.divmod(place, width)[::-1]) + 0.5
    around, origin = _straightened(around, xy, *_walk(around))
    visits, starts = _walk(around)
    visits = origin[visits]
    long = np.flatnonzero(np.diff(starts) >= SHORTEST_CHAIN)
    chains = []
    for k in long:
        pixels = visits[starts[k] : starts[k + 1]]
        # The extent, not the length: a coast goes far, and an edge of texture turns around.
        extent = np.hypot(*np.ptp(xy[pixels], axis=0))
        chains.append(Chain(xy[pixels], float(strength[pixels].mean() * extent)))
    return chains


def choose_chains(costs: Floats, budget: float) -> Mask:
    """Return which chains to keep, the first ones first, so that costs stay within the budget."""
    kept: Mask = np.cumsum(costs) <= budget
    return kept


def _links(place: Counts, width: int) -> Ids:
    """Return the neighbours (P, 8) to which pixels are joined, clockwise from the right."""
    col = place % width
    around = np.full((len(place), 8), _NONE, np.int32)
    for k, (down, right) in enumerate(((0, 1), (1, 1), (1, 0), (1, -1))):
        wanted = place + (down * width + right)
        at = np.minimum(np.searchsorted(place, wanted), len(place) - 1)
        here = np.flatnonzero((place[at] == wanted) & (col + right >= 0) & (col + right < width))
        around[here, k], around[at[here], k + 4] = at[here], here
    # The even ones share a side.
    beside = around[:, ::2] != _NONE
    for k in range(4):
        around[beside[:, k] | beside[:, (k + 1) % 4], 2 * k + 1] = _NONE
    return around


def _straightened(around: Ids, xy: Points, visits: Counts, starts: Counts) -> tuple[Ids, Counts]:
    """Return links in which chains go straight on at branches, and the pixel of each of its rows.

    A branch becomes a pixel of its own for each pair of chains that go on. Two chains do if each
    is the one that is most in line with the other, and they turn little.
    """
    count = np.count_nonzero(around != _NONE, axis=1)
    sizes = np.diff(starts)
    reach = np.minimum(sizes - 1, _REACH)
    # Both ends of each chain: the pixel, the next one, and the direction.
    pixel = np.concatenate([visits[starts[:-1]], visits[starts[1:] - 1]])
    following = np.concatenate([visits[starts[:-1] + 1], visits[starts[1:] - 2]])
    far = np.concatenate([visits[starts[:-1] + reach], visits[starts[1:] - 1 - reach]])
    at_branch = np.flatnonzero(count[pixel] > 2)
    slot = (around[pixel[at_branch]] == following[at_branch, None]).argmax(axis=1)
    order = at_branch[np.lexsort((slot, pixel[at_branch]))]
    slot = slot[np.lexsort((slot, pixel[at_branch]))]
    pixel, direction = pixel[order], xy[far[order]] - xy[pixel[order]]
    direction /= np.maximum(np.hypot(*direction.T), 1e-9)[:, None]
    pairs, turns = [np.empty((0, 2), np.int64)], [np.empty(0)]
    for apart in range(1, 8):
        one = np.flatnonzero(pixel[apart:] == pixel[:-apart])
        pairs.append(np.column_stack([one, one + apart]))
        turns.append((direction[one] * direction[one + apart]).sum(axis=1))
    pair, turn = np.concatenate(pairs), np.concatenate(turns)
    pair = pair[np.lexsort((pair[:, 1], pair[:, 0], turn))][: np.count_nonzero(turn < _IN_LINE)]
    best = np.full(len(pixel), len(pair))
    np.minimum.at(best, pair.T.ravel(), np.tile(np.arange(len(pair)), 2))
    mutual = (best[pair] == np.arange(len(pair))[:, None]).all(axis=1)
    pair = pair[mutual]
    # The links that a new row takes over from a pixel, as 8 * pixel + direction, in order.
    taken = (8 * pixel + slot)[pair].ravel()
    owner = np.repeat(np.arange(len(pair)) + len(around), 2)
    order = np.argsort(taken)
    taken, owner = taken[order], owner[order]
    row, k = np.divmod(taken, 8)
    other, back = around[row, k], (k + 4) % 8
    place = np.minimum(np.searchsorted(taken, 8 * other + back), len(taken) - 1)
    there = np.where(taken[place] == 8 * other + back, owner[place], other) if len(taken) else other
    found = np.concatenate([around, np.full((len(pair), 8), _NONE, np.int32)])
    found[other, back] = owner
    found[owner, k] = there
    found[there, back] = owner
    found[row, k] = _NONE
    return found, np.concatenate([np.arange(len(around)), pixel[pair[:, 0]]])


def _walk(around: Ids) -> tuple[Counts, Counts]:
    """Return the pixels of chain after chain, and where each chain begins; the last is the end."""
    count = np.count_nonzero(around != _NONE, axis=1).astype(np.int32)
    # Each branch is visited once by each of its chains.
    visits = np.empty(2 * int(count.sum()) + len(around), np.int64)
    starts = np.empty(int(count.sum()) + len(around) + 1, np.int64)
    chains = _follow(around, count, np.zeros(around.shape, np.bool_), visits, starts)
    starts = starts[: chains + 1].copy()
    return visits[: starts[-1]].copy(), starts


@kernel(
    int64(
        reads(int32, 2),
        reads(int32, 1),
        writes(boolean, 2),
        writes(int64, 1),
        writes(int64, 1),
    )
)
def _follow(around: Ids, count: Ids, used: Mask, visits: Counts, starts: Counts) -> int:
    """Fill `visits`, the pixels of chain after chain, and `starts`; return the number of chains.

    First come the chains that begin at a pixel with one or more than two neighbours, then the
    closed ones. `used` marks the links that a chain has followed.
    """
    filled, chains = 0, 0
    for closed in range(2):
        for first in range(len(around)):
            if (count[first] == 2) != (closed == 1):
                continue
            for k in range(8):
                if around[first, k] < 0 or used[first, k]:
                    continue
                starts[chains] = filled
                chains += 1
                visits[filled] = first
                filled += 1
                here, step = first, k
                while step >= 0:
                    there = around[here, step]
                    back = (step + 4) % 8
                    used[here, step] = used[there, back] = True
                    visits[filled] = there
                    filled += 1
                    here, step = there, -1
                    if count[there] == 2 and there != first:
                        for j in range(8):
                            if around[there, j] >= 0 and j != back:
                                step = j
    starts[chains] = filled
    return chains
