"""Planes: the gray images on which methods are compared, and the mesh of each method there.

In each plane, all methods get the same gray image and the same number of nodes:

- "256x256" is the plane of the `paper` preset. The number of nodes is the number that this
  preset finds there.
- "native" is the plane of the `features` preset, at the resolution of the image. The number
  of nodes is the number that this preset finds. To limit the work, only the middle of an
  image with a side of more than 2048 pixels is used: 1024 x 1024 pixels, as in
  `geomesh stages`.

The `adaptive` preset gets the same gray image as its raster, and the same number of nodes as its
goal. Its mesh covers the whole image, so that the outline of valid data needs no nodes: baselines
do not follow it either.
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
from geomesh.features.overview import read_overview
from geomesh.parallel.deadline import never
from geomesh.parallel.progress import silent
from geomesh.pipeline.join import join_nodes, triangulate_nodes
from geomesh.pipeline.mesh_scene import scene_tone
from geomesh.pipeline.nodes import NodeSet, place_nodes
from geomesh.pipeline.refine_scene import refine_scene
from geomesh.raster.crop import middle
from geomesh.raster.grid import Grid
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene

PAPER, FEATURES, ADAPTIVE = "paper", "features", "adaptive"

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
        Number of nodes that each method has to place.
    presets : mapping of str to (points, triangles)
        The meshes of the presets, in pixel-edge coordinates of the plane.
    """

    gray: Gray
    valid: NDArray[np.bool_]
    wanted: int
    presets: Mapping[str, PlaneMesh]

    def meshes(self) -> Iterator[tuple[str, PlaneMesh]]:
        """Yield the mesh of each method; the mesh of a baseline covers the hull of its nodes."""
        yield from self.presets.items()
        for method, place in baselines().items() if self.wanted else ():
            points = place(self.gray, self.valid, self.wanted)
            triangles, used = delaunay(points)
            yield method, (points[used], np.searchsorted(used, triangles).astype(np.int32))


def paper_plane(scene: Scene, workers: Workers) -> Plane:
    """Return the gray image at 256 x 256 pixels, with the meshes of the presets.

    The other presets get the same gray image and the number of nodes that the `paper` preset
    finds. If the keypoints of the `paper` preset span no area, there is no number of
    nodes for a comparison; then the plane has only an empty mesh of that preset.
    """
    recipe = Recipe.from_preset(PAPER)
    assert recipe.resize is not None
    tone = scene_tone(scene, recipe, workers, silent)
    plain, _ = shrink(SceneGray(scene, tone, sobel=False), recipe.resize, workers, silent)
    detection = detect_keypoints(SceneGray(scene, tone, recipe.sobel), recipe, workers, silent)
    nodes, published = _mesh(detection, scene.grid, recipe, workers)
    if nodes.domain.kind != recipe.domain:  # the frame, because the keypoints span no area
        nothing = np.empty((0, 2)), np.empty((0, 3), np.int32)
        return Plane(plain.gray, plain.valid, 0, {PAPER: nothing})
    wanted = len(nodes.points)
    other = Recipe.from_preset(FEATURES).with_values(nodes=wanted)
    found = detect_keypoints(plain, other, workers, silent)
    _, ours = _mesh(found, Grid(*recipe.resize), other, workers)
    refined = _refined(plain.gray, plain.valid, found, wanted, workers)
    presets = {PAPER: published, FEATURES: ours, ADAPTIVE: refined}
    return Plane(plain.gray, plain.valid, wanted, presets)


def native_plane(scene: Scene, workers: Workers) -> Plane:
    """Return the gray image at full resolution, with the meshes of the other presets."""
    recipe = Recipe.from_preset(FEATURES)
    scene = middle(scene)
    image = SceneGray(scene, scene_tone(scene, recipe, workers, silent), recipe.sobel)
    found = detect_keypoints(image, recipe, workers, silent)
    nodes, mesh = _mesh(found, scene.grid, recipe, workers)
    wanted = len(nodes.points)
    gray, valid = image.read(image.extent)
    refined = _refined(gray, valid, found, wanted, workers)
    return Plane(gray, valid, wanted, {FEATURES: mesh, ADAPTIVE: refined})


def _mesh(
    detection: Detection, grid: Grid, recipe: Recipe, workers: Workers
) -> tuple[NodeSet, PlaneMesh]:
    """Return the nodes as in the pipeline, and the mesh in coordinates of the plane."""
    chosen = place_nodes(detection, grid, recipe)
    nodes, triangles = triangulate_nodes(chosen, grid, detection.size, workers.local)
    width, height = detection.size
    return nodes, (nodes.points * (width / grid.width, height / grid.height), triangles)


def _refined(
    gray: Gray, valid: NDArray[np.bool_], detection: Detection, wanted: int, workers: Workers
) -> PlaneMesh:
    """Return the mesh of the `adaptive` preset: its raster is the gray image of the plane.

    The detection is that of the other preset, on the same image.
    """
    recipe = Recipe.from_preset(ADAPTIVE).with_values(nodes=wanted, domain="image")
    scene = open_scene((np.ma.array(gray, mask=~valid), None, None))
    nodes = place_nodes(detection, scene.grid, recipe)
    start = join_nodes(nodes, scene.grid, detection.size, recipe, workers.local)
    with scene.open():
        overview = read_overview(scene, workers, silent)
        mesh = refine_scene(start, scene, recipe, overview, workers, silent, is_late=never).mesh
    return mesh.nodes, mesh.triangles


PLANES: Mapping[str, Callable[[Scene, Workers], Plane]] = {
    "256x256": paper_plane,
    "native": native_plane,
}
