"""Nodes and CPU seconds for a bound of the error: geomesh against greedy insertion (pydelatin).

The largest error of both is computed by matplotlib, from the written file of geomesh and from
the arrays of pydelatin.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation

import geomesh
from benchmarks.scoring import spread
from geomesh.errors import GeomeshError
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.scoring import Raster
    from geomesh.arrays.types import Floats, Mask, Points, Triangles

# The bounds in the units of the raster, from a coarse mesh to a fine one.
BOUNDS = {
    "colorado_dem_float32_epsg4269": (20.0, 5.0, 2.0),
    "rmnp_dem": (250.0, 150.0, 80.0),
}

# Rounding of the checker itself, as a share of the bound.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Bounded:
    """One mesh with a bound of the error.

    Parameters
    ----------
    nodes : int
    cpu : float
        CPU seconds of all threads.
    error : float
        Largest error of the valid pixels in triangles.
    missing : int
        Number of valid pixels in no triangle.
    """

    nodes: int
    cpu: float
    error: float
    missing: int

    def holds(self, bound: float) -> bool:
        """Return whether no valid pixel is above the bound or without a triangle."""
        return not self.missing and self.error <= bound * (1 + _ROUNDING)


@dataclass(frozen=True)
class BoundedPair:
    """Both meshes for one raster and bound, and the smallest angle of geomesh's in degrees."""

    raster: str
    bound: float
    ours: Bounded
    theirs: Bounded
    angle: float

    @property
    def ratio(self) -> float:
        """Nodes of geomesh divided by nodes of pydelatin; infinite if the bound does not hold."""
        return self.ours.nodes / self.theirs.nodes if self.ours.holds(self.bound) else np.inf


def compare_bounded(path: Path, raster: Raster, bounds: Sequence[float]) -> list[BoundedPair]:
    """Return both meshes for each bound, after one run of each that compiles."""
    greedy(raster, bounds[0])
    adaptive(path, raster, bounds[0])
    pairs = []
    for bound in bounds:
        ours, angle = adaptive(path, raster, bound)
        pairs.append(BoundedPair(raster.name, bound, ours, greedy(raster, bound), angle))
    return pairs


def adaptive(path: Path, raster: Raster, bound: float) -> tuple[Bounded, float]:
    """Return geomesh's mesh of a DEM file, and its smallest angle in degrees.

    The time is that of the whole pipeline, from the file to the mesh with its statistics. A mesh
    that geomesh refuses has no nodes and covers no pixel.
    """
    start = process_time()
    try:
        mesh = geomesh.mesh_raster(path, preset="adaptive", max_error=bound)
    except GeomeshError:
        return Bounded(0, process_time() - start, np.inf, raster.pixels), 0.0
    cpu = process_time() - start
    with TemporaryDirectory() as folder:
        file = mesh.to_file(Path(folder) / "mesh.gpkg")
        nodes, faces = (gpd.read_file(file, layer=name) for name in ("nodes", "triangles"))
    points = nodes[["col", "row"]].to_numpy(np.float64)
    values = nodes[raster.scene.bands[0].name].to_numpy(np.float64)
    triangles = faces[["n0", "n1", "n2"]].to_numpy(np.int32)
    error, missing = largest_error(points, triangles, values, raster.bands[0], raster.valid)
    return Bounded(len(points), cpu, error, missing), float(faces["min_angle"].min())


def greedy(raster: Raster, bound: float) -> Bounded:
    """Return pydelatin's mesh of a DEM in memory.

    It has no mask: invalid pixels have the value of the nearest valid one, and nodes that only
    they need are not counted.
    """
    from pydelatin import Delatin

    heights = spread(raster.bands[0], raster.valid).astype(np.float32)
    start = process_time()
    found = Delatin(np.ascontiguousarray(heights[::-1]), max_error=bound)
    vertices, triangles = found.vertices, found.triangles
    cpu = process_time() - start
    # The y axis of pydelatin points up, so the heights are upside down. Its nodes are at the
    # centres of pixels.
    points = vertices[:, :2].astype(np.float64) + 0.5
    triangles = np.ascontiguousarray(triangles, np.int32)
    values = vertices[:, 2].astype(np.float64)
    error, missing = largest_error(points, triangles, values, raster.bands[0], raster.valid)
    used = np.arange(len(points))
    if not raster.valid.all():
        owners = find_owners(points, triangles, raster.scene.grid.extent)[raster.valid]
        used = np.unique(triangles[np.unique(owners[owners >= 0])])
    return Bounded(len(used), cpu, error, missing)


def largest_error(
    points: Points, triangles: Triangles, values: Floats, band: Floats, valid: Mask
) -> tuple[float, int]:
    """Return the largest error of the valid pixels, and how many are in no triangle.

    matplotlib finds the triangles and interpolates between the values of their nodes. It
    refuses triangles that overlap.
    """
    surface = LinearTriInterpolator(Triangulation(points[:, 0], points[:, 1], triangles), values)
    row, col = np.nonzero(valid)
    shown = surface(col + 0.5, row + 0.5)
    errors = np.abs(shown.filled(np.nan) - band[valid])
    missing = np.isnan(errors)
    largest = float(errors[~missing].max()) if not missing.all() else np.inf
    return largest, int(np.count_nonzero(missing))
