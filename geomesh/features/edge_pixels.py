"""The edge pixels of an image as coordinates: from each tile those of its core, then joined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.arrays.types import Counts, Ids, Mask
    from geomesh.features.canny import EdgePartial, WeakEdges
    from geomesh.parallel.tiles import Tile

Strengths: TypeAlias = NDArray[np.uint16]

# Chains with fewer pixels are not long enough to be breaklines.
SHORTEST_CHAIN = 32


@dataclass(frozen=True, eq=False)
class EdgePixels:
    """Edge pixels of an image.

    Attributes
    ----------
    place : int64 (P,)
        row * (width of the image) + column.
    strength : uint16 (P,)
        Gradient in gray levels.
    """

    place: Counts
    strength: Strengths


@dataclass(frozen=True, eq=False)
class WeakPixels:
    """The pixels of a tile's core that are edges or may be: see `EdgePixels`.

    Attributes
    ----------
    pixels : EdgePixels
    label : int32 (P,)
        The component of each pixel in this tile.
    """

    pixels: EdgePixels
    label: Ids

    @classmethod
    def of(
        cls, weak: WeakEdges, partial: EdgePartial, tile: Tile, image_width: int, *, l2: bool
    ) -> WeakPixels:
        """Return the pixels of a core, without components that certainly are too short."""
        label = weak.labels[weak.rows - weak.window.row, weak.cols - weak.window.col]
        leaves = np.zeros(len(partial.strong), np.bool_)
        leaves[partial.seam_labels] = True
        size = np.bincount(label, minlength=len(leaves))
        may_be = leaves | (partial.strong & (size >= SHORTEST_CHAIN))
        core = tile.core
        kept = may_be[label]
        kept &= (weak.rows >= core.row) & (weak.rows < core.stop_row)
        kept &= (weak.cols >= core.col) & (weak.cols < core.stop_col)
        magnitude = weak.magnitude[kept]
        strength = np.rint(np.sqrt(magnitude) if l2 else magnitude).astype(np.uint16)
        place = weak.rows[kept].astype(np.int64) * image_width + weak.cols[kept]
        return cls(EdgePixels(place, strength), label[kept])


def join_pixels(parts: Sequence[WeakPixels], is_edge: Sequence[Mask]) -> EdgePixels:
    """Return the edge pixels of all tiles, in order; `is_edge` marks the components that are."""
    kept = [edge[part.label] for part, edge in zip(parts, is_edge, strict=True)]
    both = list(zip(parts, kept, strict=True))
    place = np.concatenate([part.pixels.place[keep] for part, keep in both])
    strength = np.concatenate([part.pixels.strength[keep] for part, keep in both])
    order = np.argsort(place)
    return EdgePixels(place[order], strength[order])
