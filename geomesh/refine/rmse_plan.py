"""Refine a mesh by least squares to a root mean square error, with about the fewest nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.parallel.progress import part_of
from geomesh.refine.plan import LeastSquares
from geomesh.refine.refined import finished
from geomesh.surface.accuracy import measure_accuracy
from geomesh.surface.fit import Surface, fit_surface, fit_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.parallel.progress import Progress
    from geomesh.refine.parts import Part
    from geomesh.refine.passes import Crew
    from geomesh.refine.refined import Refined
    from geomesh.refine.settings import Settings

# The error falls with about this power of the number of nodes, before two meshes tell.
_USUAL_POWER = -0.4

# The error of the result is at least this share of the limit, if that can be had.
_NEAR = 0.985

# Passes until the search for the number of nodes ends, and the largest factor of a change.
_MOST_PASSES = 12
_LARGEST_FACTOR = 3.0


@dataclass(frozen=True)
class _Trial:
    """A number of nodes, and the largest error of a band as a share of its limit."""

    nodes: int
    ratio: float


def refine_to_rmse(
    crew: Crew,
    settings: Settings,
    start: Part,
    limits: Sequence[float],
    guess: int,
    most: int,
    progress: Progress,
) -> tuple[Refined, bool]:
    """Refine a mesh to a root mean square error with about the fewest nodes.

    Parameters
    ----------
    crew : Crew
    settings : Settings
    start : Part
    limits : sequence of float
        Largest root mean square error of each band, in the raster's units.
    guess : int
        Number of nodes to begin with.
    most : int
        Largest number of nodes.
    progress : callable(fraction, message)

    Returns
    -------
    Refined
    bool
        Whether the error was reached.
    """
    plan = LeastSquares(crew, settings, start)
    first, thorough = settings.stages[0], settings.stages[-2]
    wanted, trials = min(guess, most), list[_Trial]()
    best: Refined | None = None
    plan.run(first, round(wanted * first.share), part_of(progress, 0, 1 / _MOST_PASSES))
    for turn in range(1, _MOST_PASSES):
        more = part_of(progress, turn / _MOST_PASSES, (turn + 1) / _MOST_PASSES)
        plan.run(thorough, wanted, part_of(more, 0, 0.8))
        now = finished(plan.part, crew.units, in_time=not crew.is_late())
        ratio = _error_ratio(now, crew, settings, limits, part_of(more, 0.8, 1))
        trials.append(_Trial(len(now.nodes), ratio))
        more(1.0, f"Refining: {len(now.nodes):,} nodes, {ratio:.3g} times the error limit")
        if ratio <= 1 and (best is None or len(now.nodes) < len(best.nodes)):
            best = now
        before, wanted = wanted, _next(trials, most)
        is_near = _NEAR <= ratio <= 1 or (ratio > 1 and len(now.nodes) >= most)
        if crew.is_late() or wanted == before or (is_near and turn > 1):
            break
    return (now, False) if best is None else (best, True)


def _next(trials: Sequence[_Trial], most: int) -> int:
    """Return the number of nodes to try: where the error would be just below its limit."""
    last = trials[-1]
    power = _USUAL_POWER
    if len(trials) > 1 and trials[-2].nodes != last.nodes:
        before = trials[-2]
        steeper = math.log(max(last.ratio, 1e-9) / max(before.ratio, 1e-9))
        found = steeper / math.log(last.nodes / before.nodes)
        # A pass also improves a mesh of as many nodes, so the slope can be anything.
        power = min(max(found, -1.0), -0.2)
    aim = (1 + _NEAR) / 2
    factor = (aim / max(last.ratio, 1e-9)) ** (1 / power)
    factor = min(max(factor, 1 / _LARGEST_FACTOR), _LARGEST_FACTOR)
    return int(max(min(round(last.nodes * factor), most), 4))


def _error_ratio(
    refined: Refined, crew: Crew, settings: Settings, limits: Sequence[float], progress: Progress
) -> float:
    """Return the largest root mean square error of a band, as a share of its limit."""
    scene, workers = crew.scene, crew.workers
    nodes, triangles = refined.nodes, refined.triangles
    if settings.model == "constant":
        surface = fit_surface(
            nodes, triangles, scene, model="constant", workers=workers, progress=progress
        )
        values = surface.values
    else:
        surface = Surface(nodes, triangles, refined.values, "linear")
        values = fit_values(surface, scene, workers, part_of(progress, 0, 0.7))
    accuracy = measure_accuracy(
        nodes, triangles, values, scene, workers, part_of(progress, 0.7, 1), model=surface.model
    )
    return float((accuracy.rmse / np.asarray(limits)).max())
