"""Draw the images of the page about terrain from data_samples/.

`pictures.py` runs it. Alone, in the root of a checkout: ``.venv/bin/python
docs/terrain_pictures.py``.
"""

import warnings
from typing import Any

import geopandas as gpd
import matplotlib as mpl
import numpy as np
import rasterio
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from pictures import SAMPLES, keep

import geomesh

DEM = SAMPLES / "colorado_dem_float32_epsg4269.tif"
STREAM = SAMPLES / "colorado_stream.geojson"
TOLERANCE = 5.0
INTERVAL = 20.0

# Metres for a pixel of the DEM in x and in y.
PIXEL = 8.0, 10.3

INK, BLUE, ORANGE = "#222222", "#1f6fb2", "#d1600f"


def main() -> None:
    mpl.use("agg")
    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    draw_tin()
    draw_contours()


def draw_tin() -> None:
    """Draw the TIN over the hillshade, without and with the stream as a breakline."""
    figure = Figure(figsize=(12, 5.4), dpi=100)
    for panel, lines, title in zip(
        figure.subplots(1, 2),
        (None, STREAM),
        ("within 5 m of every pixel", "the same, with the stream as a breakline"),
        strict=True,
    ):
        mesh = geomesh.mesh_raster(DEM, z=1, max_error=TOLERANCE, breaklines=lines)
        show_hillshade(panel)
        panel.add_collection(
            LineCollection(list(mesh.map_nodes[mesh.edges.nodes]), colors=INK, linewidths=0.35)
        )
        if lines is not None:
            gpd.read_file(STREAM).plot(ax=panel, color=BLUE, linewidth=2)
        show_map(panel, mesh, f"{len(mesh.nodes):,} nodes: {title}")
    figure.tight_layout()
    keep(figure, "terrain_tin")


def draw_contours() -> None:
    """Draw the contours of the TIN over the hillshade, with labels."""
    mesh = geomesh.mesh_raster(DEM, z=1, max_error=TOLERANCE)
    lines = mesh.contours(interval=INTERVAL)
    figure = Figure(figsize=(9, 8.2), dpi=100)
    panel = figure.subplots()
    show_hillshade(panel)
    for is_index, width in ((False, 0.5), (True, 1.2)):
        chosen = lines[lines["index"] == is_index]
        chosen.plot(ax=panel, color="#7a3e10", linewidth=width)
    for _, row in lines[lines["index"] & (lines["length"] > 2000)].iterrows():
        label(panel, row.geometry, f"{row['level']:g}")
    show_map(panel, mesh, f"contours every {INTERVAL:g} m, every fifth with its height")
    figure.tight_layout()
    keep(figure, "terrain_contours")


def label(panel: Axes, line: Any, text: str) -> None:
    """Write a text along the middle of a line."""
    middle = line.interpolate(0.5, normalized=True)
    ahead = line.interpolate(0.505, normalized=True)
    angle = np.degrees(np.arctan2((ahead.y - middle.y) * PIXEL[1] / PIXEL[0], ahead.x - middle.x))
    angle = (angle + 90) % 180 - 90
    halo = [withStroke(linewidth=2.5, foreground="white")]
    panel.text(
        *(middle.x, middle.y, text),
        rotation=angle,
        fontsize=7,
        color="#5a2d0c",
        ha="center",
        va="center",
        path_effects=halo,
        clip_on=True,
    )


def show_hillshade(panel: Axes) -> None:
    with rasterio.open(DEM) as dataset:
        heights, (west, south, east, north) = dataset.read(1), dataset.bounds
    panel.imshow(
        shaded(heights), cmap="gray", vmin=-0.4, vmax=1.05, extent=(west, east, south, north)
    )


def shaded(heights: NDArray[np.float32]) -> NDArray[Any]:
    """Return the hillshade of heights in metres."""
    return LightSource(315, 45).hillshade(heights, dx=PIXEL[0], dy=PIXEL[1])


def show_map(panel: Axes, mesh: geomesh.Mesh, title: str) -> None:
    west, south, east, north = mesh.grid.bounds()
    panel.set(xlim=(west, east), ylim=(south, north), xticks=[], yticks=[], xlabel="", ylabel="")
    panel.set_aspect(PIXEL[1] / PIXEL[0])
    panel.set_title(title, fontsize=10)


if __name__ == "__main__":
    main()
