"""The passes over blocks of a mesh that keep its errors within a bound with few nodes.

Edges between blocks stay as they are in one pass. The next pass has other blocks, so that they
become inner edges: pixels that no node could be inserted for, and nodes that could not be merged,
have their turn then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from geomesh.refine.bounded_block import BoundedBlock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.arrays.types import Floats
    from geomesh.refine.parts import Part

Effort = Literal["fast", "best"]

# Smallest side of a block in pixels.
LEAST_SIDE = 512.0

# Positions of the blocks by pass, as shares of their side, and again. Where the borders of two
# passes cross, the third has none.
SHIFTS = ((0.0, 0.0), (0.5, 0.5), (0.25, 0.75), (0.75, 0.25))

# Passes that insert nodes; passes that merge them and the rounds of each; rounds in a single block.
_INSERTIONS = 4
_MERGES: dict[Effort, tuple[int, int]] = {"fast": (2, 1), "best": (3, 3)}
_ROUNDS: dict[Effort, int] = {"fast": 1, "best": 6}

# Round from which on Newton steps pay: they take longer, and fewer nodes are left.
_PLACING_FROM = 2


@dataclass(frozen=True)
class Step:
    """What is done to each block in one pass.

    Parameters
    ----------
    shift : (float, float)
        Position of the blocks, as a share of their side; see `geomesh.refine.parts.divide`.
    rounds : int
        Rounds in which nodes are moved and merged, after nodes were inserted.
    floor : float
        `sharpness` below which no triangle may fall.
    placing_from : int or None
        The round from which on places of merged nodes are found by Newton steps too.
    if_violated : bool
        The pass is left out if nothing violates the bound after the one before; see `is_needed`.
    """

    shift: tuple[float, float]
    rounds: int
    floor: float
    placing_from: int | None = None
    if_violated: bool = False


@dataclass(frozen=True)
class Report:
    """What a pass left in one block.

    Parameters
    ----------
    nodes : int
        Nodes that only this block has.
    merged : int
        Nodes that vanished.
    violations : int
        Triangles with a pixel out of bounds.
    below_floor : int
        Triangles whose smallest angle is below the floor.
    worst : float
        Greatest error, in units of the bound.
    """

    nodes: int
    merged: int
    violations: int
    below_floor: int
    worst: float


def schedule(floor: float, effort: Effort, *, blocks: bool) -> list[Step]:
    """Return the passes over a mesh.

    Parameters
    ----------
    floor : float
        `sharpness` below which no triangle may fall.
    effort : {"fast", "best"}
    blocks : bool
        Whether the mesh is divided; False: all of it is one block, and one pass suffices.
    """
    place = effort == "best"
    if not blocks:
        return [Step(SHIFTS[0], _ROUNDS[effort], floor, _PLACING_FROM if place else None)]
    passes, rounds = _MERGES[effort]
    steps = []
    for i in range(_INSERTIONS + passes):
        shift, merging = SHIFTS[i % len(SHIFTS)], i - _INSERTIONS
        if merging < 0:
            steps.append(Step(shift, 0, floor, if_violated=i > 0))
        else:
            start = max(_PLACING_FROM - merging * rounds, 0)
            steps.append(Step(shift, rounds, floor, start if place else None))
    return steps


def is_needed(step: Step, reports: Sequence[Report]) -> bool:
    """Return whether a pass is needed after the one before it, of which there are reports."""
    return not step.if_violated or any(report.violations for report in reports)


def work(part: Part, image: Floats, step: Step) -> tuple[Part, Report]:
    """Do one step on one block.

    Parameters
    ----------
    part : Part
        With values in units of the bound.
    image : float64 (B, h, w)
        In units of the bound; NaN where a pixel is not valid.
    step : Step
    """
    block = BoundedBlock(part, image, step.floor)
    block.insert()
    merged = block.simplify(step.rounds, step.placing_from) if step.rounds else 0
    report = Report(block.own, merged, block.violations, block.below_floor, block.worst)
    return block.part(), report
