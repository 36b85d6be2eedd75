"""Refine the mesh of a scene to the goal of its recipe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.mesh.certify_refined import ANGLE_TOLERANCE
from geomesh.mesh.quality import measure_each
from geomesh.mesh.topology import boundary_edges
from geomesh.pipeline.budget import refined_budget, wanted_nodes
from geomesh.pipeline.goals import reach_goal
from geomesh.pipeline.start import grid_spacing
from geomesh.refine.passes import Crew
from geomesh.refine.refined import start_part
from geomesh.refine.settings import block_size
from geomesh.refine.units import even_units

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.pixels import Pixels
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe
    from geomesh.refine.refined import Refined


@dataclass(frozen=True, eq=False)
class Outcome:
    """A refined mesh, and what refinement says about it.

    Parameters
    ----------
    mesh : TriangleMesh
        Without statistics.
    values : float64 (N, B)
        Values of the linear surface at its nodes.
    budget : int or None
        Number of nodes that was wanted, or the most that were allowed.
    reached : bool
        Whether the goal was reached.
    note : str
        Why it was not, or what had to give way.
    keeps_floor : bool
        Whether no angle inside is smaller than the recipe's `min_angle`.
    """

    mesh: TriangleMesh
    values: Floats
    budget: int | None
    reached: bool
    note: str
    keeps_floor: bool


def refine_scene(
    mesh: TriangleMesh,
    scene: Scene,
    recipe: Recipe,
    overview: Pixels,
    workers: Workers,
    progress: Progress,
    *,
    is_late: Callable[[], bool],
) -> Outcome:
    """Refine a mesh to the goal of a recipe.

    Parameters
    ----------
    mesh : TriangleMesh
        The start: see `geomesh.pipeline.start.start_nodes`.
    scene : Scene
    recipe : Recipe
    overview : (B, h, w), bool (h, w)
        Some of the pixels, and which of them are valid.
    workers : Workers
    progress : callable(fraction, message)
    is_late : callable
        Whether to end early.
    """
    flips = mesh.grid.flips
    triangles = mesh.triangles[:, [0, 2, 1]] if flips else mesh.triangles
    stays = (mesh.node_table["kind"] == "feature") & recipe.keep_features
    start = start_part(mesh.nodes, triangles, mesh.constraints, stays, len(scene.bands))
    pixels = mesh.domain.valid_pixels
    planned = wanted_nodes(recipe, pixels)
    size = block_size(pixels, planned, grid_spacing(pixels, planned))
    crew = Crew(scene, even_units(*overview), workers, size, is_late)
    budget = refined_budget(recipe, pixels, len(np.unique(mesh.constraints)))
    wanted = planned if budget is None else min(budget, pixels)
    result = reach_goal(start, crew, recipe, wanted, budget or pixels, progress)
    refined = result.refined
    triangles = refined.triangles[:, [0, 2, 1]] if flips else refined.triangles
    shaped = replace(
        mesh,
        nodes=refined.nodes,
        triangles=np.ascontiguousarray(triangles),
        constraints=refined.constraints,
        node_table=_nodes_of(mesh, refined),
    )
    keeps_floor, note = result.keeps_floor, result.note
    if keeps_floor and _is_thin_inside(shaped, recipe):
        keeps_floor = False
        note = note or (
            f"between lines or parts of the outline that are too near to each other, angles of "
            f"less than {recipe.min_angle:g} degrees could not be avoided"
        )
    return Outcome(shaped, refined.values, budget, result.reached, note, keeps_floor)


def _is_thin_inside(mesh: TriangleMesh, recipe: Recipe) -> bool:
    """Return whether a triangle without a node that has to stay is below the smallest angle."""
    held = np.zeros(len(mesh.nodes), np.bool_)
    held[mesh.constraints] = True
    held[boundary_edges(mesh.triangles)] = True
    if recipe.keep_features:
        held |= mesh.node_table["kind"] == "feature"
    inner = mesh.triangles[~held[mesh.triangles].any(axis=1)]
    angles = measure_each(mesh.plane_nodes, inner, ("min_angle",))["min_angle"]
    return bool((angles < recipe.min_angle - ANGLE_TOLERANCE).any())


def _nodes_of(mesh: TriangleMesh, refined: Refined) -> Table:
    """Return the columns of the refined nodes. Features keep theirs if they did not move."""
    source = refined.came_from
    stayed = source >= 0
    stayed[stayed] = (mesh.nodes[source[stayed]] == refined.nodes[stayed]).all(axis=1)
    is_feature = np.zeros(len(source), np.bool_)
    is_feature[stayed] = mesh.node_table["kind"][source[stayed]] == "feature"
    on_line, on_border = np.zeros((2, len(source)), np.bool_)
    on_line[refined.constraints] = True
    on_border[boundary_edges(refined.triangles)] = True
    kind = np.where(is_feature, "feature", "refined").astype("<U9")
    kind[on_line] = "breakline"
    kind[on_border] = "border"
    columns: dict[str, NDArray[Any]] = {"kind": kind}
    known = np.flatnonzero(is_feature & ~on_line)
    for name in ("scale", "response", "octave", "angle"):
        columns[name] = np.full(len(source), np.nan, np.float32)
        columns[name][known] = mesh.node_table[name][source[known]]
    return Table(columns)
