"""Inputs of the benchmarks: made from a fixed seed, so they are the same in every run."""

from __future__ import annotations

from functools import cache

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.delaunay.triangulate import constrained_delaunay
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.provenance import (
    CannyThresholds,
    PixelCounts,
    Provenance,
    SourceBand,
    SourceRaster,
)
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.bands import Band
from geomesh.raster.grid import Grid
from geomesh.recipe import Recipe
from geomesh.zonal.columns import triangle_columns
from geomesh.zonal.statistics import Statistics, merge
from geomesh.zonal.tile_statistics import measure_tile

Floats = NDArray[np.float64]

_EXTENT = 8192.0
_SUBPIXELS = 256  # nodes of the pipeline are on a grid of 2^-8 pixels


def uniform(count: int) -> Floats:
    """Return points of a uniform distribution, (count, 2)."""
    return np.random.default_rng(1).uniform(0, _EXTENT, (count, 2))


def clustered(count: int) -> Floats:
    """Return points in clusters of about a thousand, (count, 2)."""
    rng = np.random.default_rng(2)
    centres = rng.uniform(0, _EXTENT, (max(count // 1000, 1), 2))
    return centres[rng.integers(len(centres), size=count)] + rng.normal(0, 8, (count, 2))


def lattice(count: int) -> Floats:
    """Return the largest square lattice of integer points with at most `count` points."""
    side = int(count**0.5)
    return np.indices((side, side), dtype=np.float64).reshape(2, -1).T.copy()


def framed(count: int, size: int) -> tuple[Floats, NDArray[np.int32]]:
    """Return about `count` points in a square of `size` pixels, and its outline's segments."""
    rng = np.random.default_rng(3)
    steps = np.arange(0, size, max(round(size / count**0.5), 1), dtype=np.float64)
    zero, full = np.zeros_like(steps), np.full_like(steps, size)
    sides = [(steps, zero), (full, steps), (size - steps, full), (zero, size - steps)]
    border = np.concatenate([np.column_stack(side) for side in sides])
    cells = rng.integers(_SUBPIXELS, (size - 1) * _SUBPIXELS, (count - len(border), 2))
    inner = np.unique(cells, axis=0) / _SUBPIXELS
    loop = np.arange(len(border), dtype=np.int32)
    segments = np.column_stack([loop, np.roll(loop, -1)])
    return np.concatenate([border, rng.permutation(inner)]), segments


@cache
def image(size: int) -> NDArray[np.uint16]:
    """Return three bands of hills and noise, (3, size, size)."""
    rng = np.random.default_rng(4)
    y, x = np.indices((size, size)) / 64
    hills = [np.sin(x + band) * np.cos(y - band) for band in range(3)]
    noise = rng.normal(0, 0.1, (3, size, size))
    return (10_000 + 4_000 * (np.stack(hills) + noise)).astype(np.uint16)


@cache
def mesh(triangles: int, size: int) -> Mesh:
    """Return a mesh of about `triangles` triangles over all of `image`, with its statistics."""
    points, segments = framed(triangles // 2, size)
    faces, _ = constrained_delaunay(points, segments)
    faces = np.ascontiguousarray(faces[:, [0, 2, 1]])  # rows go down: the map is flipped
    stats = statistics(points, faces, image(size))
    pixels, own = size * size, [Band(index, None, None, f"b{index}") for index in (1, 2, 3)]
    bands = tuple(SourceBand(band.name, band.index, None) for band in own)
    made = Provenance(
        Recipe(),
        SourceRaster("hills and noise", (0, 0, size, size), bands, nodata=None, area=None),
        PixelCounts(pixels, int(stats.count.sum())),
        CannyThresholds(0.0, 0.0),
        warnings=(),
        versions={},
    )
    return Mesh(
        nodes=points,
        triangles=faces,
        grid=Grid(size, size, Affine(10, 0, 500_000, 0, -10, 7_000_000), CRS("EPSG:32723")),
        domain=DomainFacts("image", float(pixels), 1, 0, pixels, pixels),
        constraints=segments,
        triangle_table=Table(triangle_columns(stats, own)),
        provenance=made,
    )


def statistics(
    points: Floats, triangles: NDArray[np.int32], bands: NDArray[np.uint16]
) -> Statistics:
    """Return band statistics, measured tile by tile as in the pipeline."""
    grid = Grid(bands.shape[2], bands.shape[1])
    valid = np.ones(bands.shape[1:], np.bool_)
    partials = []
    for tile in plan_tiles(grid.extent, halo=1):
        rows, cols = tile.read.slices()
        part = bands[:, rows, cols], valid[rows, cols], tile.read, tile.core
        partials.append(measure_tile(points, triangles, *part))
    return merge(partials, len(triangles), len(points), len(bands))
