"""Join nodes to triangles: the last step before statistics, or the start of refinement."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.pipeline.budget import wanted_nodes
from geomesh.pipeline.start import grid_spacing, start_nodes

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from geomesh.arrays.types import Triangles
    from geomesh.pipeline.nodes import NodeSet
    from geomesh.raster.grid import Grid
    from geomesh.recipe import Recipe


def join_nodes(
    nodes: NodeSet, grid: Grid, plane_size: tuple[int, int], recipe: Recipe, threads: Executor
) -> TriangleMesh:
    """Return the mesh of the nodes, without attributes; the start of refinement if there is one.

    Parameters
    ----------
    nodes : NodeSet
    grid : Grid
        The pixel grid of the source.
    plane_size : (int, int)
        Width and height of the image in whose plane the triangulation is Delaunay.
    recipe : Recipe
    threads : Executor
    """
    if recipe.refine:
        pixels = nodes.domain.valid_pixels
        spacing = grid_spacing(pixels, wanted_nodes(recipe, pixels))
        nodes = start_nodes(nodes, grid, spacing, recipe.min_angle, threads)
    nodes, triangles = triangulate_nodes(nodes, grid, plane_size, threads)
    return TriangleMesh(
        nodes=nodes.points,
        triangles=triangles,
        grid=grid,
        domain=nodes.domain,
        constraints=nodes.segments,
        plane_size=plane_size,
        node_table=nodes.table,
    )


def triangulate_nodes(
    nodes: NodeSet, grid: Grid, plane_size: tuple[int, int], threads: Executor
) -> tuple[NodeSet, Triangles]:
    """Triangulate nodes; return the nodes in use, and triangles counter-clockwise on the map.

    Parameters
    ----------
    nodes : NodeSet
    grid : Grid
        The pixel grid of the source.
    plane_size : (int, int)
        Width and height of the image in whose plane the triangulation is Delaunay.
    threads : Executor
        Used if there are too many nodes for one triangulation.
    """
    plane = nodes.points * (plane_size[0] / grid.width, plane_size[1] / grid.height)
    if len(nodes.segments):
        outline, lines = nodes.segments[~nodes.is_breakline], nodes.segments[nodes.is_breakline]
        triangles, used = constrained_delaunay(plane, outline, lines=lines, executor=threads)
    else:
        triangles, used = delaunay(plane, executor=threads)
    new_id = np.full(len(nodes.points), -1, np.int32)
    new_id[used] = np.arange(len(used), dtype=np.int32)
    triangles = new_id[triangles]
    if grid.flips:
        triangles = triangles[:, [0, 2, 1]]
    # In the order of the edges, which is the order when a mesh is read from a file.
    segments, first = np.unique(
        np.sort(new_id[nodes.segments], axis=1).reshape(-1, 2), axis=0, return_index=True
    )
    kept = replace(
        nodes,
        points=nodes.points[used],
        table=nodes.table.take(used),
        segments=segments,
        is_breakline=nodes.is_breakline[first],
    )
    return kept, np.ascontiguousarray(triangles)
