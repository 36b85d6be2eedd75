"""Refine a mesh that exists already, with the raster from which it was made."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.errors import RecipeError
from geomesh.features.overview import read_overview
from geomesh.mesh.provenance import Provenance
from geomesh.mesh.topology import boundary_edges
from geomesh.parallel.progress import part_of
from geomesh.pipeline.attributes import describe
from geomesh.pipeline.mesh_scene import source_of, tone_of, versions
from geomesh.pipeline.refine_scene import refine_scene
from geomesh.raster.areas import signed_areas
from geomesh.raster.grid import snap
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Callable

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
    start = _sound(mesh)
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
        ),
    )


def _sound(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh to start with: certified, on the lattice, its boundary constrained."""
    nodes = snap(mesh.nodes)
    areas = signed_areas(nodes, mesh.triangles)
    if mesh.grid.flips:
        areas = -areas
    certificate = mesh.certify()
    if not certificate.passed or not (areas > 0).all():
        failed = [check.name for check in certificate.checks if not check.passed]
        raise RecipeError(
            "the mesh cannot be refined: "
            + (
                "; ".join(f"not true: {name}" for name in failed)
                or "nodes are closer than 1/256 px"
            )
            + "; make it again"
        )
    border = np.sort(boundary_edges(mesh.triangles), axis=1)
    constraints = np.unique(np.concatenate([np.sort(mesh.constraints, axis=1), border]), axis=0)
    kinds: dict[str, NDArray[Any]] = {
        name: mesh.node_table[name]
        for name in ("kind", "scale", "response", "octave", "angle")
        if name in mesh.node_table
    }
    if len(kinds) < 5:
        kinds = {"kind": np.full(len(nodes), "refined")}
        kinds |= {
            name: np.full(len(nodes), np.nan, np.float32)
            for name in ("scale", "response", "octave", "angle")
        }
    return replace(
        mesh,
        nodes=nodes,
        constraints=constraints.astype(np.int32),
        plane_size=(mesh.grid.width, mesh.grid.height),
        node_table=Table(kinds),
        triangle_table=Table({}),
        provenance=None,
    )
