"""Show a mesh in a notebook: a short summary with a picture."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

import cv2

from geomesh.raster.crs import crs_label
from geomesh.view.thumbnail import thumbnail

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.triangle_mesh import TriangleMesh

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
