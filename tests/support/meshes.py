"""Small meshes on grids of every kind."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS
from scipy.spatial import ConvexHull, Delaunay

from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.provenance import (
    CannyThresholds,
    PixelCounts,
    Provenance,
    SourceBand,
    SourceRaster,
)
from geomesh.raster.grid import Grid
from geomesh.recipe import Recipe
from support.rasters import GEOSTATIONARY, MARS

WIDTH, HEIGHT = 40, 30
_UTM_18N = CRS(32618)
# Grids of all orientations on the map.
ORIENTATIONS = {
    "north-up": Grid(WIDTH, HEIGHT, Affine(30, 0, 600_000, 0, -30, 4_900_000), _UTM_18N),
    "south-up": Grid(WIDTH, HEIGHT, Affine(30, 0, 600_000, 0, 30, 4_900_000), _UTM_18N),
    "mirrored": Grid(WIDTH, HEIGHT, Affine(-30, 0, 600_000, 0, -30, 4_900_000), _UTM_18N),
    "rotated": Grid(WIDTH, HEIGHT, Affine(20, 15, 600_000, 15, -20, 4_900_000), _UTM_18N),
    "rotated, south-up": Grid(WIDTH, HEIGHT, Affine(20, -15, 600_000, 15, 20, 4_900_000), _UTM_18N),
    "sheared": Grid(WIDTH, HEIGHT, Affine(30, 9, 600_000, 0, -20, 4_900_000), _UTM_18N),
    "no georeference": Grid(WIDTH, HEIGHT),
}

_NORTH_UP = Affine(10, 0, 500_000, 0, -10, 7_000_000)
_UTM_23S = CRS(32723)
# Grids with each kind of CRS, and one without.
GEOREFERENCES = {
    "north-up": Grid(50, 40, _NORTH_UP, _UTM_23S),
    "rotated": Grid(50, 40, _NORTH_UP @ Affine.rotation(30), _UTM_23S),
    "flipped": Grid(50, 40, Affine(10, 0, 500_000, 0, 10, 7_000_000), _UTM_23S),
    "geographic": Grid(50, 40, Affine(0.01, 0, -44, 0, -0.01, -22), CRS("EPSG:4326")),
    "no CRS": Grid(50, 40),
    "custom CRS": Grid(50, 40, _NORTH_UP, CRS("+proj=laea +lat_0=-27 +lon_0=-45")),
    "geostationary": Grid(50, 40, Affine(2e5, 0, -5e6, 0, -2e5, 4e6), CRS(GEOSTATIONARY)),
    "Mars": Grid(50, 40, Affine(0.01, 0, 10, 0, -0.01, 20), CRS(MARS)),
}


def provenance(**changes: Any) -> Provenance:
    """Return the provenance of a mesh of a small raster with one band.

    `changes` are fields of the Provenance or of its source.
    """
    own: dict[str, Any] = {
        "recipe": Recipe(),
        "pixels": PixelCounts(1200, 1200),
        "canny": CannyThresholds(40.0, 100.0),
        "warnings": ("one",),
        "versions": {"geomesh": "0"},
    }
    of_source = {name: value for name, value in changes.items() if name not in own}
    bands = (SourceBand("b1", 1, None),)
    source = SourceRaster("scene.tif", (0, 0, WIDTH, HEIGHT), bands, nodata=None, area=None)
    changed = {name: changes.get(name, value) for name, value in own.items()}
    return Provenance(source=replace(source, **of_source), **changed)


def frame_mesh(grid: Grid, seed: int = 5, **fields: Any) -> Mesh:
    """Return a Delaunay mesh of the whole frame of a grid, counter-clockwise on the map."""
    w, h = grid.width, grid.height
    frame = np.array([(0, 0), (w, 0), (w, h), (0, h)], float)
    inner = np.random.default_rng(seed).integers((64, 64), (64 * w - 64, 64 * h - 64), (25, 2)) / 64
    nodes = np.concatenate([inner, frame])
    triangles = Delaunay(nodes).simplices.astype(np.int32)
    a, b, c = ((grid.transform.a * x + grid.transform.b * y,
                grid.transform.d * x + grid.transform.e * y)
               for x, y in (nodes[triangles[:, k]].T for k in range(3)))  # fmt: skip
    turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    triangles[turn < 0] = triangles[turn < 0][:, ::-1]
    count = len(nodes)
    measured = np.linspace(0, 1, len(triangles))
    kind = np.where(np.arange(count) < 25, "feature", "border")
    return Mesh(
        nodes=nodes,
        triangles=triangles,
        grid=grid,
        domain=DomainFacts("image", float(w * h), 1, 0, w * h, w * h),
        constraints=np.array([(25, 26), (26, 27), (27, 28), (28, 25)], np.int32),
        node_table=Table(
            {
                "kind": kind,
                **{
                    name: np.linspace(0, 1, count, dtype=np.float32)
                    for name in ("scale", "response", "octave", "angle", "b1")
                },
            }
        ),
        triangle_table=Table(
            {
                "count": np.arange(len(triangles)),
                **{f"b1_{name}": measured for name in ("mean", "std", "min", "max")},
                "color": np.full(len(triangles), "#102030"),
            }
        ),
        **{"provenance": provenance(pixels=PixelCounts(w * h, w * h))} | fields,
    )


def two_triangles(grid: Grid = GEOREFERENCES["north-up"], corner: float = 4.0) -> Mesh:
    """Return a square that is divided along a diagonal. Its outline is constrained.

    0---1        x right, y down
    | / |
    3---2
    """
    nodes = np.array([[0, 0], [corner, 0], [corner, corner], [0, corner]], np.float64)
    triangles = np.array([[0, 3, 1], [1, 3, 2]], np.int32)
    if not grid.flips:
        triangles = triangles[:, ::-1]
    outline = np.array([[3, 2], [0, 1], [3, 0], [1, 2]], np.int32)
    return Mesh(
        nodes,
        triangles,
        grid,
        DomainFacts("valid", corner**2, 1, 0, int(corner**2), int(corner**2)),
        constraints=outline,
    )


def random_mesh(grid: Grid = GEOREFERENCES["north-up"], count: int = 200) -> Mesh:
    """Return a Delaunay mesh of random nodes, with a column of every data type."""
    random = np.random.default_rng(count)
    nodes = random.uniform(0, 1, (count, 2)) * (grid.width, grid.height)
    triangles = Delaunay(nodes).simplices.astype(np.int32)
    (ax, ay), (bx, by) = np.moveaxis(np.diff(grid.to_map(nodes)[triangles], axis=1), 0, -1)
    clockwise = ax * by - ay * bx < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    rows = len(triangles)
    mean = random.uniform(0, 255, rows)
    mean[::7] = np.nan
    return Mesh(
        nodes,
        triangles,
        grid,
        DomainFacts("hull", ConvexHull(nodes).volume, 1, 0, grid.width * grid.height),
        plane_size=(100, 80),
        node_table=Table(
            {
                "kind": np.where(np.arange(count) % 3, "feature", "border"),
                "octave": random.integers(0, 256, count).astype(np.uint8),
                "response": random.random(count).astype(np.float32),
                "b1": random.integers(0, 65_536, count).astype(np.uint16),
            }
        ),
        triangle_table=Table(
            {
                "count": np.arange(rows, dtype=np.int64) + 2**53 + 1,
                "b1_mean": mean,
                "b1_std": mean.astype(np.float32),
                "inside": np.arange(rows) % 2 == 0,
                "color": np.array([f"#{value:06x}" for value in random.integers(0, 1 << 24, rows)]),
                "name": np.array(["", "é", "水域"])[np.arange(rows) % 3],
            }
        ),
        provenance=provenance(
            recipe=Recipe(canny_low=0.1, nodes=None),
            name="São Paulo.tif",
            nodata=1e300 / 3,
            warnings=("<&>\"'\n",),
        ),
    )


def lattice_mesh(crs: str, transform: Affine, width: int = 20, height: int = 20) -> Mesh:
    """Return a mesh of all cells of a grid, each divided into two triangles: no long edges."""
    x, y = np.meshgrid(np.arange(width + 1), np.arange(height + 1))
    nodes = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    corner = (np.arange(height)[:, None] * (width + 1) + np.arange(width)).ravel()
    right, below = corner + 1, corner + width + 1
    triangles = np.concatenate(
        [np.column_stack([corner, below, right]), np.column_stack([right, below, below + 1])]
    )
    facts = DomainFacts("hull", width * height, 1, 0, width * height)
    return Mesh(nodes, triangles, Grid(width, height, transform, CRS(crs)), facts)
