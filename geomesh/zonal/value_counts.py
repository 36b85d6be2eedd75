"""How often each value occurs in each triangle: majority, variety and median.

They need all values of a triangle. A tile finishes the triangles that lie inside it; only for
triangles that reach into other tiles are the values and their numbers kept until all tiles
are merged. So the results are exact, and memory grows with the borders between tiles, not with
the image. Only for triangles as large as tiles it can need 16 bytes for each pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.order import stable_order

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts, Floats, Ids

# Entries to merge at a time, unless a single triangle has more.
_BLOCK = 2_000_000


@dataclass(frozen=True, eq=False)
class ValueCounts:
    """The distinct values in each triangle, sorted by triangle, then by value.

    Parameters
    ----------
    triangle : int32 (R,)
    value : float64 (R,)
    count : int32 or int64 (R,)
        Number of pixels of the triangle with that value.
    """

    triangle: Ids
    value: Floats
    count: NDArray[np.signedinteger[Any]]

    def of(self, wanted: NDArray[np.bool_]) -> ValueCounts:
        """Return the entries of the triangles for which `wanted` (T,) is true."""
        kept = wanted[self.triangle]
        return ValueCounts(self.triangle[kept], self.value[kept], self.count[kept])

    def renumbered(self, ids: Ids) -> ValueCounts:
        """Return the counts of triangles with other ids (T,)."""
        return replace(self, triangle=ids[self.triangle])


@dataclass(frozen=True, eq=False)
class OrderStatistics:
    """Statistics of some triangles, from the numbers of their values.

    Parameters
    ----------
    triangle : int32 (K,)
        Triangles with at least one valid pixel, in increasing order.
    majority : float64 (K,)
        The most frequent value; of equally frequent ones the lowest.
    variety : int32 (K,)
        Number of distinct values.
    median : float64 (K,)
        The mean of the two middle values if the number of pixels is even.
    """

    triangle: Ids
    majority: Floats
    variety: Ids
    median: Floats

    def renumbered(self, ids: Ids) -> OrderStatistics:
        """Return the statistics of triangles with other ids (T,)."""
        return replace(self, triangle=ids[self.triangle])


def count_values(values: Floats, stops: Counts) -> ValueCounts:
    """Return how often each value occurs in each triangle.

    Parameters
    ----------
    values : float64 (P,)
        Values of the pixels of triangles 0, 1, ..., one triangle after the other.
    stops : int64 (K,)
        Where the values of each triangle end.
    """
    triangle = np.repeat(np.arange(len(stops), dtype=np.int32), np.diff(stops, prepend=0))
    found = _combine(triangle, values, np.ones(len(values), np.int32), len(stops))
    return replace(found, count=found.count.astype(np.int32))  # a tile has fewer pixels than that


def merge_counts(parts: Sequence[ValueCounts], n_triangles: int) -> Iterator[ValueCounts]:
    """Yield the counts of several tiles as one, some triangles at a time to save memory."""
    sizes = np.zeros(n_triangles, np.int64)
    for part in parts:
        triangle, size = np.unique(part.triangle, return_counts=True)
        sizes[triangle] += size
    blocks = np.cumsum(sizes) // _BLOCK
    starts = np.flatnonzero(np.diff(blocks, prepend=0)).tolist()
    for start, stop in pairwise((0, *starts, n_triangles)):
        found = []
        for part in parts:
            first, last = np.searchsorted(part.triangle, (start, stop))
            if first < last:
                k = slice(first, last)
                found.append((part.triangle[k] - start, part.value[k], part.count[k]))
        if found:
            triangle, value, count = map(np.concatenate, zip(*found, strict=True))
            ids = np.arange(start, stop, dtype=np.int32)
            yield _combine(triangle, value, count, stop - start).renumbered(ids)


def _combine(
    triangle: Ids, value: Floats, count: NDArray[np.signedinteger[Any]], n_triangles: int
) -> ValueCounts:
    by_value = np.argsort(value)
    order = by_value[stable_order(triangle[by_value], n_triangles)]
    triangle, value = triangle[order], value[order]
    first = np.ones(len(value), np.bool_)
    first[1:] = (np.diff(triangle) != 0) | (value[1:] != value[:-1])
    starts = np.flatnonzero(first)
    total = np.add.reduceat(count[order], starts, dtype=np.int64) if len(starts) else count
    # Adding 0 turns -0 into 0: which of the two comes first depends on the tiles.
    return ValueCounts(triangle[starts], value[starts] + 0.0, total)


def order_statistics(counts: ValueCounts) -> OrderStatistics:
    """Return majority, variety and median of each triangle in `counts`."""
    triangle, variety = np.unique(counts.triangle, return_counts=True)
    if not len(triangle):
        none = np.empty(0)
        return OrderStatistics(triangle, none, variety.astype(np.int32), none)
    starts = np.cumsum(variety) - variety
    most = np.maximum.reduceat(counts.count, starts)
    # The first entry of each triangle that has the largest count: its value is the lowest.
    modes = np.flatnonzero(counts.count == np.repeat(most, variety))
    modes = modes[np.unique(counts.triangle[modes], return_index=True)[1]]
    ends = np.cumsum(counts.count, dtype=np.int64)
    total = np.add.reduceat(counts.count, starts, dtype=np.int64)
    before = ends[starts] - counts.count[starts]
    # Pixel k of all, in sorted order, is in the first entry that ends after k.
    low = counts.value[np.searchsorted(ends, before + (total - 1) // 2, side="right")]
    high = counts.value[np.searchsorted(ends, before + total // 2, side="right")]
    # Halved first, so that the sum of two large values does not overflow.
    median = np.where(low == high, low, low / 2 + high / 2)
    return OrderStatistics(triangle, counts.value[modes], variety.astype(np.int32), median)


@dataclass(frozen=True, eq=False)
class OrderTotals:
    """The order statistics of the counted bands in all triangles, filled tile by tile.

    Parameters
    ----------
    majority, median : float64 (C, T)
    variety : int32 (C, T)
        0 for triangles that have no result yet.
    pending : list of list of ValueCounts
        For each counted band: counts of triangles that reach into several tiles.
    """

    majority: Floats
    median: Floats
    variety: Ids
    pending: list[list[ValueCounts]]

    @classmethod
    def of(cls, n_bands: int, n_triangles: int) -> OrderTotals:
        """Return totals without results."""
        shape = n_bands, n_triangles
        empty: list[list[ValueCounts]] = [[] for _ in range(n_bands)]
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int32), empty)

    def add(self, complete: Sequence[OrderStatistics], counts: Sequence[ValueCounts]) -> None:
        """Add the results of one tile."""
        for band, (found, more) in enumerate(zip(complete, counts, strict=True)):
            self._put(band, found)
            self.pending[band].append(more)

    def finish(self, centroid: Floats, none: NDArray[np.intp]) -> None:
        """Merge the counts of the tiles, and use the centroids for triangles without a pixel.

        Parameters
        ----------
        centroid : float64 (C, T)
            Value at the centroid; NaN if that is not valid.
        none : int (n,)
            The triangles without a valid pixel.
        """
        for band, parts in enumerate(self.pending):
            for counts in merge_counts(parts, self.variety.shape[1]):
                self._put(band, order_statistics(counts))
            parts.clear()
        for result in (self.majority, self.median):
            result[:, none] = centroid[:, none]
        self.variety[:, none] = ~np.isnan(centroid[:, none])

    def _put(self, band: int, found: OrderStatistics) -> None:
        self.majority[band, found.triangle] = found.majority
        self.median[band, found.triangle] = found.median
        self.variety[band, found.triangle] = found.variety
