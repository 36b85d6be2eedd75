"""A TIN of a real DEM in UTM, with a breakline, and what readers of its files should find."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from rasterio.transform import Affine
from rasterio.warp import Resampling, calculate_default_transform, reproject
from shapely.geometry import LineString

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import GeomeshWarning
from geomesh.io.write import write_mesh
from geomesh.mesh.height import Height
from geomesh.raster.grid import Grid
from support.meshes import frame_mesh
from support.samples import SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh import Mesh

DEM = SAMPLES / "colorado_dem_float32_epsg4269.tif"
UTM_13N = "EPSG:26913"
HOSTILE = "<&>\"'北京\x07\n--.tif"


@cache
def utm_tin() -> Mesh:
    """Return a TIN of the Colorado sample in UTM zone 13N, with a breakline across it."""
    with rasterio.open(DEM) as source:
        shape = (source.crs, UTM_13N, source.width, source.height)
        transform, width, height = calculate_default_transform(*shape, *source.bounds)
        heights = np.full((height, width), np.nan, np.float32)
        reproject(
            rasterio.band(source, 1),
            heights,
            dst_transform=transform,
            dst_crs=UTM_13N,
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
        )
    middle = [
        transform @ (share * width, (0.3 + 0.4 * share) * height) for share in (0.2, 0.5, 0.8)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        return geomesh.mesh_raster(
            (heights[None], transform, UTM_13N),
            preset="adaptive",
            max_error=60,
            z=1,
            breaklines=LineString(middle),
        )


def small_tin(crs: str | None = "EPSG:32613", unit: str = "metre", **fields: Any) -> Mesh:
    """Return a small TIN in a CRS, whose heights are in a unit; `fields` are those of a mesh."""
    from geomesh.mesh.height import METRES
    from geomesh.raster.crs import to_pyproj

    transform = Affine(30.1, 0, 482_315.7, 0, -30.1, 4_400_123.3)
    if crs is None:
        transform = Affine.identity()
    mesh = frame_mesh(Grid(40, 30, transform, to_pyproj(crs)))
    heights = np.random.default_rng(3).uniform(-5, 2700, len(mesh.nodes))
    table = Table({**mesh.node_table, "b1": heights})
    return replace(
        mesh,
        node_table=table,
        height=Height("b1", 1.0, unit, METRES[unit], assumed=False),
        **fields,
    )


def with_voids(mesh: Mesh, nodes: list[int]) -> Mesh:
    """Return a mesh of which some nodes have no height."""
    assert mesh.height is not None
    heights = mesh.node_table[mesh.height.band].copy()
    heights[nodes] = np.nan
    return replace(mesh, node_table=Table({**mesh.node_table, mesh.height.band: heights}))


def write(mesh: Mesh, path: Path) -> tuple[Path, list[str]]:
    """Write a mesh, and return the path and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GeomeshWarning)
        write_mesh(mesh, path)
    return path, [str(each.message) for each in caught if each.category is GeomeshWarning]


@dataclass(frozen=True)
class Expected:
    """Corners of the triangles with heights, (T, 3, 3), and the inner edges of breaklines."""

    corners: np.ndarray
    breaklines: set[frozenset[tuple[float, ...]]]
    outline: set[frozenset[tuple[float, ...]]]


def expected(mesh: Mesh) -> Expected:
    """Return what the file of a mesh should have, found out edge by edge."""
    assert mesh.heights is not None
    places = np.column_stack([mesh.map_nodes, mesh.heights])
    corners = places[mesh.triangles]
    kept = np.isfinite(corners).all(axis=(1, 2))
    uses: dict[frozenset[int], int] = {}
    for a, b, c in mesh.triangles[kept].tolist():
        for edge in (frozenset((a, b)), frozenset((b, c)), frozenset((c, a))):
            uses[edge] = uses.get(edge, 0) + 1
    named = {edge: frozenset(tuple(places[node].tolist()) for node in edge) for edge in uses}
    constrained = {frozenset(pair) for pair in mesh.constraints.tolist()}
    breaklines = {named[edge] for edge, count in uses.items() if count == 2 and edge in constrained}
    outline = {named[edge] for edge, count in uses.items() if count == 1}
    return Expected(corners[kept], breaklines, outline)


def edges_of(
    lines: list[np.ndarray], *, closed: bool = False
) -> list[frozenset[tuple[float, ...]]]:
    """Return the edges of lines (P, 3); of a closed line also that to its first point."""
    found = []
    for line in lines:
        points = [tuple(point) for point in line.tolist()]
        ends = [*points[1:], points[0]] if closed else points[1:]
        found += [frozenset(pair) for pair in zip(points, ends, strict=False)]
    return found


def is_counter_clockwise(corners: np.ndarray) -> bool:
    """Return whether triangles (T, 3, 2 or 3) turn left on the map."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return bool((one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0).all())
