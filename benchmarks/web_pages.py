"""The pages of `benchmarks.web_map`: the same mesh in geomesh's own page, deck.gl and folium."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tarfile
from dataclasses import replace
from importlib.resources import files
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from zipfile import ZipFile

import numpy as np

import geomesh
from benchmarks.scenes import SAMPLE
from geomesh.view.web_map.mesh_data import pack_mesh

if TYPE_CHECKING:
    from geomesh import Mesh

DeckLayer = Literal["solidPolygons", "simpleMesh"]

# What pages of others need. Neither is a dependency of geomesh, nor comes with it.
_PYDECK = "pydeck==0.9.3"
_LEAFLET = "leaflet@1.9.3"

_BUNDLE = "pydeck/nbextension/static/index.js"
_SCRIPT = Path(__file__).with_name("web_deck.js")

# A mesh of the sample has at most about so many triangles: six pixels for each.
_MOST = 62_500

# A mesh has not quite twice as many triangles as nodes, because of those on the outline.
_MORE = 1.005

# A page is finished when the browser has painted what the end of its load has left to do.
_FOLIUM_READY = """<script>
window.bench = {
  ready: new Promise((done) => addEventListener("load", () =>
    requestAnimationFrame(() => requestAnimationFrame(() => {
      bench.times.firstFrame = performance.now();
      done();
    })))),
  times: {},
  idle: () => new Promise((done) =>
    requestAnimationFrame(() => requestAnimationFrame(() => done()))),
};
</script>"""


def load_mesh(folder: Path, triangles: int) -> Mesh:
    """Return a mesh of about so many triangles: one of the sample, mirrored until it has them.

    The mesh of the sample is kept in the folder for the next run.
    """
    times = ceil((triangles / _MOST) ** 0.5)
    nodes = round(_MORE * triangles / times**2 / 2)
    path = folder / f"mesh_{nodes}.gpkg"
    if not path.exists():
        geomesh.mesh_raster(SAMPLE, nodes=nodes, progress=True).to_file(path)
    return mirrored(geomesh.read_mesh(path), times)


def mirrored(mesh: Mesh, times: int) -> Mesh:
    """Return a mesh and its mirror images side by side, joined along the sides of the raster."""
    width, height = mesh.grid.width, mesh.grid.height
    nodes, triangles, origin = [], [], []
    for row, col in np.ndindex(times, times):
        x, y = mesh.nodes.T
        x, y = (width - x if col % 2 else x), (height - y if row % 2 else y)
        corners = mesh.triangles + len(nodes) * len(mesh.nodes)
        nodes.append(np.column_stack([x + col * width, y + row * height]))
        triangles.append(corners[:, ::-1] if (row + col) % 2 else corners)
        origin.append(np.arange(len(mesh.nodes)))
    # Nodes by row, then column, as in every mesh.
    rows, first, place = np.unique(
        np.concatenate(nodes)[:, ::-1], axis=0, return_index=True, return_inverse=True
    )
    joined = np.ascontiguousarray(rows[:, ::-1])
    faces = place.ravel()[np.concatenate(triangles)].astype(np.int32)
    order = np.argsort(faces.min(axis=1), kind="stable")
    whole = replace(
        mesh,
        nodes=joined,
        triangles=faces[order],
        grid=replace(mesh.grid, width=times * width, height=times * height),
        plane_size=(times * width, times * height),
        constraints=np.empty((0, 2), np.int32),
        node_table=mesh.node_table.take(np.concatenate(origin)[first]),
        triangle_table=mesh.triangle_table.take(order % len(mesh.triangles)),
    )
    outline = whole.edges.nodes[whole.edges.uses == 1]
    return replace(whole, constraints=outline)


def write_own(mesh: Mesh, path: Path) -> Path:
    """Write geomesh's own page."""
    return mesh.to_html(path, overwrite=True)


def write_deck(mesh: Mesh, path: Path, layer: DeckLayer, bundle: str) -> Path:
    """Write a page of deck.gl, with the blocks and the decoder of geomesh's own page."""
    data = pack_mesh(mesh, mesh.grid, "mesh", [])
    head = {name: data.head[name] for name in ("nodes", "triangles", "box")} | {"layer": layer}
    codec = (files("geomesh.view.web_map") / "page" / "codec.js").read_text(encoding="utf-8")
    blocks = "\n".join(
        f'<script type="text/plain" id="{name}">{data.first[name]}</script>'
        for name in ("nodes", "triangles", "colors")
    )
    script = _SCRIPT.read_text(encoding="utf-8")
    path.write_text(
        "<!doctype html><meta charset=utf-8><style>body { margin: 0 }</style><body>\n"
        f'<script type="application/json" id="head">{json.dumps(head)}</script>\n{blocks}\n'
        f"<script>{bundle}</script>\n<script>{codec}\n{script}</script>",
        encoding="utf-8",
    )
    return path


def write_folium(mesh: Mesh, path: Path, leaflet: tuple[str, str]) -> Path:
    """Write the page of `GeoDataFrame.explore`, with Leaflet inside and without a base map."""
    frame = mesh.to_geodataframe()[["color", "geometry"]].to_crs(4326)
    style = {"weight": 0, "fillOpacity": 1}
    shown = frame.explore(color=frame["color"], tiles=None, tooltip=False, style_kwds=style)
    script, css = leaflet
    text = shown.get_root().render()
    # What else it asks the network for, such as icons and bootstrap, it does not need for a map.
    text = re.sub(r"<script src=[^>]*></script>|<link rel=\"stylesheet\"[^>]*/>", "", text)
    inside = f"<style>{css}</style><script>{script}</script>{_FOLIUM_READY}"
    text = text.replace("</head>", f"{inside}</head>", 1)
    path.write_text(text, encoding="utf-8")
    return path


def fetch_deck(cache: Path) -> str:
    """Return the program of deck.gl from the wheel of pydeck, by pip."""
    found = list(cache.glob("pydeck-*.whl"))
    if not found:
        options = ("--quiet", "--no-deps", "--dest", str(cache))
        subprocess.run([sys.executable, "-m", "pip", "download", *options, _PYDECK], check=True)
        found = list(cache.glob("pydeck-*.whl"))
    with ZipFile(found[0]) as wheel:
        # An end tag in one of its texts would end the script.
        return wheel.read(_BUNDLE).decode().replace("</script", "<\\/script")


def fetch_leaflet(cache: Path) -> tuple[str, str]:
    """Return the program and the style of Leaflet, by npm."""
    package = cache / f"{_LEAFLET.replace('@', '-')}.tgz"
    if not package.exists():
        subprocess.run(["npm", "pack", "--silent", _LEAFLET], cwd=cache, check=True)
    with tarfile.open(package) as archive:
        names = ("package/dist/leaflet.js", "package/dist/leaflet.css")
        members = [archive.extractfile(name) for name in names]
        script, css = (member.read().decode() for member in members if member is not None)
    return script, css
