"""Stage 3: find SIFT keypoints, and choose those that become nodes."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from geomesh.arrays.jit import boolean, float64, int32, int64, kernel, reads, void, writes
from geomesh.arrays.table import read_only

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray, Ids, Mask
    from geomesh.raster.grid import Window
    from geomesh.recipe import Recipe


@dataclass(frozen=True, eq=False)
class Keypoints:
    """SIFT keypoints as columns.

    Attributes
    ----------
    xy : float64 (N, 2)
        Pixel-edge coordinates.
    scale : float32 (N,)
        Diameter of the neighbourhood of the keypoint, in pixels.
    angle : float32 (N,)
        Orientation in degrees, clockwise from the x axis as seen in the image.
    response : float32 (N,)
        Contrast of the extremum. A larger value is a stronger keypoint.
    octave : int8 (N,)
        -1 is the doubled image, 0 the native one.
    """

    xy: NDArray[np.float64]
    scale: NDArray[np.float32]
    angle: NDArray[np.float32]
    response: NDArray[np.float32]
    octave: NDArray[np.int8]

    def __post_init__(self) -> None:
        for name, values in self.__dict__.items():
            object.__setattr__(self, name, read_only(values))

    def __len__(self) -> int:
        return len(self.xy)

    def take(self, index: NDArray[Any]) -> Keypoints:
        """Return the keypoints at `index`, in that order."""
        return Keypoints(*(column[index] for column in self.__dict__.values()))

    def moved(self, xy: NDArray[np.float64]) -> Keypoints:
        """Return the keypoints with the coordinates replaced by `xy`."""
        return Keypoints(xy, self.scale, self.angle, self.response, self.octave)

    @classmethod
    def join(cls, parts: Iterable[Keypoints]) -> Keypoints:
        """Return all keypoints of `parts`, in order."""
        columns = [list(part.__dict__.values()) for part in parts] or [_NO_COLUMNS]
        return cls(*(np.concatenate(column) for column in zip(*columns, strict=True)))


_NO_COLUMNS = [np.zeros((0, 2)), *(np.zeros(0, np.float32) for _ in range(3)), np.zeros(0, np.int8)]


def detect_sift(image: Gray, recipe: Recipe) -> Keypoints:
    """Return the SIFT keypoints of an 8-bit image (H, W), one for each position.

    OpenCV returns one keypoint for each orientation. Of those at one position, the strongest
    is kept (then the larger scale, then the smaller angle). They are sorted by y, then x.
    """
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]
        nOctaveLayers=recipe.sift_octave_layers,
        contrastThreshold=recipe.sift_contrast_threshold,
        edgeThreshold=recipe.sift_edge_threshold,
        sigma=recipe.sift_sigma,
        # Without this, every keypoint is wrong by a quarter of a pixel.
        enable_precise_upscale=True,
    )
    # OpenCV always doubles its input. If that is not wanted, halve the image first.
    pixel = 1 if recipe.sift_upsample else 2
    detected = sift.detect(np.ascontiguousarray(image if pixel == 1 else _halve(image)), None)
    # Copy one attribute at a time. A Python loop over keypoints would block the other threads.
    points = np.asarray(cv2.KeyPoint.convert(detected), np.float64).reshape(-1, 2)
    size, angle, response = (
        np.fromiter(map(attrgetter(name), detected), np.float32, len(detected))
        for name in ("size", "angle", "response")
    )
    packed = np.fromiter(map(attrgetter("octave"), detected), np.int64, len(detected))
    # OpenCV packs octave, layer and offset into one int; the octave is its signed low byte.
    octave = (packed & 0xFF).astype(np.uint8).view(np.int8)
    octave += np.int8(pixel - 1)
    if recipe.sift_max_octave is None:
        kept = np.arange(len(detected))
    else:
        kept = np.flatnonzero(octave <= recipe.sift_max_octave)
    x, y = points[kept].T
    kept = kept[np.lexsort((angle[kept], -size[kept], -response[kept], x, y))]
    kept = kept[np.diff(points[kept], axis=0, prepend=np.nan).any(axis=1)]
    # The origin of OpenCV is the centre of the first pixel; the origin here is its corner.
    xy = (points[kept] + 0.5) * pixel
    scale = size[kept] * np.float32(pixel)
    return Keypoints(xy, scale, angle[kept], response[kept], octave[kept])


def _halve(image: Gray) -> Gray:
    """Return the means of 2 x 2 pixels. The last row or column of an odd number is doubled."""
    height, width = image.shape
    even = np.pad(image, ((0, height % 2), (0, width % 2)), mode="edge")
    size = (even.shape[1] // 2, even.shape[0] // 2)
    return cv2.resize(even, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def labels_around(
    points: NDArray[np.float64], labels: NDArray[np.int32], window: Window, distance: float
) -> NDArray[np.int32]:
    """Return the edge labels within `distance` of the pixel of each point.

    Parameters
    ----------
    points : float64 (N, 2)
        Pixel-edge coordinates of the image.
    labels : int32 (h, w)
        Edge components in `window`; 0 is no edge.
    distance : float
        Distance between pixel centres, in pixels.

    Returns
    -------
    int32 (N, K)
        One column for each pixel of the disc; 0 is no edge.
    """
    reach = int(distance)
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = dx**2 + dy**2 <= distance**2
    pixel = np.floor(points).astype(np.int64)
    cols = pixel[:, :1] - window.col + dx[disc]
    rows = pixel[:, 1:] - window.row + dy[disc]
    inside = (cols >= 0) & (cols < window.width) & (rows >= 0) & (rows < window.height)
    height, width = labels.shape
    around = labels[np.clip(rows, 0, height - 1), np.clip(cols, 0, width - 1)]
    return np.where(inside, around, 0).astype(np.int32)


def by_strength(keypoints: Keypoints) -> Keypoints:
    """Return the keypoints sorted from the strongest; then by scale, y, x and angle.

    The result does not depend on the input order, so every choice of nodes is reproducible.
    """
    x, y = keypoints.xy.T
    order = np.lexsort((keypoints.angle, x, y, -keypoints.scale, -keypoints.response))
    return keypoints.take(order)


def thin(keypoints: Keypoints, spacing: float) -> Keypoints:
    """Return the keypoints, strongest first, without those closer than `spacing` to a stronger.

    `spacing` is in pixels. Only keypoints that are kept count.
    """
    ranked = by_strength(keypoints)
    if spacing <= 0 or len(ranked) == 0:
        return ranked
    return ranked.take(_chosen(ranked.xy, spacing))


def _chosen(xy: NDArray[np.float64], spacing: float) -> Mask:
    """Return which points are kept. Each kept point excludes later points closer than `spacing`.

    A hash table of square cells finds the neighbours.
    """
    cells = ((xy - xy.min(axis=0)) / spacing).astype(np.int64) + 1
    columns = int(cells[:, 0].max()) + 2
    slots = 1 << max(2 * len(xy) - 1, 1).bit_length()
    head, link = np.full(slots, -1, np.int32), np.full(len(xy), -1, np.int32)
    keep = np.zeros(len(xy), np.bool_)
    numbers = np.ascontiguousarray(cells[:, 1] * columns + cells[:, 0])
    _thin(np.ascontiguousarray(xy), numbers, columns, spacing * spacing, head, link, keep)
    return keep


@kernel(
    void(
        reads(float64, 2),
        reads(int64, 1),
        int64,
        float64,
        writes(int32, 1),
        writes(int32, 1),
        writes(boolean, 1),
    )
)
def _thin(
    xy: NDArray[np.float64],
    numbers: NDArray[np.int64],
    columns: int,
    least: float,
    head: Ids,
    link: Ids,
    keep: Mask,
) -> None:
    """Set `keep`. `head` and `link` are linked lists of kept points, one for each hash slot."""
    last = len(head) - 1
    for i in range(len(xy)):
        free = True
        for cell in range(9):
            number = numbers[i] + (cell // 3 - 1) * columns + cell % 3 - 1
            j = head[(number * 0x9E3779B1) & last]
            while j >= 0 and free:
                dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                free = dx * dx + dy * dy >= least
                j = link[j]
        if free:
            keep[i] = True
            slot = (numbers[i] * 0x9E3779B1) & last
            link[i] = head[slot]
            head[slot] = i


def spread_evenly(ranked: Keypoints, budget: int, area: float) -> NDArray[np.intp]:
    """Return an order of the keypoints in which the first ones are always spread evenly.

    The image is divided into square cells, each for about four nodes of the budget. First
    comes the strongest keypoint of every cell, then the second of every cell, and so on.
    Within a round, stronger keypoints come first.

    Parameters
    ----------
    ranked : Keypoints
        Strongest first.
    budget : int
        Number of nodes.
    area : float
        Area to spread them over, in square pixels.

    Returns
    -------
    intp (N,)
    """
    side = max(np.sqrt(4 * area / budget), 1.0)
    cell = np.floor(ranked.xy / side).astype(np.int64)
    key = (cell[:, 1] << 32) + cell[:, 0]
    grouped = np.argsort(key, kind="stable")  # within a cell, the strongest stays first
    starts = np.flatnonzero(np.diff(key[grouped], prepend=key[grouped[:1]] - 1))
    sizes = np.diff(np.append(starts, len(key)))
    rank = np.empty(len(key), np.int64)  # of each keypoint in its cell
    rank[grouped] = np.arange(len(key)) - np.repeat(starts, sizes)
    return np.argsort(rank, kind="stable")
