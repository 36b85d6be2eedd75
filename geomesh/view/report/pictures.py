"""The picture of a mesh on the map, and what pictures of a mesh have in common.

The triangle, or the colour, of each pixel is painted by compiled loops: so five million triangles
are no more work for a page than a few.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from geomesh.mesh.colors import brightening
from geomesh.mesh.topology import FILL
from geomesh.surface.paint import reconstruct
from geomesh.view.report.content import Picture
from geomesh.view.report.relief import find_scale, shaded
from geomesh.view.thumbnail import GRAY, colors_of, has_room, on_page, thumbnail, with_edges
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids
    from geomesh.mesh.triangle_mesh import TriangleMesh

# Longest side of the map, in pixels.
MAP_SIDE = 1000

# A picture is painted with so many times the pixels each way, and averaged: smooth edges.
FINER = 2

# Higher ones take several times as long, for a few percent.
_COMPRESSION = 6

# How much lighter the sides of triangles are in a relief.
_FAINT = 0.3


def map_picture(mesh: TriangleMesh) -> Picture:
    """Return the picture of the whole mesh, with the proportions of the map."""
    if mesh.heights is not None:
        page, window = on_page(mesh, FINER * MAP_SIDE)
        heights = reconstruct(page, mesh.triangles, mesh.heights[:, None], window, "linear")[0]
        fine = shaded(heights, find_scale(heights))
        if has_room(fine, len(mesh.triangles)):
            fine = with_edges(fine, find_owners(page, mesh.triangles, window), _FAINT)
        colored = "coloured by their heights, with light from the upper left"
    else:
        fine = thumbnail(mesh, FINER * MAP_SIDE)
        colored = "in the mean colour of their pixels"
        if colors_of(mesh) is None:
            colored = "(the mesh has no colours)"
    height, width = (max(side // FINER, 1) for side in fine.shape[:2])
    count = f"{len(mesh.triangles):,} triangles"
    west, south, east, north = mesh.grid.bounds()
    return Picture(
        as_png(averaged(fine, width, height)),
        width,
        height,
        f"Map of the mesh: {count}",
        f"{count} {colored}. The map reaches from x {west:.10g} to {east:.10g}, and from y "
        f"{south:.10g} to {north:.10g}.",
    )


def colored(mesh: TriangleMesh, owners: Ids) -> NDArray[np.uint8]:
    """Return a picture (h, w, 4) in which each pixel has the colour of its triangle (h, w)."""
    drawn = owners != FILL
    image = np.zeros((*owners.shape, 4), np.uint8)
    image[drawn, 3] = 255
    colors = colors_of(mesh)
    image[drawn, :3] = GRAY if colors is None else colors[owners[drawn]]
    return image


def brighter(image: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    """Return a picture (h, w, 4) with its colours multiplied by a factor, and clipped."""
    levels = np.minimum(image[..., :3] * factor, 255).astype(np.uint8)
    return np.dstack([levels, image[..., 3]])


def brightness(image: NDArray[np.uint8]) -> float:
    """Return the factor that brightens what is seen of a picture (h, w, 4)."""
    seen = image[image[..., 3] > 0][:, :3]
    return brightening(seen) if len(seen) else 1.0


def averaged(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Return a smaller picture. Colours count as much as their pixels are opaque."""
    weighted = image.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    small: NDArray[Any] = cv2.resize(weighted, (width, height), interpolation=cv2.INTER_AREA)
    opacity = small[..., 3:]
    small[..., :3] *= np.divide(255, opacity, out=np.zeros_like(opacity), where=opacity > 0)
    levels: NDArray[np.uint8] = np.clip(np.rint(small), 0, 255).astype(np.uint8)
    return levels


def as_png(image: NDArray[np.uint8]) -> bytes:
    """Return a picture (h, w, 4) as a PNG; without opacity where all of it is opaque."""
    order = cv2.COLOR_RGBA2BGR if (image[..., 3] == 255).all() else cv2.COLOR_RGBA2BGRA
    small = (cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION)
    _, png = cv2.imencode(".png", cv2.cvtColor(image, order), small)
    data: bytes = png.tobytes()
    return data
