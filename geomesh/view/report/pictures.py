"""The pictures of a report: the mesh on the map, and beside its image on the raster's pixels.

The triangle, or the colour, of each pixel is painted by compiled loops: so five million triangles
are no more work for a page than a few.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from geomesh.mesh.colors import parse_colors
from geomesh.mesh.topology import FILL
from geomesh.pipeline.mesh_scene import scene_tone
from geomesh.raster.grid import Window
from geomesh.recipe import Recipe
from geomesh.surface.paint import reconstruct
from geomesh.view.report.content import Picture
from geomesh.view.report.relief import find_scale, shaded
from geomesh.view.thumbnail import GRAY, has_room, on_page, thumbnail
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids
    from geomesh.features.gray import Tone
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.view.report.errors import Original

# Longest sides, in pixels: of the map, and of each of two pictures side by side.
MAP_SIDE = 1000
_SIDE = 640

# A picture is painted with so many times the pixels each way, and averaged: smooth edges.
_FINER = 2

# Sides of the detail, in pixels of the raster: a third of the raster, within these limits.
_DETAIL = (24, 240)

# Higher ones take several times as long, for a few percent.
_COMPRESSION = 6

# How much lighter the sides of triangles are, and those of a relief.
_EDGE = 0.5
_FAINT = 0.3


def map_picture(mesh: TriangleMesh) -> Picture:
    """Return the picture of the whole mesh, with the proportions of the map."""
    if mesh.heights is not None:
        page, window = on_page(mesh, _FINER * MAP_SIDE)
        heights = reconstruct(page, mesh.triangles, mesh.heights[:, None], window, "linear")[0]
        fine = shaded(heights, find_scale(heights))
        if has_room(fine, len(mesh.triangles)):
            fine = _with_edges(fine, find_owners(page, mesh.triangles, window), _FAINT)
        colored = "coloured by their heights, with light from the upper left"
    else:
        fine = thumbnail(mesh, _FINER * MAP_SIDE)
        colored = "in the mean colour of their pixels"
        if "color" not in mesh.triangle_table:
            colored = "(the mesh has no colours)"
    height, width = (max(side // _FINER, 1) for side in fine.shape[:2])
    count = f"{len(mesh.triangles):,} triangles"
    west, south, east, north = mesh.grid.bounds()
    return Picture(
        _png(_averaged(fine, width, height)),
        width,
        height,
        f"Map of the mesh: {count}",
        f"{count} {colored}. The map reaches from x {west:.10g} to {east:.10g}, and from y "
        f"{south:.10g} to {north:.10g}.",
    )


def pairs(
    mesh: TriangleMesh, original: Original | None, workers: Workers, progress: Progress
) -> tuple[tuple[Picture, ...], ...]:
    """Return pictures to set side by side: the whole raster and its mesh, then a detail.

    Without the raster, there is only the mesh.
    """
    whole, detail = mesh.grid.extent, busiest(mesh)
    tone = None
    if original is not None:
        recipe = Recipe() if mesh.provenance is None else mesh.provenance.recipe
        tone = scene_tone(original.scene, recipe, workers, progress)
    shown = []
    for window, name in ((whole, "The whole raster"), (detail, "A detail")):
        if window == whole and name == "A detail":
            continue
        shown.append(_pair(mesh, window, original, tone, is_detail=window is detail))
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
    part = f"columns {window.col:,} to {window.stop_col:,}, rows {window.row:,} to "
    part += f"{window.stop_row:,}"
    place = f"Detail, {part}" if is_detail else "The whole raster"
    pictures = []
    for name, painted in _image_and_surface(mesh, window, (width, height), original, tone):
        levels = painted
        if name == "mesh" and is_detail:
            levels = _with_edges(levels, _owners(mesh, window, levels.shape))
        if name == "mesh":
            levels = _averaged(levels, width, height)
        caption = {"image": "The image", "mesh": "The mesh"}[name]
        size = (
            f" One pixel of the raster is {width // window.width} pixels wide here."
            if is_detail and name == "image"
            else ""
        )
        pictures.append(
            Picture(
                _png(levels),
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

    The mesh has `_FINER` times the pixels each way.
    """
    width, height = size
    fine = Window(0, 0, _FINER * width, _FINER * height)
    if original is None or tone is None:
        levels = _colored(mesh, _owners(mesh, window, fine.shape))
        return [("mesh", _brighter(levels, _brightness(levels)))]
    scene, surface = original.scene, original.surface
    shape = min(height, window.height), min(width, window.width)
    bands, valid = scene.read(window, shape if shape != window.shape else None)
    nodes = _on_picture(mesh, window, fine.shape)
    names = [band.name for band in scene.bands]
    height_band = None if mesh.height is None else mesh.height.band
    used = sorted({names.index(height_band)} if height_band in names else set(scene.display))
    values = reconstruct(nodes, mesh.triangles, surface.values[:, used], fine, surface.model)
    if height_band in names:
        heights = np.where(valid, bands[used[0]].astype(np.float64), np.nan)
        step = window.width / shape[1]
        scale = find_scale(heights, step)
        image = shaded(heights, scale, step)
        levels = shaded(values[0], scale, window.width / fine.width)
    else:
        every = np.zeros((len(scene.bands), *fine.shape))
        every[used] = values
        image = _displayed(tone.display(bands), scene.display, valid)
        known = np.asarray(np.isfinite(values).all(axis=0))
        levels = _displayed(tone.display(every), scene.display, known)
        factor = _brightness(image)
        image, levels = _brighter(image, factor), _brighter(levels, factor)
    # All pixels of a small image keep their borders.
    larger = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST).astype(np.uint8)
    return [("image", larger), ("mesh", levels)]


def _brighter(image: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    levels = np.minimum(image[..., :3] * factor, 255).astype(np.uint8)
    return np.dstack([levels, image[..., 3]])


def _displayed(
    levels: NDArray[np.uint8], display: tuple[int, int, int], valid: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return red, green, blue and opacity (h, w, 4) of bands (B, h, w)."""
    colors = np.moveaxis(levels[list(display)], 0, -1)
    return np.dstack([colors, np.where(valid, 255, 0).astype(np.uint8)])


def _brightness(image: NDArray[np.uint8]) -> float:
    """Return the factor by which `geomesh.mesh.colors.brightened` multiplies an image."""
    seen = image[image[..., 3] > 0][:, :3]
    if not len(seen):
        return 1.0
    return max(255 / max(float(np.percentile(seen, 99)), 1.0), 1.0)


def _owners(mesh: TriangleMesh, window: Window, shape: tuple[int, ...]) -> Ids:
    height, width = shape[:2]
    nodes = _on_picture(mesh, window, (height, width))
    return find_owners(nodes, mesh.triangles, Window(0, 0, width, height))


def _on_picture(mesh: TriangleMesh, window: Window, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the nodes in pixels of a picture of a window."""
    height, width = shape
    scale = width / window.width, height / window.height
    return (mesh.nodes - (window.col, window.row)) * scale


def _colored(mesh: TriangleMesh, owners: Ids) -> NDArray[np.uint8]:
    drawn = owners != FILL
    image = np.zeros((*owners.shape, 4), np.uint8)
    image[drawn, 3] = 255
    if "color" in mesh.triangle_table:
        image[drawn, :3] = parse_colors(mesh.triangle_table["color"])[owners[drawn]]
    else:
        image[drawn, :3] = GRAY
    return image


def _with_edges(image: NDArray[np.uint8], owners: Ids, share: float = _EDGE) -> NDArray[np.uint8]:
    """Return the picture with the sides of the triangles lighter by a share."""
    edge = np.zeros(owners.shape, np.bool_)
    edge[:, 1:] |= owners[:, 1:] != owners[:, :-1]
    edge[1:] |= owners[1:] != owners[:-1]
    edge &= image[..., 3] > 0
    lighter = image.copy()
    lighter[edge, :3] += ((255 - image[edge, :3]) * share).astype(np.uint8)
    return lighter


def _averaged(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Return a smaller picture. Colours count as much as their pixels are opaque."""
    weighted = image.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    small: NDArray[Any] = cv2.resize(weighted, (width, height), interpolation=cv2.INTER_AREA)
    opacity = small[..., 3:]
    small[..., :3] *= np.divide(255, opacity, out=np.zeros_like(opacity), where=opacity > 0)
    levels: NDArray[np.uint8] = np.clip(np.rint(small), 0, 255).astype(np.uint8)
    return levels


def _png(image: NDArray[np.uint8]) -> bytes:
    """Return a picture (h, w, 4) as a PNG; without opacity where all of it is opaque."""
    order = cv2.COLOR_RGBA2BGR if (image[..., 3] == 255).all() else cv2.COLOR_RGBA2BGRA
    small = (cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION)
    _, png = cv2.imencode(".png", cv2.cvtColor(image, order), small)
    data: bytes = png.tobytes()
    return data
