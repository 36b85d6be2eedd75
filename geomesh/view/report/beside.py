"""Pictures side by side: the raster, and the mesh on its pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from geomesh.pipeline.mesh_scene import scene_tone
from geomesh.raster.grid import Window
from geomesh.recipe import Recipe
from geomesh.surface.paint import reconstruct
from geomesh.view.report.content import Picture
from geomesh.view.report.pictures import (
    FINER,
    as_png,
    averaged,
    brighter,
    brightness,
    colored,
)
from geomesh.view.report.relief import find_scale, shaded
from geomesh.view.thumbnail import with_edges
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids
    from geomesh.features.gray import Tone
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.pixels import Pixels
    from geomesh.raster.scene import Scene
    from geomesh.view.report.errors import Original

# Longest side of each of the two pictures, in pixels.
_SIDE = 640

# How much lighter the sides of triangles are in the detail.
_EDGE = 0.5

# Sides of the detail, in pixels of the raster: a third of the raster, within these limits.
_DETAIL = (24, 240)


def pairs(
    mesh: TriangleMesh, original: Original | None, workers: Workers, progress: Progress
) -> tuple[tuple[Picture, ...], ...]:
    """Return pictures to set side by side: the whole raster and its mesh, then a detail.

    Without the raster, there is only the mesh: all of it, and the detail beside it.
    """
    whole, detail = mesh.grid.extent, busiest(mesh)
    tone = None
    if original is not None:
        recipe = Recipe() if mesh.provenance is None else mesh.provenance.recipe
        tone = scene_tone(original.scene, recipe, workers, progress)
    shown = [_pair(mesh, whole, original, tone, is_detail=False)]
    if detail != whole:
        shown.append(_pair(mesh, detail, original, tone, is_detail=True))
    if original is None:
        return (tuple(picture for pair in shown for picture in pair),)
    return tuple(shown)


def busiest(mesh: TriangleMesh) -> Window:
    """Return the window of a detail: where the mesh has most nodes."""
    width, height = mesh.grid.width, mesh.grid.height
    least, most = _DETAIL
    w, h = (min(max(side // 3, least), most, side) for side in (width, height))
    w, h = min(w, 3 * h), min(h, 3 * w)
    # Half a window apart, so that one of them has most of any cluster.
    columns, rows = max(2 * width // w - 1, 1), max(2 * height // h - 1, 1)
    counts = np.zeros((rows + 1, columns + 1), np.int64)
    col = np.clip(mesh.nodes[:, 0] / (w / 2), 0, columns).astype(int)
    row = np.clip(mesh.nodes[:, 1] / (h / 2), 0, rows).astype(int)
    np.add.at(counts, (row, col), 1)
    sums = counts[:-1, :-1] + counts[1:, :-1] + counts[:-1, 1:] + counts[1:, 1:]
    best_row, best_col = np.unravel_index(int(sums.argmax()), sums.shape)
    return Window(
        min(int(best_col * w / 2), width - w), min(int(best_row * h / 2), height - h), w, h
    )


def _pair(
    mesh: TriangleMesh,
    window: Window,
    original: Original | None,
    tone: Tone | None,
    *,
    is_detail: bool,
) -> tuple[Picture, ...]:
    scale = _SIDE / max(window.width, window.height)
    if is_detail:
        scale = max(round(scale), 1)
    width, height = (max(round(side * scale), 1) for side in (window.width, window.height))
    part = f"columns {window.col} to {window.stop_col - 1}, rows {window.row} to "
    part += f"{window.stop_row - 1}"
    place = f"Detail, {part}" if is_detail else "All of it"
    pictures = []
    for name, painted in _image_and_surface(mesh, window, (width, height), original, tone):
        levels = painted
        if name == "mesh" and is_detail:
            levels = with_edges(levels, _owners(mesh, window, levels.shape), _EDGE)
        if name == "mesh":
            levels = averaged(levels, width, height)
        caption = {"image": "The image", "mesh": "The mesh"}[name]
        size = (
            f" One pixel of the raster is {width // window.width} pixels wide here."
            if is_detail and name == "image"
            else ""
        )
        pictures.append(
            Picture(
                as_png(levels),
                levels.shape[1],
                levels.shape[0],
                f"{caption}: {place.lower()}",
                f"{caption}. {place}.{size}",
            )
        )
    return tuple(pictures)


def _image_and_surface(
    mesh: TriangleMesh,
    window: Window,
    size: tuple[int, int],
    original: Original | None,
    tone: Tone | None,
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Return the image and the mesh in a window, both with the same colours.

    The mesh has `FINER` times the pixels each way.
    """
    width, height = size
    fine = Window(0, 0, FINER * width, FINER * height)
    if original is None or tone is None:
        levels = colored(mesh, _owners(mesh, window, fine.shape))
        return [("mesh", brighter(levels, brightness(levels)))]
    scene, surface, lift = original.scene, original.surface, mesh.height
    names = [band.name for band in scene.bands]
    is_relief = lift is not None and lift.band in names
    # Only the bands that are shown: there may be thousands.
    chosen = list(dict.fromkeys(scene.display))
    if lift is not None and is_relief:
        chosen = [names.index(lift.band)]
    step = max(max(window.width, window.height) // (FINER * _SIDE), 1)
    bands, valid = _every_nth(_only(scene, chosen), window, step)
    nodes = _on_picture(mesh, window, fine.shape)
    values = reconstruct(nodes, mesh.triangles, surface.values[:, chosen], fine, surface.model)
    if lift is not None and is_relief:
        heights = np.where(valid, bands[0].astype(np.float64), np.nan) * lift.factor
        scale = find_scale(heights, step)
        image = shaded(heights, scale, step)
        levels = shaded(values[0] * lift.factor, scale, window.width / fine.width)
    else:
        rgb = [chosen.index(position) for position in scene.display]
        if tone.display_ranges is not None:
            tone = replace(tone, display_ranges=tuple(tone.display_ranges[k] for k in chosen))
        image = _displayed(tone.display(bands)[rgb], valid)
        known = np.asarray(np.isfinite(values).all(axis=0))
        levels = _displayed(tone.display(values)[rgb], known)
        factor = brightness(image)
        image, levels = brighter(image, factor), brighter(levels, factor)
    if image.shape[1] > width or image.shape[0] > height:
        return [("image", averaged(image, width, height)), ("mesh", levels)]
    # Each pixel keeps its borders.
    larger = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
    return [("image", larger), ("mesh", levels)]


def _every_nth(scene: Scene, window: Window, step: int) -> Pixels:
    """Read one pixel of each block of `step` x `step` pixels of a window.

    What is left over at the right and below is less than a block: less than a pixel of a picture.
    """
    if step == 1:
        return scene.read(window)
    shape = max(window.height // step, 1), max(window.width // step, 1)
    height, width = (
        count * step if side >= step else side
        for count, side in zip(shape, window.shape, strict=True)
    )
    return scene.read(replace(window, width=width, height=height), shape)


def _only(scene: Scene, positions: Sequence[int]) -> Scene:
    """Return a scene with only some of its bands."""
    scalings = tuple(scene.scalings[k] for k in positions) if scene.scalings else ()
    return replace(scene, bands=tuple(scene.bands[k] for k in positions), scalings=scalings)


def _displayed(levels: NDArray[np.uint8], valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return red, green, blue and opacity (h, w, 4) of three bands (3, h, w)."""
    colors = np.moveaxis(levels, 0, -1)
    return np.dstack([colors, np.where(valid, 255, 0).astype(np.uint8)])


def _owners(mesh: TriangleMesh, window: Window, shape: tuple[int, ...]) -> Ids:
    height, width = shape[:2]
    nodes = _on_picture(mesh, window, (height, width))
    return find_owners(nodes, mesh.triangles, Window(0, 0, width, height))


def _on_picture(mesh: TriangleMesh, window: Window, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the nodes in pixels of a picture of a window."""
    height, width = shape
    scale = width / window.width, height / window.height
    return (mesh.nodes - (window.col, window.row)) * scale
