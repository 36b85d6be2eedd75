"""The passes over blocks of a mesh that keep its errors within a bound with few nodes.

Edges between blocks stay as they are in one pass. The next pass has other blocks, so that they
become inner edges: pixels that no node could be inserted for, and nodes that could not be merged,
have their turn then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from geomesh.refine.bounded_block import BoundedBlock
from geomesh.refine.units import sampled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from geomesh.arrays.types import Floats, Mask
    from geomesh.parameters import Effort
    from geomesh.refine.parts import Part

# Passes that insert nodes; passes that merge them and the rounds of each; rounds in a single block.
_INSERTIONS = 4
_MERGES: Mapping[Effort, tuple[int, int]] = MappingProxyType(
    {"fast": (2, 1), "normal": (3, 3), "best": (3, 3)}
)
_ROUNDS: Mapping[Effort, int] = MappingProxyType({"fast": 1, "normal": 6, "best": 6})

# `sharpness` of the triangles that are made where the bound cannot be kept otherwise: 0.5 degrees.
_THINNEST = 7.6e-5

# Round from which on Newton steps pay: they take longer, and fewer nodes are left.
_PLACING_FROM = 2


@dataclass(frozen=True)
class Step:
    """What is done to each block in one pass.

    Parameters
    ----------
    rounds : int
        Rounds in which nodes are moved and merged, after nodes were inserted.
    floor : float
        `sharpness` below which no triangle may fall.
    placing_from : int or None
        The round from which on places of merged nodes are found by Newton steps too.
    if_violated : bool
        The pass is left out if nothing violates the bound after the one before; see `is_needed`.
    is_first : bool
        Whether the nodes have no values yet.
    """

    rounds: int
    floor: float
    placing_from: int | None = None
    if_violated: bool = False
    is_first: bool = False


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
    effort : {"fast", "normal", "best"}
        "best": places of merged nodes are also found by Newton steps.
    blocks : bool
        Whether the mesh is divided; False: all of it is one block, and one pass suffices.
    """
    place = effort == "best"
    # The bound comes before the floor: the last steps insert nodes without it.
    last = [Step(0, _THINNEST, if_violated=True)] * (_INSERTIONS if floor > _THINNEST else 0)
    if not blocks:
        start = _PLACING_FROM if place else None
        return [Step(_ROUNDS[effort], floor, start, is_first=True), *last]
    steps = [Step(0, floor, if_violated=i > 0, is_first=i == 0) for i in range(_INSERTIONS)]
    passes, rounds = _MERGES[effort]
    for i in range(passes):
        start = max(_PLACING_FROM - i * rounds, 0) if place else None
        steps.append(Step(rounds, floor, start))
    # Blocks may leave pixels out of bounds beside their borders.
    return [*steps, *[Step(0, floor, if_violated=True)] * _INSERTIONS, *last]


def is_needed(step: Step, reports: Sequence[Report]) -> bool:
    """Return whether a pass is needed after the one before it, of which there are reports."""
    return not step.if_violated or any(report.violations for report in reports)


def bound_block(part: Part, pixels: Floats, valid: Mask, step: Step) -> tuple[Part, Report]:
    """Do one step on one block: see `geomesh.refine.passes.Work`. Units are those of the bound."""
    if step.is_first:
        part = replace(part, values=sampled(part.points, pixels, valid))
    block = BoundedBlock(part, np.where(valid, pixels, np.nan), step.floor)
    block.insert()
    merged = block.simplify(step.rounds, step.placing_from) if step.rounds else 0
    report = Report(block.own, merged, block.violations, block.below_floor, block.worst)
    return block.part(), report
