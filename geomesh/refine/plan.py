"""Refine a mesh by least squares to a number of nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.parallel.progress import part_of
from geomesh.refine.least_squares import Report, Step, refine_block, targets
from geomesh.refine.moments import CONSTANT, LINEAR
from geomesh.refine.refined import finished
from geomesh.refine.settings import Stage

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Mask
    from geomesh.parallel.progress import Progress
    from geomesh.refine.parts import Part
    from geomesh.refine.passes import Crew
    from geomesh.refine.refined import Refined
    from geomesh.refine.settings import Settings


# Passes after those of the plan, while the number of nodes is not the wanted one.
_MOST_EXTRA = 4


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
