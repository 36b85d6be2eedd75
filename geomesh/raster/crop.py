"""Crop a scene to its middle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.raster.grid import Window

if TYPE_CHECKING:
    from geomesh.raster.scene import Scene

# A picture shows only the middle of a larger scene, at full resolution, so that details are
# visible. Both in pixels: the limit, and the size of the middle.
LARGEST_SIDE = 2048
SHOWN_SIDE = 1024


def middle(scene: Scene) -> Scene:
    """Return the scene, or its middle if it is too large for a picture."""
    width, height = scene.grid.width, scene.grid.height
    if max(width, height) <= LARGEST_SIDE:
        return scene
    w, h = min(width, SHOWN_SIDE), min(height, SHOWN_SIDE)
    return scene.crop(Window((width - w) // 2, (height - h) // 2, w, h), scene.area)
