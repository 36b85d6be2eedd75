"""Refine a mesh so that no valid pixel is farther from the surface than a bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from geomesh.parallel.progress import part_of
from geomesh.refine.bounded import Report, bound_block, is_needed, schedule
from geomesh.refine.refined import finished

if TYPE_CHECKING:
    from geomesh.parallel.progress import Progress
    from geomesh.refine.parts import Part
    from geomesh.refine.passes import Crew
    from geomesh.refine.refined import Refined
    from geomesh.refine.settings import Settings


@dataclass(frozen=True, eq=False)
class Bounded:
    """A mesh that was refined to a bound.

    Parameters
    ----------
    refined : Refined
    violations : int
        Triangles that have a pixel out of bounds.
    keeps_floor : bool
        Whether nodes were inserted under the rule for the smallest angle only.
    """

    refined: Refined
    violations: int
    keeps_floor: bool


def refine_to_bound(crew: Crew, settings: Settings, start: Part, progress: Progress) -> Bounded:
    """Refine a mesh to an error bound with few nodes.

    Parameters
    ----------
    crew : Crew
        With units in which the bound is 1: see `geomesh.refine.units.bound_units`.
    settings : Settings
    start : Part
    progress : callable(fraction, message)
    """
    part, reports = start, list[Report]()
    divided = len(crew.divide(part, 0)) > 1
    steps = schedule(settings.floor, settings.effort, blocks=divided)
    turn, keeps_floor = 0, True
    for i, step in enumerate(steps):
        if not is_needed(step, reports):
            continue
        keeps_floor &= step.floor >= settings.floor
        blocks = crew.divide(part, turn)
        more = part_of(progress, i / len(steps), (i + 1) / len(steps))
        what = "Merging nodes" if step.rounds else "Inserting nodes"
        message = f"{what} within the bound ({len(part.points):,} nodes), pass {turn + 1}"
        part, found = crew.run(blocks, bound_block, [step] * len(blocks), more, message)
        turn += 1
        if None in found:  # the time is over
            return Bounded(finished(part, crew.units, in_time=False), 0, keeps_floor)
        reports = found
    violations = sum(report.violations for report in reports)
    return Bounded(finished(part, crew.units, in_time=True), violations, keeps_floor)
