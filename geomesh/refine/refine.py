"""Refine a mesh: a function from a mesh and a scene to a better mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.mesh.topology import edge_keys, neighbours
from geomesh.parallel.progress import part_of
from geomesh.refine.least_squares import (
    STAGES,
    Report,
    Stage,
    Step,
    refine_block,
    targets,
)
from geomesh.refine.moments import CONSTANT, LINEAR
from geomesh.refine.parts import Part
from geomesh.refine.passes import Crew
from geomesh.refine.patch import FREE, STAYS

if TYPE_CHECKING:
    from collections.abc import Callable

    from geomesh.arrays.types import Floats, Ids, Mask, Points, Triangles
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene
    from geomesh.refine.units import Units

# Blocks have at least this side in pixels, and about this many nodes.
_SMALLEST = 512
_NODES = 650


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined triangulation.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
        Oriented as those of the start.
    values : float64 (N, B)
        Values of the linear surface, in the raster's units.
    came_from : int32 (N,)
        Number of the node in the start; -1 for new nodes.
    constraints : int32 (C, 2)
        Pairs of nodes that are hard edges: the outline and breaklines.
    in_time : bool
        False if refinement ended early.
    """

    nodes: Points
    triangles: Triangles
    values: Floats
    came_from: Ids
    constraints: Ids
    in_time: bool


def start_part(
    nodes: Points, triangles: Triangles, constraints: Ids, stays: Mask, bands: int
) -> Part:
    """Return a mesh as one part, without values.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates on the lattice of 1/256 pixel.
    triangles : int32 (T, 3)
        With positive areas in pixel coordinates.
    constraints : int32 (C, 2)
        Pairs of nodes whose edges must stay. The boundary always stays.
    stays : bool (N,)
        Nodes that neither move nor vanish.
    bands : int
    """
    across = neighbours(triangles)
    hard = across < 0
    if len(constraints):
        keys = np.unique(edge_keys(constraints))
        for k in range(3):
            sides = edge_keys(triangles[:, [(k + 1) % 3, (k + 2) % 3]])
            place = np.minimum(np.searchsorted(keys, sides), len(keys) - 1)
            hard[:, k] |= keys[place] == sides
    return Part(
        ids=np.arange(len(nodes), dtype=np.int32),
        points=np.array(nodes, np.float64),
        values=np.zeros((len(nodes), bands)),
        held=np.where(stays, STAYS, FREE).astype(np.uint8),
        triangles=triangles,
        across=across,
        hard=hard.astype(np.uint8),
    )


def finished(part: Part, units: Units, *, in_time: bool) -> Refined:
    """Return a part as arrays in the raster's units, in an order that is easy to read.

    Nodes are sorted by y, then x; a triangle begins with its lowest node, and triangles are
    sorted by their nodes.
    """
    order = np.lexsort((part.points[:, 0], part.points[:, 1]))
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    triangles = number[part.triangles]
    first = triangles.argmin(axis=1)[:, None]
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    row, side = np.nonzero(part.hard)
    ends = [number[part.triangles[row, (side + k) % 3]] for k in (1, 2)]
    constraints = np.unique(np.sort(np.column_stack(ends), axis=1), axis=0)
    return Refined(
        nodes=part.points[order],
        triangles=triangles[np.lexsort((triangles[:, 1], triangles[:, 0]))],
        values=units.raw(part.values[order]),
        came_from=part.ids[order],
        constraints=constraints.reshape(-1, 2),
        in_time=in_time,
    )


@dataclass(frozen=True)
class Settings:
    """How to refine.

    Parameters
    ----------
    min_angle : float
        In degrees.
    model : {"linear", "constant"}
    effort : {"fast", "normal", "best"}
    """

    min_angle: float
    model: str
    effort: str

    @property
    def floor(self) -> float:
        """Squared sine of the smallest angle, with a margin for rounding."""
        return math.sin(math.radians(self.min_angle + 1e-7)) ** 2 if self.min_angle else 0.0

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The passes of a least-squares refinement."""
        return STAGES[self.effort]


def block_size(pixels: int, nodes: int, spacing: float) -> float:
    """Return the side of the blocks for a mesh of so many nodes, in pixels."""
    return max(_SMALLEST, 4 * spacing, math.sqrt(_NODES * pixels / max(nodes, 1)))


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
            progress = part_of(progress, 0.3, 1)
        goals = targets(blocks, measured, wanted)
        steps = [self._step(stage, int(goal), is_first=is_first) for goal in goals]
        message = f"Refining to {wanted:,} nodes, pass {self._turn + 1}"
        self.part, self.reports = self._crew.run(blocks, refine_block, steps, progress, message)
        self._turn += 1

    def _step(self, stage: Stage, target: int, *, is_first: bool) -> Step:
        model = CONSTANT if self._settings.model == "constant" else LINEAR
        return Step(stage, target, is_first, self._settings.floor, model)


def measure_block(part: Part, pixels: Floats, valid: Mask, step: Step) -> tuple[Part, Report]:
    """Return a part unchanged, and its error: see `geomesh.refine.passes.Work`."""
    _, report = refine_block(part, pixels, valid, step)
    return part, report


def refine_to_nodes(
    start: Part,
    scene: Scene,
    units: Units,
    settings: Settings,
    wanted: int,
    *,
    size: float,
    workers: Workers,
    is_late: Callable[[], bool],
    progress: Progress,
) -> Refined:
    """Refine a mesh to a number of nodes with the least squared error.

    Parameters
    ----------
    start : Part
    scene : Scene
    units : Units
    settings : Settings
    wanted : int
        Number of nodes.
    size : float
        Side of the blocks in pixels.
    workers : Workers
    is_late : callable
        Whether to end early.
    progress : callable(fraction, message)
    """
    crew = Crew(scene, units, workers, size, is_late)
    plan = LeastSquares(crew, settings, start)
    stages = settings.stages
    for turn, stage in enumerate(stages):
        more = part_of(progress, turn / len(stages), (turn + 1) / len(stages))
        plan.run(stage, round(wanted * stage.share), more)
    return finished(plan.part, units, in_time=not is_late())
