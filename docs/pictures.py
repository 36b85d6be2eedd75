"""Draw the images of the README, the documentation and the plugin's help from data_samples/.

Run it in the root of a checkout: ``.venv/bin/python docs/pictures.py``.
"""

import tempfile
import warnings
from pathlib import Path
from typing import Any

import geopandas
import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LightSource, to_rgba_array
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
    import report_pictures

    report_pictures.main()
    import tiles_pictures

    tiles_pictures.main()
    import web_map_pictures

    web_map_pictures.main()


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
    draw_terrain_help()


def draw_terrain_help() -> None:
    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    dem = SAMPLES / "colorado_dem_float32_epsg4269.tif"
    mesh = geomesh.mesh_raster(dem, z=1, max_error=20.0)
    scene = open_scene(dem)
    width, height = scene.grid.width, scene.grid.height
    with scene.open():
        (heights, *_), _ = scene.read(scene.grid.extent)
    light = LightSource(315, 45).hillshade(heights, vert_exag=1, dx=8, dy=10)
    nodes = mesh.heights
    assert nodes is not None
    means = nodes[mesh.triangles].mean(axis=1)

    figure, panels = frames(2, 1)
    panels[0].imshow(light, cmap="gray", extent=(0, width, height, 0))
    fill(panels[1], mesh, means, "#00000050")
    for panel in panels:
        panel.set(xlim=(120, 120 + height), ylim=(height, 0), aspect="auto")
    save(figure, "demtotin")

    figure, (panel,) = frames(1, 0.62)
    panel.imshow(light, cmap="gray", extent=(0, width, height, 0), alpha=0.35)
    levels = np.arange(2800, 3900, 25)
    for every, line in ((1, 0.35), (4, 1.0)):
        drawn = panel.tricontour(
            *mesh.nodes.T, mesh.triangles, nodes, levels[::every], colors="#6b4423", linewidths=line
        )
    panel.clabel(drawn, fontsize=5, inline_spacing=1, fmt="%g")
    panel.set(xlim=(150, 450), ylim=(0.62 * 300 + 150, 150))
    save(figure, "contours")

    figure, (panel,) = frames(1, 0.5)
    across, base = heights[300], float(np.median(heights[300]))
    x = np.arange(len(across))
    panel.fill_between(x, across.min() - 60, np.minimum(across, base), color="#d9d2c5")
    panel.fill_between(x, base, across, where=across > base, color="#d55e00", alpha=0.75)
    panel.fill_between(x, across, base, where=across < base, color="#56b4e9", alpha=0.75)
    panel.axhline(base, color="#222222", linewidth=0.8)
    for text, above in (("cut", True), ("fill", False)):
        where = int(np.argmax(across) if above else np.argmin(across))
        panel.text(where, (across[where] + base) / 2, text, fontsize=8, ha="center", va="center")
    panel.set(xlim=(0, len(across) - 1), ylim=(across.min() - 60, across.max() + 20))
    save(figure, "volume")

    figure, (panel,) = frames(1, 0.55)
    turn = np.radians(30)
    x, y = mesh.nodes.T[0] - width / 2, (height / 2 - mesh.nodes.T[1]) * 1.28
    right, away = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    up = 0.45 * away + 0.9 * (nodes - nodes.min()) / 8
    corners = np.stack([right, up], axis=1)[mesh.triangles]
    order = np.argsort(-away[mesh.triangles].mean(axis=1))  # the farthest first
    slopes = LightSource(315, 40).shade_normals(normals(x, y, nodes / 8, mesh.triangles))
    colors = mpl.colormaps["viridis"]((means - means.min()) / np.ptp(means))
    colors[:, :3] *= 0.45 + 0.55 * slopes[:, None]
    style = {"facecolors": colors[order], "edgecolors": "#00000040", "linewidths": 0.2}
    panel.add_collection(PolyCollection(corners[order], **style))
    panel.set(xlim=(right.min(), right.max()), ylim=(up.min() - 5, up.max() + 5))
    save(figure, "exporttin")


def normals(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], triangles: NDArray[Any]
) -> NDArray[Any]:
    """Return the upward normals of triangles."""
    a, b, c = np.moveaxis(np.stack([x, y, z], axis=1)[triangles], 1, 0)
    found = np.cross(b - a, c - a)
    found *= np.sign(found[:, 2:])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


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
