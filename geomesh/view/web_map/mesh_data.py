"""A mesh as the blocks of numbers of a page, and what the page has to know to read them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine

from geomesh.features.gray import stretch_to_uint8
from geomesh.mesh.colors import brightening
from geomesh.raster.crs import has_angles
from geomesh.raster.grid import LATTICE
from geomesh.view.thumbnail import GRAY, colors_of
from geomesh.view.web_map.codec import below_highest, byte_planes, differences, pack, zigzag
from geomesh.view.web_map.columns import (
    Column,
    Expected,
    area_unit,
    encode_columns,
    measured_columns,
)
from geomesh.view.web_map.order import CurveOrder, order_along_curve, ranks_of_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid
    from geomesh.view.web_map.frame import Box


@dataclass(frozen=True, eq=False)
class MeshData:
    """A mesh as the page reads it.

    Parameters
    ----------
    head : dict
        Plain JSON values.
    first, later : dict of str to str
        Packed blocks: those that the first picture needs, and those that it does not.
    box : (int, int, int, int)
        Of its nodes, in lattice steps of the frame.
    """

    head: dict[str, Any]
    first: dict[str, str]
    later: dict[str, str]
    box: Box


def pack_mesh(mesh: TriangleMesh, grid: Grid, name: str, columns: Sequence[str]) -> MeshData:
    """Return a mesh as blocks.

    Parameters
    ----------
    mesh : TriangleMesh
    grid : Grid
        That of the page, in the CRS of the mesh.
    name : str
        Shown for the mesh.
    columns : sequence of str
        Attributes of the triangles; see `geomesh.view.web_map.columns.choose_columns`.
    """
    order = order_along_curve(mesh.nodes, mesh.triangles)
    nodes = mesh.nodes if grid == mesh.grid else grid.to_pixel(mesh.map_nodes)
    lattice = np.rint(nodes[order.nodes] * LATTICE).astype(np.int64)
    colors = colors_of(mesh)
    bare = colors is None
    if colors is None:
        colors = np.full((len(order.rows), 3), GRAY, np.uint8)
    surface = None if bare else surface_colors(mesh)
    chosen = [_nearer(mesh, column) for column in encode_columns(mesh, columns)]
    first = {
        "nodes": b"".join(byte_planes(differences(axis), 4) for axis in lattice.T),
        "triangles": byte_planes(below_highest(order.triangles.ravel()), 4),
        "colors": _color_planes(colors[order.rows]),
    }
    if surface is not None:
        first["surface"] = _color_planes(surface[order.nodes])
    lines, breaklines = _lines(mesh, order)
    later = {
        "lines": b"".join(byte_planes(differences(ends), 4) for ends in lines.T),
        **_ids(order, lattice),
    }
    for number, column in enumerate(chosen):
        codes = column.codes if column.near is None else column.near.subtract(column.codes, colors)
        rows = order.rows if column.at == "triangles" else order.nodes
        later[f"column{number}"] = byte_planes(codes[rows], 2)
    box = (*lattice.min(axis=0).tolist(), *lattice.max(axis=0).tolist())
    head = {
        "name": name,
        "nodes": len(order.nodes),
        "triangles": len(order.rows),
        "box": list(box),
        "lines": len(lines),
        "breaklines": breaklines,
        "colored": not bare,
        "surface": surface is not None,
        "height": _height(mesh, chosen),
        "gain": 1.0 if bare else brightening(colors),
        "columns": [column.head() for column in chosen],
        "measured": list(measured_columns(mesh)),
        **_measures(mesh, grid),
    }
    return MeshData(head, _packed(first), _packed(later), box)


def surface_colors(mesh: TriangleMesh) -> NDArray[np.uint8] | None:
    """Return the colours (N, 3) of a refined linear surface at the nodes.

    None if the mesh has no such surface, or does not record how its colours were made.
    """
    provenance = mesh.provenance
    if provenance is None or provenance.display is None or provenance.refinement is None:
        return None
    shown = provenance.display
    if provenance.refinement.model != "linear" or not set(shown.bands) <= set(mesh.node_table):
        return None
    levels = []
    for band, (black, white) in zip(shown.bands, shown.ranges, strict=True):
        levels.append(stretch_to_uint8(mesh.node_table[band], black, white))
    return np.stack(levels, axis=1)


def _height(mesh: TriangleMesh, columns: Sequence[Column]) -> dict[str, Any] | None:
    """Return which column of the nodes is their height, and what its values are in metres."""
    if mesh.height is None:
        return None
    keys = [each.key for each in columns if each.at == "nodes" and each.name == mesh.height.band]
    metres = mesh.height.factor * mesh.height.metres
    return {"key": keys[0], "metres": metres} if keys else None


def _nearer(mesh: TriangleMesh, column: Column) -> Column:
    """Return a column, with what the colours let expect if they were made from it."""
    shown = None if mesh.provenance is None else mesh.provenance.display
    names = () if shown is None else tuple(f"{band}_mean" for band in shown.bands)
    if shown is None or column.name not in names or column.kind != "number":
        return column
    channel = names.index(column.name)
    black, white = shown.ranges[channel]
    step = (white - black) / 255 / column.step
    return replace(column, near=Expected(channel, (black - column.low) / column.step, step))


def _color_planes(colors: NDArray[np.uint8]) -> bytes:
    """Return colours as green, and red and blue less green: bands of an image are alike."""
    red, green, blue = colors.T
    return np.stack([green, red - green, blue - green]).tobytes()


def _lines(mesh: TriangleMesh, order: CurveOrder) -> tuple[NDArray[np.int64], int]:
    """Return the outline and then the breaklines, (L, 2) positions in the order of the page."""
    edges = mesh.edges
    place = np.full(len(mesh.nodes), -1, np.int64)
    place[order.nodes] = np.arange(len(order.nodes))
    outline = place[edges.nodes[edges.uses == 1]]
    inside = mesh.attributes("edges")["constrained"] & (edges.uses > 1)
    breaklines = place[edges.nodes[inside]]
    parts = [part[np.lexsort(part.T[::-1])] for part in (outline, breaklines)]
    return np.concatenate(parts), len(breaklines)


def _ids(order: CurveOrder, lattice: NDArray[np.int64]) -> dict[str, bytes]:
    """Return ids as differences to what the page expects: nodes by row, triangles by node.

    Meshes of geomesh are in about this order, so most of the differences are small.
    """
    of_nodes = order.nodes - ranks_of_rows((lattice[:, 0], lattice[:, 1]))
    first = order.nodes[order.triangles[:, 0]]
    of_triangles = order.rows - ranks_of_rows((first,))
    return {
        "nodeIds": byte_planes(zigzag(of_nodes), 4),
        "triangleIds": byte_planes(zigzag(of_triangles), 4),
    }


def _measures(mesh: TriangleMesh, grid: Grid) -> dict[str, Any]:
    """Return how steps of the lattice become lengths in the plane of the mesh, and areas."""
    own = ~mesh.grid.transform @ grid.transform @ Affine.scale(1 / LATTICE)
    scale = Affine.scale(*mesh.plane_scale)
    a, b, _, d, e, _ = (scale @ own)[:6]
    crs = mesh.grid.crs
    area = abs((grid.transform @ Affine.scale(1 / LATTICE)).determinant)
    if crs is not None and not has_angles(crs):
        for axis in crs.axis_info[:2]:
            area *= axis.unit_conversion_factor or 1.0
    return {"plane": [a, b, d, e], "stepArea": area, "areaUnit": area_unit(mesh.grid)}


def _packed(blocks: dict[str, bytes]) -> dict[str, str]:
    return {name: pack(data) for name, data in blocks.items()}
