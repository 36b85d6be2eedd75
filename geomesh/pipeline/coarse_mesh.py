"""A mesh with fewer nodes that shows another mesh from far away, with its colours and values."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.errors import GeomeshWarning
from geomesh.mesh.colors import format_colors, parse_colors
from geomesh.mesh.topology import FILL
from geomesh.parallel.tiles import plan_tiles
from geomesh.pipeline.mesh_scene import mesh_scene
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from geomesh.zonal.owners import find_owners
from geomesh.zonal.tile_mesh import split_by_tiles

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Ids
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.pipeline.level_image import LevelImage

# A map shows one colour for each triangle. The outline keeps the smallest islands and holes. What
# takes more time is worth less than 0.1 dB here (docs/tiles.md).
_RECIPE = Recipe.from_preset("adaptive").with_values(
    model="constant", min_hole=1, effort="fast", sift_upsample=False, statistics=("mean",)
)


def coarse_mesh(
    image: LevelImage, nodes: int, workers: Workers, progress: Progress
) -> TriangleMesh:
    """Return a certified mesh of an image, on the grid of its blocks.

    Parameters
    ----------
    image : LevelImage
    nodes : int
        Number of nodes; the outline may need more.
    workers : Workers
    progress : callable(fraction, message)
    """
    grid = image.grid
    pixels = np.ma.MaskedArray(image.bands, np.broadcast_to(~image.inside, image.bands.shape))
    with warnings.catch_warnings():
        # That the outline needs more nodes, or that an image is smooth, is of no use here.
        warnings.simplefilter("ignore", GeomeshWarning)
        scene = open_scene((pixels, grid.transform, grid.crs), name="a smaller image of the mesh")
        shape = mesh_scene(scene, _RECIPE.with_values(nodes=nodes), workers, progress)
    shape.certify().require()
    return replace(shape, node_table=Table({}), triangle_table=Table({}), provenance=None)


def with_values_of(
    coarse: TriangleMesh,
    mesh: TriangleMesh,
    image: LevelImage,
    columns: Sequence[str],
    owned: NDArray[np.int64],
    progress: Progress,
) -> TriangleMesh:
    """Return a coarse mesh with columns of the mesh that it shows.

    A count is the sum over the pixels of a coarse triangle, a minimum and maximum that of their
    triangles, another number with decimals their mean. Whole numbers, texts and truth values
    have no mean: they are those at the middle. A triangle without pixels has the colour of its
    neighbours and no other value.

    Parameters
    ----------
    coarse : TriangleMesh
        From `coarse_mesh`.
    mesh : TriangleMesh
    image : LevelImage
        That of `coarse`.
    columns : sequence of str
    owned : int64 (T,)
        From `count_owned`, of `mesh`.
    progress : callable(fraction, message)
    """
    table = mesh.attributes("triangles")
    wanted = {name: table[name] for name in columns}
    gathered: dict[str, _Gathered] = {}
    if "color" in wanted:
        for k, name in enumerate(("red", "green", "blue")):
            levels = parse_colors(wanted["color"])[:, k].astype(float)
            gathered[f" {name}"] = _Gathered(levels, "mean", len(coarse.triangles))
    if "count" in wanted:
        shares = wanted["count"] / np.maximum(owned, 1)
        gathered["count"] = _Gathered(shares, "sum", len(coarse.triangles))
    for name, values in wanted.items():
        if values.dtype.kind == "f" and name not in ("area", *gathered):
            kind = {"min": "min", "max": "max"}.get(name.rpartition("_")[2], "mean")
            gathered[name] = _Gathered(values, kind, len(coarse.triangles))
    middles = np.full(len(coarse.triangles), FILL, np.int32)
    for done, (part, mine, theirs) in enumerate(_pairs(coarse, mesh, image, middles), start=1):
        for each in gathered.values():
            each.add(part, mine, theirs)
        progress(min(done / 100, 1.0), "Measuring")
    found: dict[str, NDArray[Any]] = {}
    own = coarse.attributes("triangles")
    for name, values in wanted.items():
        if name == "color":
            levels = np.stack([gathered.pop(f" {c}").result() for c in ("red", "green", "blue")], 1)
            found[name] = format_colors(np.rint(_spread(levels, coarse)).astype(np.uint8))
        elif name == "count":
            found[name] = np.rint(gathered[name].result()).astype(np.int32)
        elif name in gathered:
            found[name] = gathered[name].result()
        elif name not in own:
            found[name] = _taken(values, middles)
    return replace(coarse, triangle_table=Table(found, len(coarse.triangles)))


@dataclass(eq=False)
class _Gathered:
    """A column of coarse triangles, from the values of the triangles that own their pixels."""

    values: Floats
    kind: str
    count: int
    total: Floats = field(init=False)
    weight: Floats = field(init=False)

    def __post_init__(self) -> None:
        start = {"min": np.inf, "max": -np.inf}.get(self.kind, 0.0)
        self.total, self.weight = np.full(self.count, start), np.zeros(self.count)

    def add(self, part: Ids, mine: Ids, theirs: Ids) -> None:
        """Add pixels: the coarse triangle (an index of `part`) and the triangle of each."""
        values = self.values[theirs]
        known = ~np.isnan(values)
        if not known.all():
            values, mine = values[known], mine[known]
        self.weight[part] += np.bincount(mine, minlength=len(part))
        if self.kind == "min":
            np.minimum.at(self.total, part[mine], values)
        elif self.kind == "max":
            np.maximum.at(self.total, part[mine], values)
        else:
            self.total[part] += np.bincount(mine, values, minlength=len(part))

    def result(self) -> Floats:
        if self.kind == "sum":
            return self.total
        divisor = self.weight if self.kind == "mean" else np.sign(self.weight)
        with np.errstate(divide="ignore", invalid="ignore"):
            result: Floats = np.where(self.weight > 0, self.total / divisor, np.nan)
        return result


def _pairs(
    coarse: TriangleMesh, mesh: TriangleMesh, image: LevelImage, middles: Ids
) -> Iterator[tuple[Ids, Ids, Ids]]:
    """Yield the pixels of the raster that both meshes cover, tile by tile.

    Yields
    ------
    part : int32 (K,)
        The coarse triangles in the tile.
    mine, theirs : int32 (n,)
        For each pixel the index of its coarse triangle in `part`, and its triangle in `mesh`.

    `middles` gets the triangle of `mesh` at the middle of each coarse triangle.
    """
    nodes = image.to_raster(coarse.nodes)
    centres = np.floor(nodes[coarse.triangles].mean(axis=1)).astype(np.int64)
    tiles = plan_tiles(mesh.grid.extent, halo=0)
    own = split_by_tiles(nodes, coarse.triangles, tiles)
    others = split_by_tiles(mesh.nodes, mesh.triangles, tiles)
    for tile, few, many in zip(tiles, own, others, strict=True):
        core = tile.core
        mine = find_owners(few.nodes, few.triangles, core)
        theirs = find_owners(many.nodes, many.triangles, core)
        both = (mine != FILL) & (theirs != FILL)
        ids = np.append(many.triangle_ids, FILL).astype(np.int32)
        col, row = (centres[few.triangle_ids] - (core.col, core.row)).T
        here = (col >= 0) & (row >= 0) & (col < core.width) & (row < core.height)
        middles[few.triangle_ids[here]] = ids[theirs[row[here], col[here]]]
        yield few.triangle_ids, mine[both], many.triangle_ids[theirs[both]]


def count_owned(mesh: TriangleMesh) -> NDArray[np.int64]:
    """Return the number of pixels that each triangle owns."""
    owned = np.zeros(len(mesh.triangles), np.int64)
    tiles = plan_tiles(mesh.grid.extent, halo=0)
    parts = split_by_tiles(mesh.nodes, mesh.triangles, tiles)
    for tile, part in zip(tiles, parts, strict=True):
        owners = find_owners(part.nodes, part.triangles, tile.core)
        counts = np.bincount(owners.ravel() + 1, minlength=len(part.triangles) + 1)
        owned[part.triangle_ids] += counts[1:]
    return owned


def _spread(levels: Floats, mesh: TriangleMesh) -> Floats:
    """Fill rows (T, 3) without values with the mean of the neighbours, as far as needed."""
    sides = np.column_stack([mesh.edges.left, mesh.edges.right])
    sides = sides[(sides != FILL).all(axis=1)]
    while (missing := np.isnan(levels[:, 0])).any():
        pairs = np.concatenate([sides, sides[:, ::-1]])
        pairs = pairs[missing[pairs[:, 0]] & ~missing[pairs[:, 1]]]
        if not len(pairs):
            return np.nan_to_num(levels, nan=128.0)
        to, come = pairs.T
        counts = np.bincount(to, minlength=len(levels))
        met = counts > 0
        for k in range(levels.shape[1]):
            sums = np.bincount(to, levels[come, k], minlength=len(levels))
            levels[met, k] = sums[met] / counts[met]
    return levels


def _taken(values: NDArray[Any], rows: Ids) -> NDArray[Any]:
    """Return the values of the given rows; None where there is none."""
    if (rows != FILL).all():
        return values[rows]
    taken = np.empty(len(rows), object)
    known = rows != FILL
    taken[known] = values[rows[known]].tolist()
    return taken
