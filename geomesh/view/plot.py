"""Pictures: the stages of the pipeline side by side, and a mesh on the map."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geomesh.errors import MissingExtraError, OutputError
from geomesh.features.canny import canny
from geomesh.features.detect import shrink
from geomesh.features.gray import Gray
from geomesh.features.gray_image import ArrayGray, GrayImage, SceneGray
from geomesh.features.thresholds import canny_thresholds
from geomesh.io.atomic import check_place, staged
from geomesh.mesh.triangle_mesh import Mesh
from geomesh.parallel.tiles import Progress, part_of
from geomesh.parallel.workers import open_crew
from geomesh.pipeline.mesh_scene import mesh_scene, scene_tone
from geomesh.raster.grid import Window
from geomesh.raster.scene import Scene
from geomesh.recipe import Recipe
from geomesh.view.thumbnail import brightened, parse_colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# A larger scene is shown by its middle, at full resolution: details are the point.
LARGEST_SIDE = 2048
SHOWN_SIDE = 1024

PICTURES = (".png", ".pdf", ".svg", ".jpg")

_NODE_COLOR = "#ffd200"
_EDGE_COLOR = "#ffffff"
_INK = "#222222"
_PAPER = "#e4e4e4"


@dataclass(frozen=True)
class Stages:
    """The intermediate images of the pipeline, and the mesh.

    Attributes
    ----------
    gray : uint8 (h, w)
        Stage 1, in the plane that the pipeline worked on.
    edges : bool (h, w)
        Stage 2.
    mesh : Mesh
        Stages 3 (its feature nodes) and 4.
    image : uint8 (H, W, 3)
        The source as displayed, white where not valid.
    """

    gray: Gray
    edges: NDArray[np.bool_]
    mesh: Mesh
    image: NDArray[np.uint8]


def run_stages(scene: Scene, recipe: Recipe, progress: Progress) -> Stages:
    """Run the pipeline on a scene and keep what each stage gives.

    A scene larger than `LARGEST_SIDE` is cropped to its middle first.
    """
    scene = middle(scene)
    extent = scene.grid.extent
    with open_crew() as crew, scene.open():
        mesh = mesh_scene(scene, recipe, crew, part_of(progress, 0, 0.8))
        tone = scene_tone(scene, recipe, crew, part_of(progress, 0.8, 0.85))
        plain: GrayImage = SceneGray(scene, tone, sobel=False)
        worked: GrayImage = SceneGray(scene, tone, sobel=recipe.sobel)
        if recipe.resize is not None:
            plain, _ = shrink(plain, recipe.resize, crew, part_of(progress, 0.85, 0.95))
            worked, _ = shrink(worked, recipe.resize, crew, part_of(progress, 0.95, 1))
        gray, _ = plain.read(plain.extent)
        seen, valid = worked.read(worked.extent)
        edges = canny(seen, canny_thresholds(ArrayGray.whole(seen, valid), recipe), valid)
        bands, valid = scene.read(extent)
    levels = tone.display(bands)[list(scene.display)]
    image = np.moveaxis(levels, 0, -1).copy()
    image[~valid] = 255
    return Stages(gray, edges, mesh, image)


def middle(scene: Scene) -> Scene:
    """Return the scene, or its middle if it is larger than a figure can show."""
    width, height = scene.grid.width, scene.grid.height
    if max(width, height) <= LARGEST_SIDE:
        return scene
    w, h = min(width, SHOWN_SIDE), min(height, SHOWN_SIDE)
    return scene.crop(Window((width - w) // 2, (height - h) // 2, w, h), scene.area)


def draw_stages(stages: Stages, title: str | None = None) -> Figure:
    """Draw the paper's figure: gray image, Canny edges, keypoints and mesh, (a) to (d)."""
    figure_module = _matplotlib("figure")
    height, width = stages.gray.shape
    tall = height > 1.3 * width
    rows, columns = (1, 4) if tall else (2, 2)
    panel = 4.2 if not tall else 3.2
    size = (columns * panel, rows * panel * float(np.clip(height / width, 0.2, 4)) + 0.5)
    figure: Figure = figure_module.Figure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns).ravel()
    mesh = stages.mesh
    features = mesh.plane_nodes[mesh.node_table["kind"] == "feature"]
    gray = {"cmap": "gray", "vmin": 0, "vmax": 255, "extent": (0, width, height, 0)}
    axes[0].imshow(stages.gray, **gray)
    axes[1].imshow(np.where(stages.edges, 0, 255), interpolation="nearest", **gray)
    axes[2].imshow(128 + stages.gray // 2, **gray)
    axes[2].scatter(
        *features.T, s=_marker_size(len(features)), c=_NODE_COLOR, edgecolors=_INK, linewidths=0.3
    )
    axes[3].imshow(brightened(stages.image), extent=(0, width, height, 0))
    _draw_edges(axes[3], mesh.plane_nodes, mesh.edges.nodes)
    labels = (
        f"Grayscale, {width} × {height} pixels",
        "Canny edges",
        f"{len(features):,} SIFT keypoints",
        f"Delaunay mesh, {len(mesh.triangles):,} triangles",
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


def plot_mesh(
    mesh: Mesh,
    column: str = "color",
    *,
    ax: Axes | None = None,
    cmap: str = "viridis",
    edgecolor: str | None = None,
    path: str | PathLike[str] | None = None,
) -> Axes:
    """Draw the triangles of a mesh on the map; dark images are brightened.

    Parameters
    ----------
    mesh : Mesh
    column : str
        What fills the triangles: "color" (the image's own mean colour) or any
        numeric column of ``mesh.attributes("triangles")``.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    cmap : str
        Colour map for a numeric column.
    edgecolor : str, optional
        Of the triangle edges; thin and translucent white by default.
    path : path, optional
        Also save the figure there (.png, .pdf, .svg), in place of what is there.

    Returns
    -------
    matplotlib Axes
    """
    collections = _matplotlib("collections")
    attributes = mesh.attributes("triangles")
    if column not in attributes:
        raise ValueError(f"column is {column!r}: choose from {', '.join(attributes)}")
    west, south, east, north = mesh.grid.bounds()
    if ax is None:
        height_per_width = (north - south) / (east - west) * mesh.grid.aspect
        size = (8.0, min(max(8.0 * height_per_width, 3.0), 14.0) + 0.4)
        if path is None:
            ax = _matplotlib("pyplot").subplots(figsize=size, layout="constrained")[1]
        else:
            ax = _matplotlib("figure").Figure(figsize=size, layout="constrained").subplots()
    figure: Any = ax.figure
    corners = mesh.map_nodes[mesh.triangles]
    values = attributes[column]
    style: dict[str, Any] = {"edgecolors": edgecolor or "#ffffff59", "linewidths": 0.25}
    if column == "color":
        shown = brightened(parse_colors(values)) / 255
        triangles = collections.PolyCollection(corners, facecolors=shown, **style)
    else:
        triangles = collections.PolyCollection(corners, array=values, cmap=cmap, **style)
        figure.colorbar(triangles, ax=ax, label=column, shrink=0.7)
    ax.add_collection(triangles)
    ax.set(xlim=(west, east), ylim=(north, south) if mesh.grid.y_runs_down else (south, north))
    ax.set_aspect(mesh.grid.aspect)
    ax.set_facecolor(_PAPER)  # so that white triangles differ from no triangles
    crs = mesh.grid.crs
    unit = crs.axis_info[0].unit_name if crs and crs.axis_info else "pixel"
    ax.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    ax.ticklabel_format(style="plain", useOffset=False)
    ax.tick_params(labelsize=7)
    name = crs.name if crs else "no CRS"
    ax.set_title(
        f"{len(mesh.nodes):,} nodes, {len(mesh.triangles):,} triangles ({name})",
        fontsize=10,
        loc="left",
    )
    if path is not None:
        save_picture(figure, path, overwrite=True)
    return ax


def _draw_edges(ax: Axes, nodes: NDArray[np.float64], edges: NDArray[np.integer]) -> None:
    """Draw edges twice, light on dark, so that they show on any image."""
    lines = _matplotlib("collections").LineCollection
    ends = nodes[edges]
    width = float(np.clip(40 / np.sqrt(max(len(edges), 1)), 0.2, 0.9))
    ax.add_collection(lines(ends, colors="#00000080", linewidths=2 * width))
    ax.add_collection(lines(ends, colors=_EDGE_COLOR, linewidths=width))


def _marker_size(count: int) -> float:
    return float(np.clip(4000 / max(count, 1), 1.0, 12.0))


def _matplotlib(module: str) -> Any:
    try:
        import importlib

        return importlib.import_module(f"matplotlib.{module}")
    except ImportError as error:
        raise MissingExtraError(
            "matplotlib is not installed: pip install 'geomesh-toolkit[figures]'"
        ) from error


def check_picture(path: str | PathLike[str], *, overwrite: bool) -> None:
    """Refuse a picture that could not be written, before any work is done."""
    suffix = Path(path).suffix.lower()
    if suffix not in PICTURES:
        raise OutputError(
            f"{path} has no extension of a picture; choose from {', '.join(PICTURES)}"
        )
    check_place(Path(path), overwrite=overwrite)


def save_picture(figure: Figure, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Save a figure at print resolution; the format follows the extension."""
    check_picture(path, overwrite=overwrite)
    try:
        with staged(Path(path), Path(path).suffix, overwrite=overwrite) as temporary:
            figure.savefig(temporary, dpi=200, bbox_inches="tight", pad_inches=0.08)
    except OSError as error:
        raise OutputError(
            f"{path} could not be written: {error.strerror or error}; free some space or choose "
            "another folder"
        ) from error
