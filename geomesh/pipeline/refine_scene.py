"""Refine the mesh of a scene to the goal of its recipe."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.table import Table
from geomesh.mesh.topology import boundary_edges
from geomesh.parallel.progress import part_of
from geomesh.pipeline.nodes import wanted_nodes
from geomesh.pipeline.start import grid_spacing
from geomesh.refine.passes import Crew
from geomesh.refine.refined import start_part
from geomesh.refine.settings import Settings, block_size
from geomesh.refine.units import bound_units, even_units
from geomesh.surface.record import limits_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.pixels import Pixels
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe
    from geomesh.refine.parts import Part
    from geomesh.refine.refined import Refined


# To find the smallest bound that so many nodes can keep: how often to try, which share of the nodes
# is close enough, and the power with which nodes usually grow with the bound.
_MOST_TRIALS = 6
_CLOSE = 0.97
_USUAL_POWER = -1.2


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
        Why it was not.
    """

    mesh: TriangleMesh
    values: Floats
    budget: int | None
    reached: bool
    note: str


def load_kernels(recipe: Recipe) -> None:
    """Import the kernels that the goal of a recipe needs, so that they can be compiled early."""
    if recipe.max_error is not None:
        import geomesh.refine.bound_plan
    else:
        import geomesh.refine.plan
    if recipe.model == "constant":
        import geomesh.refine.shift  # noqa: F401


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
    budget = recipe.node_budget(mesh.domain.valid_pixels)
    refined, note = _reach_goal(start, mesh, scene, recipe, overview, workers, progress, is_late)
    if not refined.in_time:
        note = f"the time was over before refinement was: {len(refined.nodes)} nodes"
    triangles = refined.triangles[:, [0, 2, 1]] if flips else refined.triangles
    shaped = replace(
        mesh,
        nodes=refined.nodes,
        triangles=np.ascontiguousarray(triangles),
        constraints=refined.constraints,
        node_table=_nodes_of(mesh, refined),
    )
    return Outcome(shaped, refined.values, budget, not note, note)


def _reach_goal(
    start: Part,
    mesh: TriangleMesh,
    scene: Scene,
    recipe: Recipe,
    overview: Pixels,
    workers: Workers,
    progress: Progress,
    is_late: Callable[[], bool],
) -> tuple[Refined, str]:
    """Return the refined mesh, and why it does not reach the goal; empty if it does."""
    pixels = mesh.domain.valid_pixels
    budget, wanted = recipe.node_budget(pixels), wanted_nodes(recipe, pixels)
    settings = Settings(recipe.min_angle, recipe.model, recipe.effort)
    size = block_size(pixels, wanted, grid_spacing(pixels, wanted))
    limits = limits_of(recipe, len(scene.bands))
    crew = Crew(scene, even_units(*overview), workers, size, is_late)
    if recipe.max_error is not None:
        return _reach_bound(crew, settings, start, limits, budget, progress)
    # Imported here, as above: kernels for the other goals are not compiled.
    from geomesh.refine.plan import refine_to_nodes, refine_to_rmse

    if recipe.rmse is not None:
        most = budget or pixels
        refined, reached = refine_to_rmse(crew, settings, start, limits, wanted, most, progress)
        note = f"an rmse of {_each(limits)} needs more than {len(refined.nodes)} nodes"
        return refined, "" if reached else note
    refined = refine_to_nodes(crew, settings, start, wanted, progress)
    count = len(refined.nodes)
    if budget is None or count == budget:
        return refined, ""
    if count > budget:
        return refined, f"the outline alone needs {count} nodes, more than the {budget} requested"
    return refined, (
        f"{count} of the {budget} requested nodes: no more fit where the surface differs from the "
        "raster"
    )


def _reach_bound(
    crew: Crew,
    settings: Settings,
    start: Part,
    limits: Sequence[float],
    most: int | None,
    progress: Progress,
) -> tuple[Refined, str]:
    """Return a mesh within a bound, or else the best one of at most `most` nodes, and why."""
    # Imported here: these kernels take long to compile, and no other goal needs them.
    from geomesh.refine.bound_plan import refine_to_bound

    offset, factor, trials = crew.units.offset, 1.0, list[tuple[float, int]]()
    best: Refined | None = None
    for turn in range(_MOST_TRIALS):
        within = replace(crew, units=bound_units([factor * e for e in limits], offset))
        more = progress if most is None else part_of(progress, turn / 4, (turn + 1) / 4)
        bounded = refine_to_bound(within, settings, start, more)
        count = len(bounded.refined.nodes)
        trials.append((factor, count))
        if most is None or (count <= most and turn == 0):
            best = bounded.refined
            break
        if count <= most:
            best = bounded.refined
        if not bounded.refined.in_time or (count <= most and count > _CLOSE * most):
            break
        factor = _next_factor(trials, most)
    refined = bounded.refined if best is None else best
    if trials[-1][0] == 1 and bounded.violations:
        return refined, (
            f"{bounded.violations} triangles have a pixel farther than {_each(limits)} from the "
            "surface, because triangles there would become too thin"
        )
    if trials[0][1] > (most or trials[0][1]):
        return refined, (
            f"an error of {_each(limits)} needs about {trials[0][1]} nodes, more than the {most} "
            "allowed"
        )
    return refined, ""


def _next_factor(trials: Sequence[tuple[float, int]], most: int) -> float:
    """Return the factor of the bound to try, so that a mesh has a little less than `most` nodes.

    Parameters
    ----------
    trials : sequence of (factor, nodes)
    most : int
    """
    factor, count = trials[-1]
    power = _USUAL_POWER
    if len(trials) > 1 and trials[-2][1] != count and trials[-2][0] != factor:
        before, others = trials[-2]
        power = min(max(math.log(count / others) / math.log(factor / before), -3.0), -0.5)
    return float(factor * ((1 + _CLOSE) / 2 * most / count) ** (1 / power))


def _each(limits: Sequence[float]) -> str:
    """Return the limits of the bands as text: one number if all are equal."""
    return ", ".join(f"{limit:g}" for limit in dict.fromkeys(limits))


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
