"""Draw the images of the README, the documentation and the plugin's help from data_samples/.

Run it in the root of a checkout: ``.venv/bin/python docs/pictures.py``.
"""

import tempfile
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
from numpy.typing import NDArray
from PIL import Image

import geomesh
from geomesh.raster.open import open_scene
from geomesh.recipe import DEFAULT_PRESET
from geomesh.view.stages import draw_stages, run_stages

DEFAULT = geomesh.Recipe.from_preset(DEFAULT_PRESET)

SAMPLES = Path("data_samples")
IMAGES = Path("docs/images")
HELP = Path("qgis_plugin/geomesh_qgis/images")

# Width in pixels that the help panel of QGIS can show without scrolling.
HELP_WIDTH = 220


def silent(_fraction: float, _message: str) -> None:
    pass


def main() -> None:
    mpl.use("agg")
    for preset in ("adaptive", "features", "paper"):
        scene = open_scene(SAMPLES / "olinda_landsat7_rgb_uint8.tif")
        stages = run_stages(scene, geomesh.Recipe.from_preset(preset), silent)
        keep(draw_stages(stages), f"olinda_stages_{preset}", dpi=80)
    draw_hero()
    draw_how_to()
    draw_help()
    import adaptive_pictures  # which imports this module

    adaptive_pictures.main()
    import terrain_pictures

    terrain_pictures.main()


def draw_hero() -> None:
    """Draw a part of a scene in three panels: its pixels, the edges of its mesh, the triangles."""
    source, bidx = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif", (3, 2, 1)
    left, top, width, height = 110, 80, 156, 140
    scene = open_scene(source, bidx=bidx)
    mesh = geomesh.mesh_raster(source, bidx=bidx)
    with scene.open():
        bands, _ = scene.read(scene.grid.extent)
    low, high = np.percentile(bands, (1, 99), axis=(1, 2))
    image = np.clip((np.moveaxis(bands, 0, -1) - low) / (high - low), 0, 1)
    means = np.stack([mesh.triangle_table[f"{band.name}_mean"] for band in scene.bands], axis=1)
    corners = mesh.nodes[mesh.triangles]
    figure = Figure(figsize=(12, 4 * height / width), dpi=100)
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(0, 0, 1, 1, 0.015, 0)
    for panel, light in zip(panels[:2], (1, 0.85), strict=True):
        extent = (0, scene.grid.width, scene.grid.height, 0)
        panel.imshow(light * image, extent=extent, interpolation="bilinear")
    lines = {"facecolors": "none", "edgecolors": "#ffffffd0", "linewidths": 0.8}
    panels[1].add_collection(PolyCollection(corners, **lines))
    colors = np.clip((means - low) / (high - low), 0, 1)
    # Each triangle has an edge in its own colour: this hides the gaps of antialiasing.
    filled = {"facecolors": colors, "edgecolors": "face", "linewidths": 0.4}
    panels[2].add_collection(PolyCollection(corners, **filled))
    for panel in panels:
        panel.set(xlim=(left, left + width), ylim=(top + height, top), aspect="auto")
        panel.set_axis_off()
    keep(figure, "hero")


def draw_how_to() -> None:
    draw_bands()
    draw_nodes()
    draw_domains()
    draw_area()
    draw_web()


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
            SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif",
            preset="features" if domain == "hull" else "adaptive",
            nodes=2000,
            domain=domain,
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


def draw_web() -> None:
    """Draw GeoJSON in the projection of web maps, in the style that the page gives to Leaflet."""
    source = SAMPLES / "iguacu_landsat8_rgb_uint16.tif"
    mesh = geomesh.mesh_raster(source, nodes=2000, statistics=("mean",))
    with tempfile.TemporaryDirectory() as folder:
        triangles = geopandas.read_file(mesh.to_file(Path(folder) / "web.geojson"))
    triangles = triangles.to_crs("EPSG:3857")
    west, south, east, north = triangles.total_bounds
    figure = Figure(figsize=(5.6, 5.6 * 0.8), dpi=100)
    panel = figure.add_axes((0, 0, 1, 1))
    triangles.plot(ax=panel, color=triangles["color"], edgecolor=triangles["color"], linewidth=0.5)
    wide, middle = 0.96 * (east - west), (south + north) / 2
    x = (west + east - wide) / 2
    panel.set(xlim=(x, x + wide), ylim=(middle - 0.4 * wide, middle + 0.4 * wide))
    panel.set_axis_off()
    keep(figure, "web", dpi=125)


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
    found = run_stages(scene, DEFAULT.with_values(nodes=500), silent)
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
    panels[2].scatter(*found.keypoints.T, s=2.5, c="#e69f00", linewidths=0)
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
