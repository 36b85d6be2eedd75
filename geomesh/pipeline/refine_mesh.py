"""Refine a mesh that exists already, with the raster from which it was made."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.errors import RecipeError
from geomesh.features.overview import read_overview
from geomesh.mesh.provenance import Provenance
from geomesh.mesh.topology import boundary_edges, edge_keys
from geomesh.parallel.progress import part_of
from geomesh.pipeline.attributes import describe
from geomesh.pipeline.budget import wanted_nodes
from geomesh.pipeline.join import triangulate_nodes
from geomesh.pipeline.mesh_scene import display_of, source_of, tone_of, versions
from geomesh.pipeline.nodes import NodeSet
from geomesh.pipeline.refine_scene import refine_scene
from geomesh.pipeline.start import grid_spacing, start_nodes
from geomesh.raster.areas import signed_areas
from geomesh.raster.grid import snap
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene


def refine_mesh(
    mesh: TriangleMesh,
    scene: Scene,
    goals: dict[str, Any],
    workers: Workers,
    progress: Progress,
    *,
    is_late: Callable[[], bool],
) -> TriangleMesh:
    """Refine a mesh to a goal: see `geomesh.Mesh.refine`.

    Parameters
    ----------
    mesh : TriangleMesh
        From any source; its outline and its other constraints stay.
    scene : Scene
        From `geomesh.surface.original.open_original`.
    goals : dict
        Parameters of the recipe that refinement uses.
    workers : Workers
    progress : callable(fraction, message)
    is_late : callable
        Whether to end early.

    Raises
    ------
    RecipeError
        If a goal is not valid, or the mesh cannot be refined.
    """
    made = mesh.provenance
    recipe = Recipe(preset="adaptive") if made is None else made.recipe
    recipe = recipe.with_values(refine=True, **goals)
    start = _start(mesh, recipe, workers.local)
    with scene.open():
        overview = read_overview(scene, workers, part_of(progress, 0, 0.05))
        tone = tone_of(scene, recipe, overview)
        more = part_of(progress, 0.05, 0.8)
        outcome = refine_scene(start, scene, recipe, overview, workers, more, is_late=is_late)
        more = part_of(progress, 0.8, 1)
        described = describe(outcome.mesh, scene, recipe, tone, workers, more, outcome=outcome)
    notes = tuple(filter(None, [outcome.note]))
    return replace(
        described.mesh,
        provenance=Provenance(
            recipe=recipe,
            source=source_of(scene),
            pixels=described.pixels,
            canny=None if made is None else made.canny,
            warnings=notes if made is None else (*made.warnings, *notes),
            versions=versions(),
            refinement=described.refinement,
            breaklines=None if made is None else made.breaklines,
            display=display_of(scene, tone),
        ),
    )


def _start(mesh: TriangleMesh, recipe: Recipe, threads: Executor) -> TriangleMesh:
    """Return a mesh to start with: the nodes, outline and lines of `mesh`, without small angles.

    Its nodes lie on the lattice of 1/256 pixel.
    """
    certificate = mesh.certify()
    if not certificate.passed:
        failed = "; ".join(check.name for check in certificate.checks if not check.passed)
        raise RecipeError(f"the mesh cannot be refined, because this is not true: {failed}")
    border = np.sort(boundary_edges(mesh.triangles), axis=1)
    nodes = snap(mesh.nodes)
    if mesh.domain.kind == "hull":
        # A hull follows no pixels. Its sides can be divided if they run between half pixels.
        nodes[border] = np.rint(nodes[border] * 2) / 2
    areas = signed_areas(nodes, mesh.triangles)
    if mesh.grid.flips:
        areas = -areas
    if not (areas > 0).all():
        raise RecipeError(
            "the mesh cannot be refined, because some of its triangles are thinner than 1/256 "
            "pixel, or 1/2 pixel at its hull"
        )
    keys = edge_keys(border)
    lines = mesh.constraints[~np.isin(edge_keys(mesh.constraints), keys)]
    domain = replace(mesh.domain, area=float(areas.sum()))
    graded = start_nodes(
        NodeSet(
            points=nodes,
            table=_node_table(mesh),
            segments=np.concatenate([border, lines]).astype(np.int32),
            is_breakline=np.arange(len(border) + len(lines)) >= len(border),
            domain=domain,
        ),
        mesh.grid,
        grid_spacing(domain.valid_pixels, wanted_nodes(recipe, domain.valid_pixels)),
        recipe.min_angle,
        threads,
    )
    size = mesh.grid.width, mesh.grid.height
    graded, triangles = triangulate_nodes(graded, mesh.grid, size, threads)
    return replace(
        mesh,
        nodes=graded.points,
        triangles=triangles,
        constraints=graded.segments,
        domain=domain,
        plane_size=size,
        node_table=graded.table,
        triangle_table=Table({}),
        provenance=None,
    )


def _node_table(mesh: TriangleMesh) -> Table:
    """Return the columns that describe how the nodes were found."""
    count = len(mesh.nodes)
    columns: dict[str, NDArray[Any]] = {
        "kind": mesh.node_table.get("kind", np.full(count, "refined")).astype("<U9")
    }
    for name in ("scale", "response", "octave", "angle"):
        columns[name] = mesh.node_table.get(name, np.full(count, np.nan, np.float32))
    return Table(columns)
