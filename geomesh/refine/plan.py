"""Refine a mesh by least squares: to a number of nodes, or to a root mean square error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.parallel.progress import part_of
from geomesh.refine.least_squares import Report, Step, refine_block, targets
from geomesh.refine.moments import CONSTANT, LINEAR
from geomesh.refine.refined import finished
from geomesh.refine.settings import Stage
from geomesh.surface.accuracy import measure_accuracy
from geomesh.surface.fit import Surface, fit_surface, fit_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.arrays.types import Floats, Mask
    from geomesh.parallel.progress import Progress
    from geomesh.refine.parts import Part
    from geomesh.refine.passes import Crew
    from geomesh.refine.refined import Refined
    from geomesh.refine.settings import Settings


class LeastSquares:
    """Refine a mesh to a number of nodes, pass by pass.

    Parameters
    ----------
    crew : Crew
    settings : Settings
    start : Part
    """

    def __init__(self, crew: Crew, settings: Settings, start: Part) -> None:
        self._crew, self._settings = crew, settings
        self._turn = 0
        self.part = start
        self.reports: list[Report] = []

    def run(self, stage: Stage, wanted: int, progress: Progress) -> None:
        """Make one pass, after which the mesh has `wanted` nodes as far as possible."""
        blocks = self._crew.divide(self.part, self._turn)
        is_first = self._turn == 0
        measured: list[Report] | None = None
        if is_first and len(blocks) > 1:
            # Without changes: how much of the error is in which block.
            steps = [self._step(stage, -1, is_first=True)] * len(blocks)
            more = part_of(progress, 0, 0.3)
            measured = self._crew.run(blocks, measure_block, steps, more, "Measuring")[1]
            if None in measured:  # the time is over
                measured = None
            progress = part_of(progress, 0.3, 1)
        goals = targets(blocks, measured, wanted)
        steps = [self._step(stage, int(goal), is_first=is_first) for goal in goals]
        message = f"Refining to {wanted:,} nodes{self._error_now()}, pass {self._turn + 1}"
        self.part, self.reports = self._crew.run(blocks, refine_block, steps, progress, message)
        self._turn += 1

    def _error_now(self) -> str:
        """Return the root mean square error after the last pass, as a part of a message."""
        scales = set(self._crew.units.scale.tolist())
        known = [report for report in self.reports if report is not None]
        pixels = sum(report.pixels for report in known)
        if len(scales) > 1 or not pixels:
            return ""  # no pixels yet, or bands in different units
        mean = sum(report.error for report in known) / pixels / len(self._crew.units.scale)
        return f" (error {math.sqrt(mean) * scales.pop():.3g})"

    def _step(self, stage: Stage, target: int, *, is_first: bool) -> Step:
        model = CONSTANT if self._settings.model == "constant" else LINEAR
        return Step(stage, target, is_first, self._settings.floor, model)


def measure_block(part: Part, pixels: Floats, valid: Mask, step: Step) -> tuple[Part, Report]:
    """Return a part unchanged, and its error: see `geomesh.refine.passes.Work`."""
    _, report = refine_block(part, pixels, valid, step)
    return part, report


def refine_to_nodes(
    crew: Crew, settings: Settings, start: Part, wanted: int, progress: Progress
) -> Refined:
    """Refine a mesh to a number of nodes with the least squared error.

    Parameters
    ----------
    crew : Crew
    settings : Settings
    start : Part
    wanted : int
        Number of nodes.
    progress : callable(fraction, message)
    """
    plan = LeastSquares(crew, settings, start)
    stages = settings.stages
    for turn, stage in enumerate(stages):
        more = part_of(progress, turn / len(stages), (turn + 1) / len(stages))
        plan.run(stage, round(wanted * stage.share), more)
    for _ in range(_MOST_EXTRA):
        before = len(plan.part.points)
        if before == wanted or crew.is_late():
            break
        # Blocks could not hold or spare so many nodes: others may, in the next pass.
        plan.run(Stage(1.0, finish=1), wanted, part_of(progress, 1, 1))
        if len(plan.part.points) == before:
            break
    return finished(plan.part, crew.units, in_time=not crew.is_late())


# Passes after those of the plan, while the number of nodes is not the wanted one.
_MOST_EXTRA = 4

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
    first, *_, thorough, _ = (
        settings.stages
        if len(settings.stages) > 3
        else (
            *settings.stages,
            settings.stages[-1],
        )
    )
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
        if crew.is_late() or (ratio > 1 and len(now.nodes) >= most and turn > 1):
            break
        if (_NEAR <= ratio <= 1 and turn > 1) or wanted == (wanted := _next(trials, most)):
            break
    return (now, False) if best is None else (best, True)


def _next(trials: Sequence[_Trial], most: int) -> int:
    """Return the number of nodes to try: where the error would be just below its limit."""
    last = trials[-1]
    power = _USUAL_POWER
    if len(trials) > 1 and trials[-2].nodes != last.nodes:
        one, other = (
            np.log([trials[-2].nodes, last.nodes]),
            np.log([max(trials[-2].ratio, 1e-9), max(last.ratio, 1e-9)]),
        )
        found = float((other[1] - other[0]) / (one[1] - one[0]))
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
