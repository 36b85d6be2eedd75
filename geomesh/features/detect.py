"""Run stages 2 and 3 on all tiles: from the gray image to keypoints on its edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from geomesh.domain.outline import Turns, find_turns
from geomesh.features.canny import (
    EdgePartial,
    Thresholds,
    canny_edges,
    canny_thresholds,
    tile_edges,
    unite,
)
from geomesh.features.edge_pixels import EdgePixels, WeakPixels, join_pixels
from geomesh.features.filters import resize
from geomesh.features.gray_image import ArrayGray, GrayImage
from geomesh.features.sift import Keypoints, detect_sift, labels_around
from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.tiles import HALO, Tile, map_tiles, plan_tiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray
    from geomesh.parallel.workers import Workers
    from geomesh.raster.grid import Window
    from geomesh.recipe import Recipe

# Two tiles may find a keypoint on their common border at slightly different coordinates. So each
# tile also keeps keypoints up to this distance outside its core, in pixels. Copies are merged.
SEAM = 1 / 32


@dataclass(frozen=True)
class Survey:
    """The valid pixels of the source: their outline and their number.

    Attributes
    ----------
    turns : tuple of Turns
        Where the outline of the valid pixels turns.
    valid_pixels : int
    """

    turns: tuple[Turns, ...]
    valid_pixels: int


@dataclass(frozen=True)
class Detection:
    """The result of stages 2 and 3.

    Attributes
    ----------
    keypoints : Keypoints
        Keypoints on edges and on valid pixels, in pixel-edge coordinates of the image
        after `resize`.
    size : (int, int)
        Width and height of that image.
    survey : Survey
    thresholds : Thresholds
        The Canny thresholds that were used.
    edges : EdgePixels, optional
        The pixels of Canny edges, if they were asked for.
    """

    keypoints: Keypoints
    size: tuple[int, int]
    survey: Survey
    thresholds: Thresholds
    edges: EdgePixels | None = None


@dataclass(frozen=True)
class _TileFeatures:
    """The features of one tile.

    Attributes
    ----------
    keypoints : Keypoints
        Keypoints in the core that are near an edge, or near a component that may be one.
    certain : bool (N,)
        Whether the keypoint is certainly near an edge.
    open_point, open_label : intp (K,)
        Pairs of a keypoint and a component near it that other tiles see too. Whether this
        component is an edge is known only after `unite`.
    edges : EdgePartial
    survey : Survey
    pixels : WeakPixels, optional
    """

    keypoints: Keypoints
    certain: NDArray[np.bool_]
    open_point: NDArray[np.intp]
    open_label: NDArray[np.intp]
    edges: EdgePartial
    survey: Survey
    pixels: WeakPixels | None = None

    def on_edges(self, is_edge: NDArray[np.bool_]) -> Keypoints:
        """Return the keypoints near an edge. `is_edge` (K + 1,) marks the components that are."""
        kept = self.certain.copy()
        kept[self.open_point[is_edge[self.open_label]]] = True
        return self.keypoints.take(kept)


def detect_keypoints(
    image: GrayImage,
    recipe: Recipe,
    workers: Workers,
    progress: Progress,
    *,
    keep_edges: bool = False,
) -> Detection:
    """Find the keypoints of a gray image that lie on its Canny edges.

    Parameters
    ----------
    image : GrayImage
        At the resolution of the source. It is resized if the recipe says so.
    recipe : Recipe
    workers : Workers
    progress : callable(fraction, message)
    keep_edges : bool
        Return the edge pixels too.
    """
    survey = None
    if recipe.resize is not None:
        image, survey = shrink(image, recipe.resize, workers, part_of(progress, 0, 0.6))
        progress = part_of(progress, 0.6, 1)
    extent = image.extent
    core = {} if recipe.is_local else {"core": max(extent.width, extent.height)}
    tiles = plan_tiles(extent, **core)
    thresholds = canny_thresholds(image, recipe)
    parts = list(
        map_tiles(
            _DetectFeatures(recipe, thresholds, keep_edges),
            ((image.excerpt(tile.read), tile) for tile in tiles),
            len(tiles),
            workers,
            progress=progress,
            message="Detecting edges and keypoints",
        )
    )
    is_edge = unite([part.edges for part in parts])
    keypoints = [part.on_edges(edge) for part, edge in zip(parts, is_edge, strict=True)]
    return Detection(
        keypoints=Keypoints.join(keypoints),
        size=(extent.width, extent.height),
        survey=survey or _join([part.survey for part in parts]),
        thresholds=thresholds,
        edges=join_pixels([part.pixels for part in parts if part.pixels is not None], is_edge)
        if keep_edges
        else None,
    )


def shrink(
    image: GrayImage, size: tuple[int, int], workers: Workers, progress: Progress
) -> tuple[ArrayGray, Survey]:
    """Read a whole gray image by tiles and resize it to (width, height).

    This needs two bytes of memory per pixel of the source, because tiles cannot be resized
    separately.
    """
    extent = image.extent
    gray = np.empty(extent.shape, np.uint8)
    valid = np.empty(extent.shape, np.bool_)
    tiles = plan_tiles(extent)
    parts = map_tiles(
        _read_core,
        ((image.excerpt(tile.read), tile) for tile in tiles),
        len(tiles),
        workers,
        progress=progress,
        message="Reading and resizing",
    )
    surveys = []
    for tile, (block, known, survey) in zip(tiles, parts, strict=True):
        gray[tile.core.slices()], valid[tile.core.slices()] = block, known
        surveys.append(survey)
    share = resize(valid.view(np.uint8) * np.uint8(255), size)
    return ArrayGray.whole(resize(gray, size), share > 127), _join(surveys)


def _read_core(task: tuple[GrayImage, Tile]) -> tuple[Gray, NDArray[np.bool_], Survey]:
    """Return the gray levels and the valid pixels of a tile's core, and its survey."""
    image, tile = task
    gray, valid = image.read(tile.read)
    inner = tile.core.slices(tile.read)
    return gray[inner], valid[inner], _survey(valid, tile, image.extent)


def _survey(valid: NDArray[np.bool_], tile: Tile, extent: Window) -> Survey:
    inner = valid[tile.core.slices(tile.read)]
    return Survey((find_turns(valid, tile, extent),), int(np.count_nonzero(inner)))


def _join(surveys: Sequence[Survey]) -> Survey:
    turns = tuple(turns for survey in surveys for turns in survey.turns)
    return Survey(turns, sum(survey.valid_pixels for survey in surveys))


@dataclass(frozen=True)
class _DetectFeatures:
    """Find the features of one tile of an image."""

    recipe: Recipe
    thresholds: Thresholds
    keep_edges: bool = False

    def __call__(self, task: tuple[GrayImage, Tile]) -> _TileFeatures:
        image, tile = task
        recipe, thresholds = self.recipe, self.thresholds
        gray, valid = image.read(tile.read)
        distance = recipe.edge_distance or 0.0
        weak, partial = tile_edges(
            gray,
            valid,
            tile,
            thresholds,
            image_width=image.extent.width,
            seam=int(distance) + 2,
        )
        width, l2 = image.extent.width, thresholds.l2
        pixels = WeakPixels.of(weak, partial, tile, width, l2=l2) if self.keep_edges else None
        seen = (
            canny_edges(gray, thresholds, valid) * np.uint8(255)
            if recipe.sift_source == "edges"
            else gray
        )
        points = detect_sift(seen, recipe) if valid.any() else Keypoints.join([])
        points = points.moved(points.xy + np.array([tile.read.col, tile.read.row]))
        keypoints = points.take(
            _in_core(points.xy, tile) & _usable(points.xy, valid, tile, image, recipe)
        )
        survey = _survey(valid, tile, image.extent)
        if recipe.edge_distance is None:
            nothing = np.empty(0, np.intp)
            certain = np.ones(len(keypoints), np.bool_)
            return _TileFeatures(keypoints, certain, nothing, nothing, partial, survey, pixels)
        # Keep only those labels around keypoints that depend on other tiles. Otherwise memory
        # would grow with the area of the disc.
        labels = labels_around(keypoints.xy, weak.labels, weak.window, distance)
        leaves = np.zeros(len(partial.strong), np.bool_)
        leaves[partial.seam_labels] = True
        certain = np.any(partial.strong[labels], axis=1)
        near = certain | np.any(leaves[labels], axis=1)
        keypoints, labels, certain = keypoints.take(near), labels[near], certain[near]
        point, column = np.nonzero(leaves[labels] & ~certain[:, None])
        open_label = labels[point, column].astype(np.intp)
        return _TileFeatures(keypoints, certain, point, open_label, partial, survey, pixels)


def _in_core(points: NDArray[np.float64], tile: Tile) -> NDArray[np.bool_]:
    low = np.array([tile.core.col, tile.core.row]) - SEAM
    high = np.array([tile.core.stop_col, tile.core.stop_row]) + SEAM
    inside: NDArray[np.bool_] = np.all((points >= low) & (points < high), axis=1)
    return inside


def _usable(
    points: NDArray[np.float64],
    valid: NDArray[np.bool_],
    tile: Tile,
    image: GrayImage,
    recipe: Recipe,
) -> NDArray[np.bool_]:
    """Return which points are on valid pixels and not too close to the outline.

    Points closer than `min_spacing` are too close, because the outline gets its own nodes. If
    the domain is "hull", it gets none, and points may be anywhere.
    """
    window, extent = tile.read, image.extent
    usable: NDArray[np.uint8] = valid.view(np.uint8)
    if recipe.domain != "hull":
        known = usable if recipe.domain == "valid" else np.ones_like(usable)
        # Pixels outside of the image are invalid. Pixels outside of the halo are unknown.
        top, bottom = int(window.row == extent.row), int(window.stop_row == extent.stop_row)
        left, right = int(window.col == extent.col), int(window.stop_col == extent.stop_col)
        framed = np.pad(known, ((top, bottom), (left, right)))
        reach = min(int(np.ceil(recipe.min_spacing)), HALO)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        eroded = cv2.erode(framed, disc, borderType=cv2.BORDER_REPLICATE).astype(np.uint8)
        height, width = usable.shape
        usable = usable & eroded[top : top + height, left : left + width]
    pixel = np.floor(points).astype(np.int64) - (window.col, window.row)
    pixel = np.clip(pixel, 0, np.array([window.width, window.height]) - 1)
    is_usable: NDArray[np.bool_] = usable[pixel[:, 1], pixel[:, 0]] > 0
    return is_usable
