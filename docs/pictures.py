"""Draw the images of the README, the documentation and the plugin's help from data_samples/.

Run it in the root of a checkout: ``.venv/bin/python docs/pictures.py``.
"""

from pathlib import Path
from typing import Any

import geopandas
import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image

import geomesh
from geomesh.raster.open import open_scene
from geomesh.view.stages import draw_stages, run_stages

SAMPLES = Path("data_samples")
IMAGES = Path("docs/images")
HELP = Path("qgis_plugin/geomesh_qgis/images")

# Width in pixels that the help panel of QGIS can show without scrolling.
HELP_WIDTH = 220


def silent(_fraction: float, _message: str) -> None:
    pass


def main() -> None:
    mpl.use("agg")
    for preset in ("features", "paper"):
        scene = open_scene(SAMPLES / "olinda_landsat7_rgb_uint8.tif")
        stages = run_stages(scene, geomesh.Recipe.from_preset(preset), silent)
        keep(draw_stages(stages), f"olinda_stages_{preset}", dpi=80)
    draw_hero()
    draw_how_to()
    draw_help()
    import adaptive_pictures  # which imports this module

    adaptive_pictures.main()


def draw_hero() -> None:
    """Draw a scene in three panels: its pixels, the same with the mesh's edges, its triangles."""
    found = run_stages(
        open_scene(SAMPLES / "iguacu_landsat8_rgb_uint16.tif"), geomesh.Recipe(), silent
    )
    mesh, image = found.mesh, bright(found.image)
    width, top, bottom = mesh.grid.width, 95, 325
    figure = Figure(figsize=(12, 12 * (bottom - top) / width), dpi=100)
    panel = figure.add_axes((0, 0, 1, 1))
    panel.imshow(image, extent=(0, width, mesh.grid.height, 0), interpolation="bilinear")
    slant = 40
    for colors, edge, left in (
        ("none", "#ffffffb0", 0.3 * width),
        (bright(mesh_colors(mesh)), "#ffffff30", 0.62 * width),
    ):
        corners = mesh.nodes[mesh.triangles]
        cells = PolyCollection(corners, facecolors=colors, edgecolors=edge, linewidths=0.6)
        panel.add_collection(cells)
        shown = [(left + slant, top), (2 * width, top), (2 * width, bottom), (left - slant, bottom)]
        cells.set_clip_path(Polygon(shown, transform=panel.transData))
        panel.plot(*zip(shown[0], shown[3], strict=True), color="white", linewidth=2)
    panel.set(xlim=(0, width), ylim=(bottom, top))
    panel.set_axis_off()
    keep(figure, "hero")


def draw_how_to() -> None:
    draw_bands()
    draw_nodes()
    draw_domains()
    draw_area()


def draw_bands() -> None:
    scene = SAMPLES / "olinda_landsat7_6band_uint8.tif"
    figure, panels = side_by_side(2)
    for panel, bidx, gray, title in (
        (panels[0], (3, 2, 1), "luma", "luma of red, green and blue"),
        (panels[1], (3, 2, 1, 4), "band:4", "near infrared"),
    ):
        found = run_stages(open_scene(scene, bidx=bidx), geomesh.Recipe(gray=gray), silent)
        mesh = found.mesh
        frame(panel, mesh, f"{title}, {len(mesh.nodes):,} nodes")
        panel.imshow(found.gray, cmap="gray", extent=(0, mesh.grid.width, mesh.grid.height, 0))
        panel.scatter(*mesh.nodes.T, s=3, c="#ffd200", edgecolors="#222222", linewidths=0.2)
    keep(figure, "bands")


def draw_nodes() -> None:
    figure, panels = side_by_side(2)
    for panel, nodes in zip(panels, (300, None), strict=True):
        mesh = geomesh.mesh_raster(SAMPLES / "olinda_landsat7_rgb_uint8.tif", nodes=nodes)
        frame(panel, mesh, f"{len(mesh.nodes):,} nodes, {len(mesh.triangles):,} triangles")
        fill(panel, mesh, bright(mesh_colors(mesh)), "#ffffff59")
    keep(figure, "nodes")


def draw_domains() -> None:
    figure, panels = side_by_side(3)
    for panel, domain in zip(panels, ("valid", "image", "hull"), strict=True):
        mesh = geomesh.mesh_raster(
            SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif", nodes=2000, domain=domain
        )
        frame(panel, mesh, domain)
        fill(panel, mesh, bright(mesh_colors(mesh)), "#ffffff59")
    keep(figure, "domains")


def draw_area() -> None:
    circle = shapely.Point(294500, 9115500).buffer(3000)
    mesh = geomesh.mesh_raster(
        SAMPLES / "olinda_landsat7_rgb_uint8.tif",
        mask=geopandas.GeoSeries([circle], crs="EPSG:31985"),
    )
    figure, (panel,) = side_by_side(1)
    frame(panel, mesh, f"{len(mesh.triangles):,} triangles")
    fill(panel, mesh, bright(mesh_colors(mesh)), "#ffffff59")
    keep(figure, "area")


def side_by_side(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(3.6 * count, 3.8), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def frame(panel: Axes, mesh: geomesh.Mesh, title: str) -> None:
    panel.set(xlim=(0, mesh.grid.width), ylim=(mesh.grid.height, 0), xticks=[], yticks=[])
    panel.set_aspect("equal")
    panel.set_facecolor("#e4e4e4")
    panel.set_title(title, fontsize=9, loc="left")


def mesh_colors(mesh: geomesh.Mesh) -> NDArray[Any]:
    return to_rgba_array(mesh.triangle_table["color"])[:, :3]


def bright(colors: NDArray[Any]) -> NDArray[Any]:
    """Scale colours (0 to 255 or 0 to 1) to 0 to 1, brightened as in `Mesh.plot`."""
    return np.clip(colors / max(np.percentile(colors, 99), 0.01), 0, 1)


def keep(figure: Figure, name: str, dpi: int = 110) -> None:
    """Save a figure for the documentation. It has 256 colours, so that the file is small."""
    figure.savefig(IMAGES / f"{name}.png", dpi=dpi, bbox_inches="tight", pad_inches=0.01)
    picture = Image.open(IMAGES / f"{name}.png").convert("RGB")
    picture.quantize(256, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)


def draw_help() -> None:
    scene = open_scene(SAMPLES / "rmnp_rgb.tif")
    found = run_stages(scene, geomesh.Recipe(nodes=500), silent)
    width, height = scene.grid.width, scene.grid.height

    figure, panels = frames(2, height / width)
    for panel in panels:
        panel.imshow(found.image, extent=(0, width, height, 0))
    fill(panels[1], found.mesh, found.mesh.triangle_table["color"], "#ffffff40")
    save(figure, "rastertomesh")

    figure, (panel,) = frames(1, 0.6)
    fill(panel, found.mesh, found.mesh.quality().table["min_angle"], "#00000030")
    panel.set(xlim=(0, width), ylim=(0.6 * width, 0))
    save(figure, "meshquality")

    figure, panels = frames(2, height / width, rows=2)
    panels[0].imshow(found.gray, cmap="gray", extent=(0, width, height, 0))
    panels[1].imshow(found.edges, cmap="gray", extent=(0, width, height, 0))
    panels[2].imshow(found.gray, cmap="gray", extent=(0, width, height, 0))
    panels[2].scatter(*found.mesh.nodes.T, s=0.7, c="#e69f00", linewidths=0)
    fill(panels[3], found.mesh, found.mesh.triangle_table["color"], "#ffffff40")
    save(figure, "stages")


def frames(columns: int, height_per_width: float, rows: int = 1) -> tuple[Figure, list[Axes]]:
    panel = HELP_WIDTH / 100 / columns
    figure = Figure(figsize=(HELP_WIDTH / 100, rows * panel * height_per_width), dpi=100)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    figure.subplots_adjust(0, 0, 1, 1, 0.02, 0.02)
    for panel in axes:
        panel.set_axis_off()
    return figure, list(axes)


def fill(panel: Axes, mesh: geomesh.Mesh, values: NDArray[Any], edge: str) -> None:
    style = {"edgecolors": edge, "linewidths": 0.25}
    colors = values.dtype.kind == "U" or values.ndim == 2
    style |= {"facecolors": values} if colors else {"array": values}
    panel.add_collection(PolyCollection(mesh.nodes[mesh.triangles], **style))
    panel.set(xlim=(0, mesh.grid.width), ylim=(mesh.grid.height, 0))


def save(figure: Figure, name: str) -> None:
    figure.savefig(HELP / f"{name}.png", dpi=100)


if __name__ == "__main__":
    main()
