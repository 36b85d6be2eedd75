"""The goals of a refinement: what each asks for, and what is said if it was not reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from geomesh.mesh.topology import boundary_edges
from geomesh.parallel.progress import part_of
from geomesh.pipeline.budget import note_on_refined
from geomesh.refine.settings import Settings
from geomesh.refine.units import bound_units
from geomesh.surface.record import limits_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.parallel.progress import Progress
    from geomesh.recipe import Recipe
    from geomesh.refine.bound_plan import Bounded
    from geomesh.refine.parts import Part
    from geomesh.refine.passes import Crew
    from geomesh.refine.refined import Refined

# To find the smallest bound that so many nodes can keep: how often to try, which share of the nodes
# is close enough, and the power with which nodes usually grow with the bound.
_MOST_TRIALS = 6
_CLOSE = 0.97
_USUAL_POWER = -1.2


@dataclass(frozen=True, eq=False)
class Result:
    """A refined mesh, and whether it reaches its goal.

    Parameters
    ----------
    refined : Refined
    note : str
        Why it does not, or what had to give way. Empty if all is as wanted.
    reached : bool
    keeps_floor : bool
        Whether no angle inside is smaller than wanted.
    """

    refined: Refined
    note: str = ""
    reached: bool = True
    keeps_floor: bool = True


def load_kernels(recipe: Recipe) -> None:
    """Import the kernels that the goal of a recipe needs, so that they can be compiled early."""
    if recipe.max_error is not None:
        import geomesh.refine.bound_plan
    else:
        import geomesh.refine.plan
    if recipe.model == "constant":
        import geomesh.refine.shift  # noqa: F401


def reach_goal(
    start: Part, crew: Crew, recipe: Recipe, wanted: int, most: int, progress: Progress
) -> Result:
    """Refine a mesh to the goal of a recipe.

    Parameters
    ----------
    start : Part
    crew : Crew
    recipe : Recipe
    wanted : int
        Number of nodes to begin with, or to reach.
    most : int
        Largest number of nodes.
    progress : callable(fraction, message)
    """
    settings = Settings(recipe.min_angle, recipe.model, recipe.effort)
    limits = limits_of(recipe, len(crew.units.scale))
    if recipe.max_error is not None:
        limited = most if recipe.nodes is not None else None
        result = _reach_bound(crew, settings, start, limits, limited, progress)
    else:
        # Imported here, as below: kernels for other goals are not compiled.
        from geomesh.refine.plan import refine_to_nodes
        from geomesh.refine.rmse_plan import refine_to_rmse

        if recipe.rmse is not None:
            refined, reached = refine_to_rmse(crew, settings, start, limits, wanted, most, progress)
            note = f"an rmse of {_each(limits)} needs more than {len(refined.nodes)} nodes"
            result = Result(refined, "" if reached else note, reached)
        else:
            refined = refine_to_nodes(crew, settings, start, wanted, progress)
            inner = len(refined.constraints) > len(boundary_edges(refined.triangles))
            note = note_on_refined(len(refined.nodes), most, recipe, has_breaklines=inner)
            result = Result(refined, note, not note)
    if result.refined.in_time:
        return result
    note = f"the time was over before refinement was: {len(result.refined.nodes)} nodes"
    return replace(result, note=note, reached=False)


def _reach_bound(
    crew: Crew,
    settings: Settings,
    start: Part,
    limits: Sequence[float],
    most: int | None,
    progress: Progress,
) -> Result:
    """Return a mesh within a bound, or else one of at most `most` nodes within a larger one."""
    from geomesh.refine.bound_plan import refine_to_bound

    def keep(factor: float, progress: Progress) -> Bounded:
        units = bound_units([factor * limit for limit in limits], crew.units.offset)
        return refine_to_bound(replace(crew, units=units), settings, start, progress)

    first = keep(1.0, progress if most is None else part_of(progress, 0, 0.3))
    needed = len(first.refined.nodes)
    if most is None or needed <= most or not first.refined.in_time:
        return _kept(first, settings, limits)
    trials, best = [(1.0, needed)], first
    for turn in range(1, _MOST_TRIALS):
        factor = _next_factor(trials, most)
        more = part_of(progress, 0.3 + 0.14 * (turn - 1), 0.3 + 0.14 * turn)
        found = keep(factor, more)
        count = len(found.refined.nodes)
        trials.append((factor, count))
        if count <= most or len(best.refined.nodes) > most:
            best = found
        if not found.refined.in_time or _CLOSE * most < count <= most:
            break
    return Result(
        best.refined,
        f"an error of {_each(limits)} needs about {needed} nodes, more than the {most} allowed",
        reached=False,
        keeps_floor=best.keeps_floor,
    )


def _kept(bounded: Bounded, settings: Settings, limits: Sequence[float]) -> Result:
    """Return the result of a refinement to a bound, and what had to give way."""
    if bounded.violations:
        note = (
            f"{bounded.violations} triangles have a pixel farther than {_each(limits)} from the "
            "surface, and no more nodes fit there"
        )
        return Result(bounded.refined, note, reached=False, keeps_floor=bounded.keeps_floor)
    if not bounded.keeps_floor:
        note = (
            f"the bound of {_each(limits)} needs triangles with angles of less than "
            f"{settings.min_angle:g} degrees"
        )
        return Result(bounded.refined, note, keeps_floor=False)
    return Result(bounded.refined)


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
