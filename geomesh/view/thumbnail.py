"""Draw a mesh as a small image: each pixel has the colour of the triangle that owns it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.mesh.colors import brightened, parse_colors
from geomesh.mesh.topology import FILL
from geomesh.raster.grid import Window
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Ids, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh

# Longest and shortest side of a thumbnail, in pixels.
_LONGEST = 256
_SHORTEST = 8

# Gray level of triangles without a colour; visible on a white and on a black page.
GRAY = 128

# Sides of triangles are drawn lighter by this share, if a triangle has at least this number
# of pixels on average.
_EDGE = 0.35
_ROOM = 48


def thumbnail(mesh: TriangleMesh, longest: int = _LONGEST) -> NDArray[np.uint8]:
    """Draw a mesh with the proportions of the map; y points up, unless it is a row number.

    Parameters
    ----------
    mesh : TriangleMesh
    longest : int
        Longest side of the image, in pixels.

    Returns
    -------
    uint8 (h, w, 4)
        Red, green, blue and opacity; the opacity is 0 where there is no triangle.
    """
    page, window = on_page(mesh, longest)
    owners = find_owners(page, mesh.triangles, window)
    drawn = owners != FILL
    image = np.zeros((*window.shape, 4), np.uint8)
    image[drawn, :3] = _colors(mesh, owners[drawn])
    image[drawn, 3] = 255
    if has_room(image, len(mesh.triangles)):
        return with_edges(image, owners, _EDGE)
    return image


def with_edges(image: NDArray[np.uint8], owners: Ids, share: float) -> NDArray[np.uint8]:
    """Return an image (h, w, 4) with the sides of triangles lighter by a share.

    `owners` (h, w) are the triangles of its pixels.
    """
    edge = np.zeros(owners.shape, np.bool_)
    edge[:, 1:] |= owners[:, 1:] != owners[:, :-1]
    edge[1:] |= owners[1:] != owners[:-1]
    edge &= image[..., 3] > 0
    lighter = image.copy()
    lighter[edge, :3] += ((255 - image[edge, :3]) * share).astype(np.uint8)
    return lighter


def has_room(image: NDArray[np.uint8], triangles: int) -> bool:
    """Return whether triangles are large enough in an image (h, w, 4) to show their sides."""
    return bool(np.count_nonzero(image[..., 3]) > _ROOM * triangles)


def on_page(mesh: TriangleMesh, longest: int = _LONGEST) -> tuple[Points, Window]:
    """Return the nodes in pixel coordinates of the thumbnail, and its window."""
    grid = mesh.grid
    west, south, east, north = grid.bounds()
    width, height = east - west, (north - south) * grid.aspect
    scale = longest / max(width, height)
    w, h = (max(round(side * scale), _SHORTEST) for side in (width, height))
    x = (mesh.map_nodes[:, 0] - west) * (w / (east - west))
    down = mesh.map_nodes[:, 1] - south if grid.y_runs_down else north - mesh.map_nodes[:, 1]
    return np.column_stack([x, down * (h / (north - south))]), Window(0, 0, w, h)


def colors_of(mesh: TriangleMesh) -> NDArray[np.uint8] | None:
    """Return red, green and blue (T, 3) of the triangles; None if the mesh has no colours."""
    if "color" not in mesh.triangle_table:
        return None
    try:
        return parse_colors(mesh.triangle_table["color"])
    except ValueError:  # a column of this name with something else
        return None


def _colors(mesh: TriangleMesh, triangles: NDArray[np.int32]) -> NDArray[np.uint8]:
    colors = colors_of(mesh)
    if colors is None or not len(triangles):
        return np.full((len(triangles), 3), GRAY, np.uint8)
    return brightened(colors[triangles])
