"""Show a mesh in a notebook: a short summary, and an interactive map."""

from __future__ import annotations

import base64
import importlib
from html import escape
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from pyproj.exceptions import ProjError

from geomesh.errors import GeoreferenceError, OutputError, extra_required
from geomesh.formats.lonlat import LonLatLayer
from geomesh.mesh.colors import brightened, format_colors, parse_colors
from geomesh.raster.crs import crs_label
from geomesh.view.thumbnail import thumbnail

if TYPE_CHECKING:
    from collections.abc import Iterator

    import geopandas as gpd

    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.triangle_mesh import TriangleMesh

# Maximum number of triangles that a browser draws smoothly.
MOST_EXPLORED = 20_000

# Maximum number of bands whose means are shown for the triangle under the mouse.
_MOST_BANDS = 3

_LABEL = "opacity:.65;white-space:nowrap"
_GRID = "display:grid;grid-template-columns:max-content auto;gap:.1em 1em;align-items:baseline"


def mesh_html(mesh: TriangleMesh) -> str:
    """Return HTML with a thumbnail, the properties and the certificate of a mesh.

    The HTML loads no other files, and suits light and dark pages.
    """
    title = f"{len(mesh.nodes):,} nodes, {len(mesh.triangles):,} triangles"
    rows = "".join(
        f'<div style="{_LABEL}">{label}</div><div>{fact}</div>' for label, fact in _facts(mesh)
    )
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1.2em;align-items:flex-start">'
        f"{_image(mesh)}"
        '<div style="flex:1 1 20em">'
        f'<div style="margin-bottom:.4em"><b>geomesh.Mesh</b>: {title}</div>'
        f'<div style="{_GRID}">{rows}</div></div></div>'
    )


def _facts(mesh: TriangleMesh) -> Iterator[tuple[str, str]]:
    """Yield the properties of a mesh: pairs of label and HTML."""
    grid, metadata = mesh.grid, mesh.metadata
    name = metadata.get("source", {}).get("name")
    size = f"{grid.width:,} × {grid.height:,} pixels"
    yield "Source", f"{escape(str(name))}, {size}" if name else size
    if grid.crs is None:
        yield "CRS", "none"
    else:
        label = crs_label(grid.crs)
        yield "CRS", escape(f"{label}, {grid.crs.name}" if ":" in label else label)
    west, south, east, north = (f"{number:.10g}" for number in grid.bounds())
    yield "Bounds", f"x {west} to {east}, y {south} to {north}"
    preset = metadata.get("recipe", {}).get("preset")
    if preset:
        yield "Preset", escape(str(preset))
    certificate = mesh.certify()
    yield "Smallest angle", f"{certificate.min_angle:.3g}°"
    yield "Certificate", _checks(certificate)
    warnings = metadata.get("warnings", ())
    if warnings:
        yield "Warnings", "<br/>".join(escape(str(warning)) for warning in warnings)


def _checks(certificate: Certificate) -> str:
    """Return HTML with the number of passed checks; it expands to all checks and facts.

    If a check failed, the list is open from the start.
    """
    held = sum(check.passed for check in certificate.checks)
    every = "".join(
        f"<div>{'✓' if check.passed else '✗'} {escape(check.name)} "
        f'<span style="opacity:.65">({escape(check.detail)})</span></div>'
        for check in certificate.checks
    ) + "".join(
        f'<div>{escape(fact.name)}: <span style="opacity:.65">{escape(fact.detail)}</span></div>'
        for fact in certificate.facts
    )
    mark = "✓" if certificate.passed else "✗"
    opened = "" if certificate.passed else ' open=""'
    return (
        f"<details{opened}><summary>{mark} {held} of {len(certificate.checks)} checks hold"
        f"</summary>{every}</details>"
    )


def _image(mesh: TriangleMesh) -> str:
    picture = thumbnail(mesh)
    height, width = picture.shape[:2]
    smallest = (cv2.IMWRITE_PNG_COMPRESSION, 9)
    _, png = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA), smallest)
    data = base64.b64encode(png.tobytes()).decode("ascii")
    return (
        f'<img width="{width}" height="{height}" alt="The mesh" '
        f'src="data:image/png;base64,{data}"/>'
    )


def explore(
    mesh: TriangleMesh, column: str = "color", *, most: int | None = MOST_EXPLORED, **options: Any
) -> Any:
    """Show the triangles on an interactive map, which can be moved and zoomed.

    Parameters
    ----------
    mesh : TriangleMesh
    column : str
        The values that colour the triangles: "color" (the mean colour of the image) or any
        other column of ``mesh.attributes("triangles")``.
    most : int or None
        Maximum number of triangles; a browser becomes slow with more. None for no limit.
    **options
        Options of `geopandas.GeoDataFrame.explore`: ``tiles=None`` for a map without a
        background from the network, ``m=`` to draw on an existing map, ``cmap=``.

    Returns
    -------
    folium.Map

    Raises
    ------
    OutputError
        If there are more triangles than `most`.
    GeoreferenceError
        If the mesh has no CRS, or one that is not on Earth.
    MissingExtraError
        If folium, mapclassify or matplotlib is not installed.
    """
    count = len(mesh.triangles)
    if most is not None and count > most:
        raise OutputError(
            f"{count:,} triangles are too many for a browser (at most {most:,}): mesh with "
            f"nodes={most // 2} or a part with bounds=, or draw them with mesh.plot()"
        )
    attributes = mesh.attributes("triangles")
    if column not in attributes:
        raise ValueError(f"column is {column!r}: choose from {', '.join(attributes)}")
    shown = [name for name in attributes if name.endswith(("_mean", "_majority"))][:_MOST_BANDS]
    tooltip = ["id", "area", *shown]
    filled: dict[str, Any] = {"column": column}
    if column == "color":
        filled = {"color": format_colors(brightened(parse_colors(attributes["color"])))}
    elif column not in tooltip:
        tooltip.append(column)
    style = {"tooltip": tooltip, "style_kwds": {"weight": 0.5, "fillOpacity": 0.8}}
    frame = _on_earth(mesh)[[*tooltip, "geometry"]]
    return frame.explore(**{**style, **filled, **options})


def _on_earth(mesh: TriangleMesh) -> gpd.GeoDataFrame:
    """Return the triangles in longitude and latitude, if the libraries for maps are installed."""
    for library in ("folium", "mapclassify", "matplotlib"):
        with extra_required(library, "notebook"):
            importlib.import_module(library)
    import geopandas as gpd

    crs = mesh.grid.crs
    if crs is None:
        raise GeoreferenceError(
            "the mesh has no CRS, so its position on the web map is unknown: mesh the raster with "
            "`crs='EPSG:...'`, or draw the mesh with mesh.plot()"
        )
    try:
        frame = mesh.to_geodataframe().to_crs(4326)
    except ProjError as error:
        raise GeoreferenceError(
            f"there is no transformation from {crs.name!r} to the longitude and latitude of the "
            "web map: draw the mesh with mesh.plot()"
        ) from error
    if not np.isfinite(frame.total_bounds).all():
        raise GeoreferenceError(
            "some nodes have no longitude and latitude, which the web map needs: leave them out "
            "with bounds= or mask=, or draw the mesh with mesh.plot()"
        )
    # As in GeoJSON: cut at the antimeridian, and whole around a pole.
    layer = LonLatLayer.of(mesh, "triangles")
    shapes = layer.geometry(slice(0, len(layer))).to_numpy(zero_copy_only=False)
    return frame.set_geometry(gpd.GeoSeries.from_wkb(shapes, crs=4326))
