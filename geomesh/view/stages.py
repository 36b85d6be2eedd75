"""The stages of the pipeline: the result of each, and a figure of all four side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import extra_required
from geomesh.features.canny import canny_edges, canny_thresholds
from geomesh.features.detect import detect_keypoints, shrink
from geomesh.features.gray_image import ArrayGray, GrayImage, SceneGray
from geomesh.io.picture import save_picture
from geomesh.mesh.colors import brightened
from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.workers import open_workers
from geomesh.pipeline.mesh_scene import mesh_scene, scene_tone
from geomesh.pipeline.nodes import place_nodes
from geomesh.raster.crop import middle

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

_NODE_COLOR = "#ffd200"
_EDGE_COLOR = "#ffffff"
_INK = "#222222"


@dataclass(frozen=True)
class Stages:
    """The intermediate images of the pipeline, and the mesh.

    Attributes
    ----------
    gray : uint8 (h, w)
        Stage 1: the gray image in the plane that the pipeline worked on.
    edges : bool (h, w)
        Stage 2: the Canny edges.
    mesh : TriangleMesh
        Stage 4.
    image : uint8 (H, W, 3)
        The source in display colours; pixels that are not valid are white.
    keypoints : float64 (k, 2)
        Stage 3: the keypoints that are nodes, in the plane that the pipeline worked on. Of a
        refined mesh: those with which refinement starts.
    """

    gray: Gray
    edges: NDArray[np.bool_]
    mesh: TriangleMesh
    image: NDArray[np.uint8]
    keypoints: Points

    def plot(self, title: str | None = None, *, path: str | PathLike[str] | None = None) -> Figure:
        """Draw the four stages side by side: see `draw_stages`.

        Parameters
        ----------
        title : str, optional
            Title of the figure.
        path : path, optional
            Also save the figure to this file (.png, .pdf, .svg); an existing file is replaced.
        """
        figure = draw_stages(self, title)
        if path is not None:
            save_picture(figure, path, overwrite=True)
        return figure


def run_stages(scene: Scene, recipe: Recipe, progress: Progress) -> Stages:
    """Run the pipeline on a scene and return the results of all stages.

    A scene larger than `geomesh.raster.crop.LARGEST_SIDE` is first cropped to its middle.
    """
    scene = middle(scene)
    extent = scene.grid.extent
    with open_workers() as workers, scene.open():
        mesh = mesh_scene(scene, recipe, workers, part_of(progress, 0, 0.8))
        tone = scene_tone(scene, recipe, workers, part_of(progress, 0.8, 0.85))
        plain: GrayImage = SceneGray(scene, tone, sobel=False)
        worked: GrayImage = SceneGray(scene, tone, sobel=recipe.sobel)
        if recipe.resize is not None:
            plain, _ = shrink(plain, recipe.resize, workers, part_of(progress, 0.85, 0.95))
            worked, _ = shrink(worked, recipe.resize, workers, part_of(progress, 0.95, 1))
        gray, _ = plain.read(plain.extent)
        seen, valid = worked.read(worked.extent)
        edges = canny_edges(seen, canny_thresholds(ArrayGray.whole(seen, valid), recipe), valid)
        keypoints = mesh.plane_nodes[mesh.node_table["kind"] == "feature"]
        if recipe.refine:
            detection = detect_keypoints(worked, recipe, workers, part_of(progress, 0.85, 1))
            start = place_nodes(detection, scene.grid, recipe)
            keypoints = start.points[start.table["kind"] == "feature"]
        bands, valid = scene.read(extent)
    levels = tone.display(bands)[list(scene.display)]
    image = np.moveaxis(levels, 0, -1).copy()
    image[~valid] = 255
    return Stages(gray, edges, mesh, image, keypoints)


def draw_stages(stages: Stages, title: str | None = None) -> Figure:
    """Draw the paper's figure: gray image, Canny edges, keypoints and mesh, (a) to (d)."""
    with extra_required("matplotlib", "figures"):
        from matplotlib.figure import Figure
    height, width = stages.gray.shape
    tall = height > 1.3 * width
    rows, columns = (1, 4) if tall else (2, 2)
    panel = 4.2 if not tall else 3.2
    size = (columns * panel, rows * panel * float(np.clip(height / width, 0.2, 4)) + 0.5)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns).ravel()
    mesh = stages.mesh
    gray = {"cmap": "gray", "vmin": 0, "vmax": 255, "extent": (0, width, height, 0)}
    axes[0].imshow(stages.gray, **gray)
    axes[1].imshow(np.where(stages.edges, 0, 255), interpolation="nearest", **gray)
    axes[2].imshow(128 + stages.gray // 2, **gray)
    marker = _marker_size(len(stages.keypoints))
    axes[2].scatter(*stages.keypoints.T, s=marker, c=_NODE_COLOR, edgecolors=_INK, linewidths=0.3)
    axes[3].imshow(brightened(stages.image), extent=(0, width, height, 0))
    _draw_edges(axes[3], mesh.plane_nodes, mesh.edges.nodes)
    is_refined = mesh.provenance is not None and mesh.provenance.refinement is not None
    labels = (
        f"Grayscale, {width} × {height} pixels",
        "Canny edges",
        f"{len(stages.keypoints):,} SIFT keypoints" + is_refined * " at the start",
        f"{'Refined' if is_refined else 'Delaunay'} mesh, {len(mesh.triangles):,} triangles",
    )
    for letter, label, ax in zip("abcd", labels, axes, strict=True):
        ax.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
        ax.set_aspect("equal")
        ax.set_title(f"({letter}) {label}", fontsize=10, color=_INK, loc="left")
        for side in ax.spines.values():
            side.set(color="#999999", linewidth=0.6)
    if title:
        figure.suptitle(title, fontsize=11, color=_INK)
    return figure


def _draw_edges(ax: Axes, nodes: NDArray[np.float64], edges: NDArray[np.integer]) -> None:
    """Draw the edges twice, light on dark, so that they are visible on any image."""
    from matplotlib.collections import LineCollection as Lines

    ends = nodes[edges]
    width = float(np.clip(40 / np.sqrt(max(len(edges), 1)), 0.2, 0.9))
    ax.add_collection(Lines(ends, colors="#00000080", linewidths=2 * width))
    ax.add_collection(Lines(ends, colors=_EDGE_COLOR, linewidths=width))


def _marker_size(count: int) -> float:
    return float(np.clip(4000 / max(count, 1), 1.0, 12.0))
