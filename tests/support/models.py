"""Meshes with heights, and what readers should find in files of 3-D models."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from pyproj import CRS

from geomesh.arrays.table import Table
from geomesh.formats.tin import LocalFrame
from geomesh.mesh.height import Height
from geomesh.raster.grid import Grid
from support.meshes import GEOREFERENCES, random_mesh

if TYPE_CHECKING:
    from geomesh import Mesh

# Grids in US survey feet, one with the code of the CRS; heights in feet come with `in_feet`.
FEET = Grid(50, 40, Affine(10, 0, 600_000, 0, -10, 200_000), CRS("EPSG:2263"))
PLACES = GEOREFERENCES | {"feet": FEET}
US_FOOT = Height("b1", 1.0, "US survey foot", 1200 / 3937, assumed=False)


def terrain(
    grid: Grid = GEOREFERENCES["north-up"],
    *,
    count: int = 200,
    voids: int = 0,
    height: Height = Height("b1"),  # noqa: B008  (it is frozen)
) -> Mesh:
    """Return a mesh with heights between 1000 and 1100, of which some may be missing."""
    mesh = random_mesh(grid, count)
    heights = np.random.default_rng(count).uniform(1000, 1100, count)
    heights[count - voids :] = np.nan
    table = mesh.node_table.with_columns({"b1": heights})
    return replace(mesh, node_table=table, height=height)


def kept(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the triangles with heights, their rows, and the nodes that they have."""
    assert mesh.heights is not None
    rows = np.flatnonzero(np.isfinite(mesh.heights[mesh.triangles]).all(axis=1))
    nodes = np.unique(mesh.triangles[rows])
    return np.searchsorted(nodes, mesh.triangles[rows]), rows, nodes


def local(mesh: Mesh) -> np.ndarray:
    """Return metres east, north and up of the origin, of the nodes that have heights."""
    assert mesh.height is not None
    assert mesh.heights is not None
    _, _, nodes = kept(mesh)
    frame = LocalFrame.of(mesh)
    offset = (mesh.map_nodes[nodes] - frame.origin) * frame.metres
    return np.column_stack([offset, mesh.heights[nodes] * mesh.height.metres])


def mean_colors(mesh: Mesh) -> np.ndarray:
    """Return the colours of the nodes that have heights, one node after the other."""
    _, rows, nodes = kept(mesh)
    places = mesh.map_nodes[mesh.triangles]
    sides = places[:, 1:] - places[:, :1]
    area = np.abs(np.linalg.det(sides))
    found = []
    for node in nodes:
        around = [row for row in rows if node in mesh.triangles[row]]
        levels = [list(bytes.fromhex(mesh.triangle_table["color"][row][1:])) for row in around]
        found.append(np.average(np.array(levels), axis=0, weights=area[around]))
    return np.array(found)


def renamed(mesh: Mesh, names: dict[str, str], **more: Any) -> Mesh:
    """Return a mesh with other names of columns of its triangles."""
    table = {names.get(name, name): values for name, values in mesh.triangle_table.items()}
    return replace(mesh, triangle_table=Table(table), **more)
