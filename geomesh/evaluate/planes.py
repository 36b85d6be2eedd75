"""Planes: the gray images on which methods are compared, and the mesh of each method there.

In each plane all methods get the same gray image and the same number of nodes:

- "256x256", the plane of the `paper` preset: as many nodes as that preset finds there;
- "native", the plane of the `features` preset: as many nodes as that one finds, at the
  image's own resolution. Of an image of more than 2048 pixels a side it is the middle,
  1024 x 1024 pixels, as in `geomesh stages`: so the work is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.types import Gray, Points, Triangles
from geomesh.delaunay.triangulate import delaunay
from geomesh.evaluate.baselines import baselines
from geomesh.features.detect import Detection, detect_keypoints, shrink
from geomesh.features.gray_image import SceneGray
from geomesh.parallel.progress import silent
from geomesh.pipeline.mesh_scene import scene_tone, triangulate_nodes
from geomesh.pipeline.nodes import NodeSet, place_nodes
from geomesh.raster.crop import middle
from geomesh.raster.grid import Grid
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene

PAPER, FEATURES = "paper", "features"

# Points (N, 2) and triangles (T, 3).
PlaneMesh = tuple[Points, Triangles]


@dataclass(frozen=True, eq=False)
class Plane:
    """A gray image on which methods are compared, and the meshes of the presets on it.

    Parameters
    ----------
    gray : uint8 (H, W)
    valid : bool (H, W)
    wanted : int
        Nodes that each method is asked for.
    presets : mapping of str to (points, triangles)
        In pixel-edge coordinates of the plane.
    """

    gray: Gray
    valid: NDArray[np.bool_]
    wanted: int
    presets: Mapping[str, PlaneMesh]

    def meshes(self) -> Iterator[tuple[str, PlaneMesh]]:
        """Yield the mesh of each method: that of a baseline covers the hull of its nodes."""
        yield from self.presets.items()
        for method, place in baselines().items() if self.wanted else ():
            points = place(self.gray, self.valid, self.wanted)
            triangles, used = delaunay(points)
            yield method, (points[used], np.searchsorted(used, triangles).astype(np.int32))


def paper_plane(scene: Scene, workers: Workers) -> Plane:
    """Return the gray image at 256 x 256 pixels, with the mesh of the `paper` preset.

    The `features` preset gets the same gray image, and as many nodes. Where the `paper`
    preset finds no keypoints that span an area, there is no number of nodes to compare at,
    and nothing but its empty mesh.
    """
    recipe = Recipe.from_preset(PAPER)
    assert recipe.resize is not None
    tone = scene_tone(scene, recipe, workers, silent)
    plain, _ = shrink(SceneGray(scene, tone, sobel=False), recipe.resize, workers, silent)
    detection = detect_keypoints(SceneGray(scene, tone, recipe.sobel), recipe, workers, silent)
    nodes, published = _mesh(detection, scene.grid, recipe, workers)
    if nodes.domain.kind != recipe.domain:  # the frame, for want of keypoints
        nothing = np.empty((0, 2)), np.empty((0, 3), np.int32)
        return Plane(plain.gray, plain.valid, 0, {PAPER: nothing})
    wanted = len(nodes.points)
    other = Recipe.from_preset(FEATURES).with_values(nodes=wanted)
    _, ours = _mesh(
        detect_keypoints(plain, other, workers, silent), Grid(*recipe.resize), other, workers
    )
    return Plane(plain.gray, plain.valid, wanted, {PAPER: published, FEATURES: ours})


def native_plane(scene: Scene, workers: Workers) -> Plane:
    """Return the gray image at its own resolution, with the mesh of the `features` preset."""
    recipe = Recipe.from_preset(FEATURES)
    scene = middle(scene)
    image = SceneGray(scene, scene_tone(scene, recipe, workers, silent), recipe.sobel)
    nodes, mesh = _mesh(
        detect_keypoints(image, recipe, workers, silent), scene.grid, recipe, workers
    )
    gray, valid = image.read(image.extent)
    return Plane(gray, valid, len(nodes.points), {FEATURES: mesh})


def _mesh(
    detection: Detection, grid: Grid, recipe: Recipe, workers: Workers
) -> tuple[NodeSet, PlaneMesh]:
    """Return the mesh as the pipeline makes it, and its shape in the plane."""
    chosen = place_nodes(detection, grid, recipe)
    nodes, triangles = triangulate_nodes(chosen, grid, detection.size, workers.local)
    width, height = detection.size
    return nodes, (nodes.points * (width / grid.width, height / grid.height), triangles)


PLANES: Mapping[str, Callable[[Scene, Workers], Plane]] = {
    "256x256": paper_plane,
    "native": native_plane,
}
