"""Passes: refine all blocks of a mesh, each by itself, on any workers.

The edges between blocks do not change in a pass. The next pass shifts the blocks, so that these
edges lie inside. The result depends only on the mesh and the plan, not on the workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.raster.grid import Window
from geomesh.refine.parts import Part, Partition, divide

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.arrays.types import Floats, Mask
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.raster.scene import Scene
    from geomesh.refine.units import Units

# Positions of the blocks in successive passes, as shares of their side: corners of the blocks of
# two passes lie inside the blocks of the next ones.
SHIFTS = ((0.0, 0.0), (0.5, 0.5), (0.25, 0.75), (0.75, 0.25))

# What to do with one block. Gets the part, pixel values (B, h, w), the mask (h, w) and a step of
# the plan; returns the part and a report.
Work = Callable[[Part, "Floats", "Mask", Any], tuple[Part, Any]]


@dataclass(frozen=True)
class Crew:
    """What all passes over a scene need.

    Parameters
    ----------
    scene : Scene
    units : Units
    workers : Workers
    size : float
        Side of the blocks in pixels.
    is_late : callable
        Whether the time is over: then the remaining blocks are left as they are.
    """

    scene: Scene
    units: Units
    workers: Workers
    size: float
    is_late: Callable[[], bool]

    def divide(self, whole: Part, turn: int) -> Partition:
        """Return the blocks of the pass number `turn`."""
        return divide(whole, self.size, SHIFTS[turn % len(SHIFTS)])

    def run(
        self,
        blocks: Partition,
        work: Work,
        steps: Sequence[Any],
        progress: Progress,
        message: str,
    ) -> tuple[Part, list[Any]]:
        """Refine all blocks and return the mesh, and the report of each block.

        Parameters
        ----------
        blocks : Partition
        work : callable
        steps : sequence
            One for each block.
        progress : callable(fraction, message)
        message : str
        """
        progress(0.0, f"{message}: {len(blocks)} blocks")
        tasks = (self._task(blocks, b, work, steps[b]) for b in range(len(blocks)))
        parts, reports = [], []
        for done, (part, report) in enumerate(self.workers.map(_refine, tasks), start=1):
            parts.append(part)
            reports.append(report)
            progress(done / len(blocks), f"{message}: block {done} of {len(blocks)}")
        return blocks.join(parts), reports

    def _task(self, blocks: Partition, b: int, work: Work, step: Any) -> _Task:
        part, _ = blocks.part(b)
        window = _window(part, self.scene.grid.extent)
        return _Task(
            self.scene.excerpt(window),
            window,
            part,
            self.units,
            None if self.is_late() else work,
            step,
        )


@dataclass(frozen=True, eq=False)
class _Task:
    scene: Scene
    window: Window
    part: Part
    units: Units
    work: Work | None
    step: Any


def _refine(task: _Task) -> tuple[Part, Any]:
    if task.work is None:
        return task.part, None
    bands, valid = task.scene.read(task.window)
    # Nodes relative to the centre of the first pixel: exact, on the lattice.
    origin = np.array([task.window.col + 0.5, task.window.row + 0.5])
    local = replace(task.part, points=task.part.points - origin)
    part, report = task.work(local, task.units.scaled(bands), valid, task.step)
    return replace(part, points=part.points + origin), report


def _window(part: Part, extent: Window) -> Window:
    """Return the pixels that a part needs, and one more on each side."""
    left, top = np.floor(part.points.min(axis=0)).astype(int).tolist()
    right, bottom = (math.ceil(value) for value in part.points.max(axis=0))
    return Window(left, top, right - left, bottom - top).pad(1).clip(extent)
