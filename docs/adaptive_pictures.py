"""Draw the images of the pages about adaptive meshes from data_samples/.

`pictures.py` runs it. Alone, in the root of a checkout: ``.venv/bin/python
docs/adaptive_pictures.py``.
"""

import warnings
from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from pictures import SAMPLES, keep, silent

import geomesh
from geomesh.delaunay.triangulate import delaunay
from geomesh.evaluate.baselines import GREEDY, baselines
from geomesh.features.detect import detect_keypoints
from geomesh.features.gray_image import SceneGray
from geomesh.features.overview import read_overview
from geomesh.parallel.deadline import never
from geomesh.parallel.workers import open_workers
from geomesh.pipeline.join import join_nodes
from geomesh.pipeline.mesh_scene import scene_tone
from geomesh.pipeline.nodes import place_nodes
from geomesh.pipeline.start import grid_spacing
from geomesh.raster.open import open_scene
from geomesh.raster.scene import Scene
from geomesh.refine.parts import Part, divide
from geomesh.refine.passes import SHIFTS, Crew
from geomesh.refine.plan import LeastSquares
from geomesh.refine.refined import finished, start_part
from geomesh.refine.settings import Settings, block_size
from geomesh.refine.units import even_units
from geomesh.surface.fidelity import compare
from geomesh.surface.fit import Surface, fit_surface

# Fields, a forest and a river; with as many nodes as the preset `features` finds.
SCENE = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
RGB = 3, 2, 1
NEAR = 120, 95, 130, 130  # left, top, width and height in pixels

OLINDA = SAMPLES / "olinda_landsat7_rgb_uint8.tif"

INK, BLUE, ORANGE, GRAY = "#222222", "#2a6f97", "#d1600f", "#8d8d8d"


def main() -> None:
    mpl.use("agg")
    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    draw_comparison()
    draw_near()
    draw_passes()
    draw_moments()
    draw_blocks()
    draw_curves()


class Shown:
    """The scene of the pictures, and how its values become colours."""

    def __init__(self) -> None:
        self.scene = open_scene(SCENE, bidx=RGB)
        with self.scene.open():
            bands, _ = self.scene.read(self.scene.grid.extent)
        self.low, self.high = np.percentile(bands, (1, 99), axis=(1, 2))
        self.image = self.colors(bands)

    def colors(self, bands: NDArray[Any]) -> NDArray[Any]:
        return np.clip((np.moveaxis(bands, 0, -1) - self.low) / (self.high - self.low), 0, 1)

    def surface(self, mesh: Any) -> tuple[NDArray[Any], float]:
        """Return the surface of a mesh as a picture, and its PSNR in decibels."""
        surface, decibels = fitted(self.scene, mesh)
        return self.colors(surface.image(self.scene.grid.extent)), decibels


def fitted(scene: Scene, mesh: Any) -> tuple[Surface, float]:
    """Return the best values for a mesh, and their PSNR in decibels."""
    with open_workers(None) as workers, scene.open():
        surface = fit_surface(
            *(mesh.nodes, mesh.triangles, scene), workers=workers, progress=silent
        )
        return surface, compare(surface, scene, workers, silent).overall


def two_meshes() -> tuple[geomesh.Mesh, geomesh.Mesh]:
    """Return the meshes of the presets `features` and `adaptive`, with equal nodes."""
    one = geomesh.mesh_raster(SCENE, bidx=RGB, preset="features")
    return one, geomesh.mesh_raster(SCENE, bidx=RGB, preset="adaptive", nodes=len(one.nodes))


def panels(columns: int, width: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, width / columns + 0.25), layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False)[0])


def show(panel: Axes, image: NDArray[Any], title: str, part: tuple[int, ...] | None = None) -> None:
    height, width = image.shape[:2]
    left, top, wide, high = part or (0, 0, width, height)
    panel.imshow(image, extent=(0, width, height, 0), interpolation="nearest")
    panel.set(xlim=(left, left + wide), ylim=(top + high, top), xticks=[], yticks=[])
    panel.set_title(title, fontsize=10, loc="left", color=INK)
    panel.spines[:].set_visible(False)


def draw_edges(panel: Axes, mesh: Any, width: float) -> None:
    corners = mesh.nodes[mesh.triangles]
    style = {"facecolors": "none", "edgecolors": "#ffffffb8", "linewidths": width}
    panel.add_collection(PolyCollection(corners, **style))


def draw_comparison() -> None:
    shown, (one, other) = Shown(), two_meshes()
    figure, found = panels(3, width=10.5)
    height, width = shown.image.shape[:2]
    show(found[0], shown.image, f"the image: {width} x {height} pixels")
    for panel, preset, mesh in zip(found[1:], ("features", "adaptive"), (one, other), strict=True):
        image, decibels = shown.surface(mesh)
        show(panel, image, f"{preset}: {len(mesh.nodes):,} nodes, {decibels:.1f} dB")
    keep(figure, "adaptive_compare", dpi=125)


def draw_near() -> None:
    shown, (one, other) = Shown(), two_meshes()
    figure, found = panels(3, width=10.5)
    show(found[0], shown.image, "the image", NEAR)
    for panel, preset, mesh in zip(found[1:], ("features", "adaptive"), (one, other), strict=True):
        show(panel, 0.85 * shown.image, preset, NEAR)
        draw_edges(panel, mesh, 0.8)
    keep(figure, "adaptive_near", dpi=125)


def draw_passes() -> None:
    """Draw the start of a refinement, and the mesh after each pass."""
    shown = Shown()
    figure, found = panels(4, width=12)
    for panel, (name, mesh) in zip(found, passes(shown.scene), strict=True):
        _, decibels = shown.surface(mesh)
        title = f"{name}: {len(mesh.nodes):,} nodes, {decibels:.1f} dB"
        show(panel, 0.8 * shown.image, title)
        draw_edges(panel, mesh, 0.5)
    keep(figure, "adaptive_passes", dpi=125)


def passes(scene: Scene) -> Iterator[tuple[str, Any]]:
    """Yield the mesh at the start of a refinement, and after each of the first passes."""
    recipe = geomesh.Recipe.from_preset("adaptive")
    settings = Settings(recipe.min_angle, recipe.model, recipe.effort)
    wanted = round(0.01 * scene.grid.width * scene.grid.height)
    with open_workers(None) as workers, scene.open():
        part, size = started(scene, wanted, workers)
        units = even_units(*read_overview(scene, workers, silent))
        plan = LeastSquares(Crew(scene, units, workers, size, never), settings, part)
        yield "start", finished(part, units, in_time=True)
        for turn, stage in enumerate(settings.stages[:3], start=1):
            plan.run(stage, round(wanted * stage.share), silent)
            yield f"pass {turn}", finished(plan.part, units, in_time=True)


def started(scene: Scene, wanted: int, workers: Any) -> tuple[Part, float]:
    """Return the start of a refinement to `wanted` nodes, and the size of its blocks."""
    recipe = geomesh.Recipe.from_preset("adaptive").with_values(nodes=wanted)
    image = SceneGray(scene, scene_tone(scene, recipe, workers, silent), recipe.sobel)
    detection = detect_keypoints(image, recipe, workers, silent)
    nodes = place_nodes(detection, scene.grid, recipe)
    mesh = join_nodes(nodes, scene.grid, detection.size, recipe, workers.local)
    triangles = mesh.triangles[:, [0, 2, 1]] if scene.grid.flips else mesh.triangles
    stays = np.zeros(len(mesh.nodes), bool)
    part = start_part(mesh.nodes, triangles, mesh.constraints, stays, len(scene.bands))
    pixels = mesh.domain.valid_pixels
    return part, block_size(pixels, wanted, grid_spacing(pixels, wanted))


CORNERS = np.array([(3.2, 1.1), (8.9, 4.3), (4.6, 8.6)])


def draw_moments() -> None:
    """Draw that the pixels of a triangle are those left of one side without those of others."""
    size = 10
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    figure, found = panels(4, width=10.5)
    counts = np.zeros((size, size))
    for k in range(3):
        p, q = CORNERS[k], CORNERS[(k + 1) % 3]
        low, high = (p, q) if p[1] < q[1] else (q, p)
        crossing = low[0] + (y - low[1]) * (high[0] - low[0]) / (high[1] - low[1])
        left = (y >= low[1]) & (y < high[1]) & (x < crossing)
        down = q[1] > p[1]
        counts += left * (1 if down else -1)
        color = BLUE if down else ORANGE
        title = ("+ " if down else "− ") + f"left of side {k + 1}"
        squares(found[k], left, color, title)
        found[k].plot(*zip(p, q, strict=True), color=color, linewidth=2.4, zorder=4)
    squares(found[3], counts > 0, "#3f7d4e", "= the pixels of the triangle")
    keep(figure, "adaptive_moments", dpi=110)


def squares(panel: Axes, shown: NDArray[Any], color: str, title: str) -> None:
    size = len(shown)
    for row, col in zip(*np.nonzero(shown), strict=True):
        panel.add_patch(Rectangle((col, row), 1, 1, facecolor=color, alpha=0.38, linewidth=0))
    lines = [[(k, 0), (k, size)] for k in range(size + 1)]
    lines += [[(0, k), (size, k)] for k in range(size + 1)]
    panel.add_collection(LineCollection(lines, colors="#d0d0d0", linewidths=0.6, zorder=2))
    panel.add_patch(Polygon(CORNERS, fill=False, edgecolor=INK, linewidth=1.1, zorder=3))
    middles = (CORNERS + np.roll(CORNERS, -1, axis=0)) / 2
    away = middles - CORNERS.mean(axis=0)
    for k, (place, way) in enumerate(zip(middles, away, strict=True), start=1):
        panel.text(
            *(place + 0.75 * way / np.hypot(*way)), str(k), ha="center", va="center", fontsize=9
        )
    panel.set(xlim=(0, size), ylim=(size, 0), xticks=[], yticks=[], aspect="equal")
    panel.set_title(title, fontsize=9.5, loc="left", color=INK)
    panel.set_frame_on(False)


def draw_blocks() -> None:
    """Draw the blocks of a small mesh in the four passes."""
    scene = open_scene(OLINDA)
    with open_workers(None) as workers, scene.open():
        part, _ = started(scene, 1500, workers)
    figure, found = panels(4, width=10.5)
    colors = ["#a8c8dc", "#e7c9a0", "#b9d3b0", "#d9bcd0"]
    for turn, (panel, shift) in enumerate(zip(found, SHIFTS, strict=True), start=1):
        size = 130.0
        blocks = divide(part, size, shift)
        for b in range(len(blocks)):
            rows = blocks.order[blocks.starts[b] : blocks.starts[b + 1]]
            corners = part.points[part.triangles[rows]]
            cell = np.floor(corners.mean(axis=1)[0] / size + shift).astype(int)
            color = colors[int(cell[0] % 2 + 2 * (cell[1] % 2))]
            panel.add_collection(
                PolyCollection(corners, facecolors=color, edgecolors="white", linewidths=0.7)
            )
        frozen = []
        for t, k in zip(*np.nonzero(differ(blocks)), strict=True):
            ends = part.triangles[t, (k + 1) % 3], part.triangles[t, (k + 2) % 3]
            frozen.append(part.points[list(ends)])
        panel.add_collection(LineCollection(frozen, colors=INK, linewidths=1.3))
        width, height = scene.grid.width, scene.grid.height
        panel.set(xlim=(-2, width + 2), ylim=(height + 2, -2), xticks=[], yticks=[])
        panel.set_aspect("equal")
        panel.set_frame_on(False)
        panel.set_title(f"pass {turn}", fontsize=9.5, loc="left", color=INK)
    keep(figure, "adaptive_blocks", dpi=110)


def differ(blocks: Any) -> NDArray[Any]:
    """Return which sides (m, 3) lie between two blocks."""
    label = np.empty(len(blocks.order), int)
    label[blocks.order] = np.repeat(np.arange(len(blocks)), np.diff(blocks.starts))
    across = blocks.whole.across
    return (across >= 0) & (label[across] != label[:, None])


SHARES = 0.5, 1, 2, 4, 8

# Colour and line of each method.
LINES = {
    "adaptive": (BLUE, "-"),
    GREEDY: (GRAY, "-"),
    "regular grid": (GRAY, "--"),
    "features": (BLUE, "--"),
}


def draw_curves() -> None:
    """Draw the error against the number of nodes, for adaptive meshes and others."""
    figure = Figure(figsize=(8.6, 3.7), layout="constrained")
    axes = figure.subplots(1, 2)
    for panel, title, path, bidx in (
        (axes[0], "Sentinel-2: fields and a forest", SCENE, RGB),
        (axes[1], "Landsat 7: Olinda, a city and a coast", OLINDA, None),
    ):
        for name, curve in curves(path, bidx).items():
            color, line = LINES[name]
            nodes, decibels = zip(*curve, strict=True)
            panel.plot(
                nodes, decibels, color=color, ls=line, marker="o", ms=4, linewidth=1.8, label=name
            )
        panel.set_xscale("log")
        panel.set_xticks(ticks := [500, 1000, 2000, 5000, 10000], [f"{n:,}" for n in ticks])
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_title(title, fontsize=10, loc="left", color=INK)
        panel.set_xlabel("nodes", fontsize=9)
        panel.grid(color="#e2e2e2", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8.5)
    axes[0].set_ylabel("PSNR (dB)", fontsize=9)
    axes[0].legend(fontsize=9, frameon=False, handlelength=3.2)
    keep(figure, "adaptive_curves", dpi=120)


def curves(path: Any, bidx: Any) -> dict[str, list[tuple[int, float]]]:
    """Return numbers of nodes with the PSNR of each method."""
    scene = open_scene(path, bidx=bidx)
    with open_workers(None) as workers, scene.open():
        image = SceneGray(scene, scene_tone(scene, geomesh.Recipe(), workers, silent), sobel=False)
        gray, valid = image.read(image.extent)
    found: dict[str, list[tuple[int, float]]] = {name: [] for name in LINES}
    for share in SHARES:
        count = round(share / 100 * np.count_nonzero(valid))
        for name, curve in found.items():
            if name in geomesh.recipe.PRESETS:
                mesh: Any = geomesh.mesh_raster(path, bidx=bidx, preset=name, nodes=count)
            else:
                mesh = Triangulated(baselines()[name](gray, valid, count - 4), gray.shape)
            if not curve or len(mesh.nodes) > curve[-1][0]:
                curve.append((len(mesh.nodes), fitted(scene, mesh)[1]))
    return found


class Triangulated:
    """Nodes and triangles of a method that is not a preset, with the corners of the image."""

    def __init__(self, points: NDArray[Any], shape: tuple[int, ...]) -> None:
        height, width = shape
        corners = [(0, 0), (width, 0), (0, height), (width, height)]
        self.nodes = np.unique(np.concatenate([points, corners]), axis=0)
        self.triangles = delaunay(self.nodes).triangles


if __name__ == "__main__":
    main()
