"""Record of a refinement: its goal from the recipe, and what was measured afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.errors import BandError
from geomesh.mesh.refinement import Goal, Refinement, surface_digest

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Points, Triangles
    from geomesh.recipe import Recipe
    from geomesh.surface.accuracy import Accuracy


def goal_of(recipe: Recipe) -> Goal:
    """Return the goal of a recipe: a bound if it has one, else a number of nodes."""
    if recipe.max_error is not None:
        return "max_error"
    return "nodes" if recipe.rmse is None else "rmse"


def limits_of(recipe: Recipe, n_bands: int) -> tuple[float, ...]:
    """Return the limit of each band on the goal's error; empty if the goal is a number of nodes.

    Raises
    ------
    BandError
        If the recipe has a list of another number of limits.
    """
    goal = goal_of(recipe)
    if goal == "nodes":
        return ()
    value = getattr(recipe, goal)
    limits = tuple(map(float, value)) if isinstance(value, tuple) else (float(value),) * n_bands
    if len(limits) != n_bands:
        raise BandError(
            f"{goal} has {len(limits)} values and the raster {n_bands} bands: give one value for "
            "all bands, or one for each"
        )
    return limits


def record_refinement(
    recipe: Recipe,
    accuracy: Accuracy,
    nodes: Points,
    triangles: Triangles,
    values: Floats,
    *,
    budget: int | None,
    reached: bool,
    note: str = "",
    min_angle_floor: float | None = None,
) -> Refinement:
    """Return the record of a refinement for the provenance of its mesh.

    Parameters
    ----------
    recipe : Recipe
    accuracy : Accuracy
        Measured on the finished mesh.
    nodes : float64 (N, 2)
    triangles : int32 (T, 3)
    values : float64 (N, B) or (T, B)
        The surface, as it is written.
    budget : int or None
        Number of nodes that was wanted, or the most that were allowed.
    reached : bool
        Whether refinement says that it reached its goal. The certificate fails if the measured
        errors contradict this.
    note : str
        Why the goal was not reached.
    min_angle_floor : float, optional
        In degrees. Default: the recipe's `min_angle`.
    """
    return Refinement(
        model=recipe.model,
        goal=goal_of(recipe),
        budget=budget,
        limits=limits_of(recipe, len(accuracy.bands)),
        reached=reached,
        note=note,
        min_angle_floor=float(recipe.min_angle if min_angle_floor is None else min_angle_floor),
        pixels=accuracy.pixels,
        bands=accuracy.of_bands(),
        digest=surface_digest(nodes, triangles, values),
    )
