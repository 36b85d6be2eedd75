"""Put a page together: one HTML file with its style, its program and its data."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import numpy as np

from geomesh.errors import GeoreferenceError, OutputError
from geomesh.io.html import policy_digest
from geomesh.raster.crs import crs_label, same_crs
from geomesh.view.web_map.columns import choose_columns
from geomesh.view.web_map.frame import Frame
from geomesh.view.web_map.mesh_data import pack_mesh

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.view.web_map.image import Image

# A page with more triangles would need too much memory and time in a browser.
MOST_TRIANGLES = 3_000_000

# The parts of the program, each using those before it.
_SCRIPTS = (
    *("codec", "mesh", "columns", "view", "gl", "shaders", "vertices", "relief", "painter"),
    *("basemap", "screen", "input", "panel", "address", "app", "main"),
)

# Ramps of which equal steps look equal. The last one, for directions, ends as it begins.
_RAMPS = {
    "viridis": cv2.COLORMAP_VIRIDIS,
    "cividis": cv2.COLORMAP_CIVIDIS,
    "magma": cv2.COLORMAP_MAGMA,
    "gray": None,
    "twilight": cv2.COLORMAP_TWILIGHT,
}

_COLOR = "color"


@dataclass(frozen=True)
class MapOptions:
    """What a page shows beside the triangles.

    Parameters
    ----------
    column : str, optional
        The attribute that is shown first; "color" are the colours of the image. Default: these,
        or the heights of a mesh of one band that has heights.
    columns : iterable of str, optional
        Attributes in the page; see `geomesh.view.web_map.columns.choose_columns`.
    title : str, optional
        Default: the names of the meshes.
    basemap : str, optional
        Address of web tiles with {z}, {x} and {y}. The page asks for them only when the user
        turns the base map on.
    """

    column: str | None = None
    columns: Iterable[str] | None = None
    title: str | None = None
    basemap: str | None = None

    def __post_init__(self) -> None:
        if self.columns is not None:
            names = (self.columns,) if isinstance(self.columns, str) else tuple(self.columns)
            object.__setattr__(self, "columns", names)
        if self.basemap is not None:
            _origin(self.basemap)


def build_page(
    meshes: Sequence[TriangleMesh],
    names: Sequence[str],
    options: MapOptions,
    image: Image | None = None,
) -> str:
    """Return the page as text.

    Parameters
    ----------
    meshes : sequence of one or two TriangleMesh
        The second one is on the right side of a swipe.
    names : sequence of str
        What the meshes are called.
    options : MapOptions
    image : Image, optional
        Shown on the right side of a swipe if there is one mesh.

    Raises
    ------
    OutputError
        If there are too many triangles, or a column does not exist.
    GeoreferenceError
        If the meshes are not in the same CRS.
    """
    require_fit(meshes)
    first = meshes[0]
    packed = [
        pack_mesh(mesh, first.grid, name, _columns_of(mesh, options))
        for mesh, name in zip(meshes, names, strict=True)
    ]
    lefts, tops, rights, bottoms = zip(*(data.box for data in packed), strict=True)
    frame = Frame(first.grid, (min(lefts), min(tops), max(rights), max(bottoms)))
    title = options.title if options.title is not None else " | ".join(names)
    head = {
        "frame": frame.head(basemap=options.basemap is not None),
        "meshes": [data.head for data in packed],
        "image": None if image is None else image.head(),
        "basemap": options.basemap,
        "column": _first_column(first, options.column, packed[0].head),
        "ramps": _ramps(),
    }
    later = _named([data.later for data in packed])
    if image is not None:
        later["image"] = image.packed()
    blocks = {"first": _tags(_named([data.first for data in packed])), "later": _tags(later)}
    return _fill(title, head, blocks, options.basemap)


def require_fit(meshes: Sequence[TriangleMesh]) -> None:
    """Raise an error if meshes cannot be on one page."""
    count = sum(len(mesh.triangles) for mesh in meshes)
    if count > MOST_TRIANGLES:
        raise OutputError(
            f"{count:,} triangles are too many for one page (at most {MOST_TRIANGLES:,}): mesh "
            "with fewer nodes, mesh a part of the raster, or write map tiles (geomesh tiles)"
        )
    first, *others = (mesh.grid.crs for mesh in meshes)
    for other in others:
        if not (same_crs(first, other) if first and other else first is other):
            raise GeoreferenceError(
                f"the first mesh is in {crs_label(first)} and the second in {crs_label(other)}: "
                "bring both rasters into one CRS (gdalwarp -t_srs) and mesh them again"
            )


def _columns_of(mesh: TriangleMesh, options: MapOptions) -> list[str]:
    """Return the columns that the page needs: those asked for, and the one shown first."""
    chosen = choose_columns(mesh, options.columns)
    shown = [] if options.column in (None, _COLOR) else choose_columns(mesh, options.column)
    heights = [] if mesh.height is None else [mesh.height.band]
    return list(dict.fromkeys([*chosen, *shown, *heights]))


def _first_column(mesh: TriangleMesh, name: str | None, head: dict[str, Any]) -> str:
    """Return the key of the column that is shown first; empty for the colours."""
    if name is not None:
        return "" if name == _COLOR else name
    shown = None if mesh.provenance is None else mesh.provenance.display
    is_terrain = shown is not None and mesh.height is not None and len(set(shown.bands)) == 1
    return head["height"]["key"] if is_terrain and head["height"] else ""


def _fill(title: str, head: dict[str, Any], blocks: dict[str, str], basemap: str | None) -> str:
    parts = (_asset(f"{name}.js") for name in _SCRIPTS)
    script = "\n".join(["(() => {", '"use strict";', *parts, "})();"])
    style = _asset("page.css")
    policy = (
        f"default-src 'none'; script-src {policy_digest(script)}; "
        f"style-src {policy_digest(style)}; "
        f"img-src data: {'' if basemap is None else _origin(basemap)}".rstrip()
    )
    # "<" would end the block of JSON early.
    told = json.dumps(head, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    values = {
        "policy": policy,
        "title": escape(title),
        "style": style,
        "head": told,
        "script": script,
        **blocks,
    }
    # In one pass: a title may look like a place of the page.
    pieces = _asset("page.html").split("<!--")
    filled = [pieces[0]]
    for piece in pieces[1:]:
        name, _, rest = piece.partition("-->")
        filled += [values[name], rest]
    return "".join(filled)


def _named(blocks: Sequence[dict[str, str]]) -> dict[str, str]:
    """Return the blocks of all meshes under one name each."""
    return {f"mesh{k}-{name}": text for k, each in enumerate(blocks) for name, text in each.items()}


def _tags(blocks: dict[str, str]) -> str:
    return "\n".join(
        f'<script type="text/plain" id="{name}">{text}</script>' for name, text in blocks.items()
    )


def _origin(address: str) -> str:
    """Return the origin of web tiles.

    Raises
    ------
    OutputError
        If it is not an address of web tiles.
    """
    parts = urlsplit(address)
    is_web = parts.scheme in ("http", "https") and parts.netloc
    has_places = all(f"{{{place}}}" in parts.path + parts.query for place in "zxy")
    if not (is_web and has_places) or set(address) & set("'\"; "):
        raise OutputError(
            f"the base map {address!r} is not an address of web tiles: write it as "
            "https://host/{z}/{x}/{y}.png"
        )
    return f"{parts.scheme}://{parts.netloc}"


@cache
def _asset(name: str) -> str:
    return (files("geomesh.view.web_map") / "page" / name).read_text(encoding="utf-8")


@cache
def _ramps() -> dict[str, str]:
    """Return the ramps, 256 times red, green and blue, as base64."""
    levels = np.arange(256, dtype=np.uint8)[:, None]
    ramps = {}
    for name, number in _RAMPS.items():
        gray = np.repeat(levels, 3, axis=1)
        colors = gray if number is None else cv2.applyColorMap(levels, number)[:, 0, ::-1]
        ramps[name] = base64.b64encode(np.ascontiguousarray(colors).tobytes()).decode("ascii")
    return ramps
