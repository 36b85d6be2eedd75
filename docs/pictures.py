"""Draw the pictures of the README, the documentation and the plugin's help from data_samples/.

Run from the top of a checkout: ``.venv/bin/python docs/pictures.py``.
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

import geomesh
from geomesh.figures import draw_stages, run_stages
from geomesh.sources import open_scene

SAMPLES = Path("data_samples")
IMAGES = Path("docs/images")
HELP = Path("qgis_plugin/geomesh_qgis/images")

# As wide as the help beside the parameters in QGIS shows without scrolling.
HELP_WIDTH = 220


def silent(_fraction: float, _message: str) -> None:
    pass


def main() -> None:
    mpl.use("agg")
    for preset in ("features", "paper"):
        scene = open_scene(SAMPLES / "olinda_landsat7_rgb_uint8.tif")
        stages = run_stages(scene, geomesh.Recipe.from_preset(preset), silent)
        figure = draw_stages(stages)
        figure.savefig(IMAGES / f"olinda_stages_{preset}.png", dpi=72)
    mesh = geomesh.mesh_raster(SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif")
    mesh.plot().figure.savefig(IMAGES / "bahamas_mesh.png", dpi=110, bbox_inches="tight")
    draw_help()


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
    style |= {"facecolors": values} if values.dtype.kind == "U" else {"array": values}
    panel.add_collection(PolyCollection(mesh.nodes[mesh.triangles], **style))
    panel.set(xlim=(0, mesh.grid.width), ylim=(mesh.grid.height, 0))


def save(figure: Figure, name: str) -> None:
    figure.savefig(HELP / f"{name}.png", dpi=100)


if __name__ == "__main__":
    main()
