"""Volume between the surface of a mesh and a level, another mesh, or the pixels of a raster."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from geomesh.arrays.jit import contiguous
from geomesh.arrays.table import blocks
from geomesh.errors import GeoreferenceError, OutputError
from geomesh.mesh.height import find_height
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.areas import signed_areas
from geomesh.raster.crs import crs_label, same_crs
from geomesh.terrain.prisms import SCRATCH, overlay, overlay_pixels, prisms

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Floats, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.raster.scene import Scene

# Areas that are this share of the whole, or less, are rounding errors.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Volume:
    """What lies between the surface of a mesh and a base.

    Parameters
    ----------
    cut : float
        Volume of the surface above the base, in cubic metres: what has to be taken away to reach
        the base.
    fill : float
        Volume below the base: what has to be brought.
    cut_area, fill_area : float
        Of the ground where it is so, in square metres. Where both are equal counts as cut.
    missing_area : float
        Of the ground of the mesh where the mesh or the base has no height. It is left out.
    """

    cut: float
    fill: float
    cut_area: float
    fill_area: float
    missing_area: float

    @property
    def net(self) -> float:
        """`cut` - `fill`."""
        return self.cut - self.fill

    def to_dict(self) -> dict[str, float]:
        """Return all numbers by name, `net` too."""
        values = asdict(self)
        return {"cut": values.pop("cut"), "fill": values.pop("fill"), "net": self.net, **values}


def volume_above_level(mesh: TriangleMesh, level: float) -> Volume:
    """Return the volume between a mesh and a horizontal plane.

    Parameters
    ----------
    mesh : TriangleMesh
    level : float
        In the unit of the mesh's heights.
    """
    heights, metres = _heights(mesh)
    if not np.isfinite(level):
        raise OutputError(f"the base is {level}: give a height")
    areas = mesh.grid.areas(mesh.nodes, mesh.triangles)
    found = prisms((heights[mesh.triangles] - level) * metres, areas)
    return _sum(np.nan_to_num(found), areas)


def volume_above_mesh(mesh: TriangleMesh, base: TriangleMesh, progress: Progress) -> Volume:
    """Return the volume between two meshes, on the ground that both cover.

    Parameters
    ----------
    mesh, base : TriangleMesh
        In the same CRS.
    progress : callable(fraction, message)
    """
    heights, metres = _heights(mesh)
    base_heights, base_metres = _heights(base, "the base")
    _require_same_place(mesh, base.grid.crs, "the base")
    triangles = _corners(mesh.map_nodes, heights * metres, mesh.triangles)
    others = _corners(base.map_nodes, base_heights * base_metres, base.triangles)
    others = others[np.isfinite(others).all(axis=(1, 2))]
    tree = shapely.STRtree(shapely.box(*_boxes(others).T))
    found, (x, y), part = np.zeros((len(triangles), 4)), np.empty((2, *SCRATCH)), np.empty(2)
    known = np.flatnonzero(np.isfinite(triangles).all(axis=(1, 2)))
    for block in blocks(len(known)):
        progress(block.start / max(len(known), 1), "Laying one mesh over the other")
        rows = known[block]
        which, other = tree.query(shapely.box(*_boxes(triangles[rows]).T))
        pairs = np.column_stack([rows[which], other])
        overlay(triangles, others, contiguous(pairs, np.int64), x, y, part, found)
    return _on_ground(mesh, found)


def volume_above_pixels(mesh: TriangleMesh, base: Scene, progress: Progress) -> Volume:
    """Return the volume between a mesh and a raster of heights: one prism for each pixel.

    Parameters
    ----------
    mesh : TriangleMesh
    base : Scene
        With one band, in the CRS of the mesh.
    progress : callable(fraction, message)
    """
    heights, metres = _heights(mesh)
    _require_same_place(mesh, base.grid.crs, base.name)
    unit = find_height(base.classes.bands, None, 1.0, base.grid.crs, name=base.name)
    triangles = _corners(base.grid.to_pixel(mesh.map_nodes), heights * metres, mesh.triangles)
    known = np.isfinite(triangles).all(axis=(1, 2))
    west, north, east, south = _boxes(triangles).T
    found, (x, y), part = np.zeros((len(triangles), 4)), np.empty((2, *SCRATCH)), np.empty(2)
    tiles = plan_tiles(base.grid.extent, halo=0)
    with base.open():
        for number, tile in enumerate(tiles):
            progress(number / len(tiles), "Comparing the mesh with pixels")
            window = tile.core
            touches = (east > window.col) & (west < window.stop_col)
            touches &= (south > window.row) & (north < window.stop_row)
            chosen = np.flatnonzero(touches & known)
            if not len(chosen):
                continue
            (values,), valid = base.read(window)
            values = np.where(valid, values.astype(np.float64) * unit.metres, np.nan)
            left, top = float(window.col), float(window.row)
            overlay_pixels(triangles, chosen, values, left, top, x, y, part, found)
    a, b, _, d, e, _ = base.grid.transform[:6]
    return _on_ground(mesh, found * abs(a * e - b * d))


def _heights(mesh: TriangleMesh, name: str = "the mesh") -> tuple[Floats, float]:
    """Return the heights of the nodes, and the metres for a unit of them."""
    if mesh.height is None or mesh.heights is None:
        raise OutputError(f"{name} has no heights: choose the band of heights with `z`")
    return mesh.heights, mesh.height.metres


def _require_same_place(mesh: TriangleMesh, crs: CRS | None, name: str) -> None:
    if not same_crs(mesh.grid.crs, crs):
        raise GeoreferenceError(
            f"the mesh is in {crs_label(mesh.grid.crs)} and {name} in {crs_label(crs)}: reproject "
            "one of them"
        )


def _corners(places: Points, heights: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Return the corners (T, 3, 3) of triangles in space."""
    return np.column_stack([places, heights])[triangles]


def _boxes(corners: Floats) -> Floats:
    """Return the least and the largest x and y of triangles (T, 3, 3): (T, 4)."""
    flat = corners[..., :2]
    return np.concatenate([flat.min(axis=1), flat.max(axis=1)], axis=1)


def _on_ground(mesh: TriangleMesh, found: Floats) -> Volume:
    """Return the volume of prisms whose bases are measured in units of the map."""
    areas = mesh.grid.areas(mesh.nodes, mesh.triangles)
    on_map = np.abs(signed_areas(mesh.map_nodes, mesh.triangles))
    return _sum(found * (areas / on_map)[:, None], areas)


def _sum(found: Floats, areas: Floats) -> Volume:
    cut, fill, cut_area, fill_area = map(float, found.sum(axis=0))
    whole = float(areas.sum())
    missing = whole - cut_area - fill_area
    return Volume(cut, fill, cut_area, fill_area, missing if missing > _ROUNDING * whole else 0.0)
