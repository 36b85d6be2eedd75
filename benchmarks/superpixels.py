"""SLIC superpixels as polygons of one colour, with about as many vertices as meshes have nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.scoring import spread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from benchmarks.scoring import Raster
    from geomesh.arrays.types import Floats

    Labels = NDArray[np.integer]

SLIC = "SLIC + polygonize"

# Weights of the distance against the colour, from ragged regions that follow the image to squares.
_COMPACTNESS = (1.0, 10.0)
_MOST_RAGGED = 0.03

# How far the number of vertices may be above the number wanted, and the runs to get there.
TOLERANCE = 0.02
_RUNS = 6


class Superpixels(NamedTuple):
    """The superpixels of a raster.

    Attributes
    ----------
    image : float64 (B, H, W)
        The mean of each superpixel; NaN where pixels are not valid.
    vertices : int
        Of their polygons.
    """

    image: Floats
    vertices: int


def superpixels(raster: Raster, count: int) -> Superpixels:
    """Return the best superpixels of a raster with about `count` vertices.

    For each compactness, these are the superpixels with the most vertices, but not more than
    `count` and the tolerance. They can have fewer: SLIC starts from a grid, so not every number
    of superpixels is possible. Then a smaller compactness makes the borders more ragged, until
    there are enough vertices.

    Raises
    ------
    ValueError
        If all superpixels that were tried have more vertices.
    """
    found = []
    for compactness in _COMPACTNESS:
        for labels in _search(raster, count, compactness):
            image = _means(raster, labels)
            found.append((raster.score(image)[0], image, count_vertices(labels)))
    if not found:
        raise ValueError(f"{raster.name}: no superpixels with about {count} vertices")
    _, image, vertices = max(found, key=lambda each: each[0])
    return Superpixels(image, vertices)


def _search(raster: Raster, count: int, compactness: float) -> Iterator[Labels]:
    """Yield the labels with the most vertices, but at most `count` and the tolerance.

    The number of vertices does not always grow with that of the superpixels. So this is no
    plain bisection: a guess is corrected by its ratio, as long as that stays in the interval.
    """
    low, high, guess = 1.0, float(raster.valid.size), count / 2
    best, most, segments = None, 0, 0
    for _ in range(_RUNS):
        labels = segment(raster, round(guess), compactness)
        vertices = count_vertices(labels)
        if most < vertices <= (1 + TOLERANCE) * count:
            best, most, segments = labels, vertices, round(guess)
        if abs(vertices - count) <= TOLERANCE * count or high - low <= 1:
            break
        low, high = (guess, high) if vertices < count else (low, guess)
        guess *= count / max(vertices, 1)
        if not low < guess < high:
            guess = (low * high) ** 0.5
    if best is None:
        return
    yield best
    smooth, ragged = compactness, _MOST_RAGGED
    for _ in range(_RUNS if most < (1 - TOLERANCE) * count else 0):
        middle = (smooth * ragged) ** 0.5
        labels = segment(raster, segments, middle)
        vertices = count_vertices(labels)
        if vertices > (1 + TOLERANCE) * count:
            ragged = middle
            continue
        smooth = middle
        if vertices > most:
            yield labels
        if vertices >= (1 - TOLERANCE) * count:
            break


def segment(raster: Raster, segments: int, compactness: float) -> Labels:
    """Return the superpixels (H, W) of a raster, from 1 on; 0 where pixels are not valid."""
    from skimage.segmentation import slic

    peak = np.where(raster.peak > 0, raster.peak, 1.0)[:, None, None]
    # The mask of `slic` starts from clusters of random pixels, which takes minutes.
    labels: Labels = slic(
        np.moveaxis(spread(raster.bands / peak, raster.valid), 0, -1),
        n_segments=segments,
        compactness=compactness,
        channel_axis=-1,
        convert2lab=False,
        start_label=1,
    )
    return np.where(raster.valid, labels, 0)


def count_vertices(labels: Labels) -> int:
    """Return the number of distinct vertices of the polygons around equal labels.

    A vertex is a corner of pixels where a border between two superpixels turns, or where it
    meets another border. Where a border only goes straight on, there is no vertex. Turns of the
    outline of the valid pixels are no vertices either, because no mesh pays for them here.

    Parameters
    ----------
    labels : int (H, W)
        0 where pixels are not valid.
    """
    padded = np.pad(labels, 1)
    around = (padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:])
    a, b, c, d = around
    straight = ((a == b) & (c == d)) | ((a == c) & (b == d))
    most = np.maximum.reduce(around)
    least = np.minimum.reduce([np.where(each > 0, each, most) for each in around])
    return int(np.count_nonzero(~straight & (least < most)))


def _means(raster: Raster, labels: Labels) -> Floats:
    inside = labels[raster.valid]
    count = np.maximum(np.bincount(inside), 1)
    image = np.full(raster.bands.shape, np.nan)
    for band, shown in zip(raster.bands, image, strict=True):
        shown[raster.valid] = (np.bincount(inside, band[raster.valid]) / count)[inside]
    return image
