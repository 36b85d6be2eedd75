"""The tile plan: which pixels are read together, whatever the number of workers.

The plan depends on the image alone. A tile answers for the pixels of its core
and reads a halo around it, so that what it finds in the core does not depend on
where the tiles lie.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from geomesh.raster.grid import Window

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers

CORE = 1024
HALO = 64

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Tile:
    """A block of the image: `core` is what it answers for, `read` what it looks at."""

    core: Window
    read: Window


def plan_tiles(extent: Window, *, core: int = CORE, halo: int = HALO) -> list[Tile]:
    """Return the tiles that cover `extent` once with their cores, row by row."""
    tiles = []
    for row in range(extent.row, extent.stop_row, core):
        for col in range(extent.col, extent.stop_col, core):
            block = Window(col, row, core, core).clip(extent)
            tiles.append(Tile(block, block.pad(halo).clip(extent)))
    return tiles


def map_tiles(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    total: int,
    workers: Workers,
    *,
    progress: Progress,
    message: str,
) -> Iterator[Result]:
    """Yield ``function(task)`` for each of `total` tasks, in their order, reporting as it goes.

    There is a task for each tile; its place in the plan, not the worker that did it or when,
    decides where its result comes.
    """
    progress(0.0, f"{message}: {total} tiles")
    for done, result in enumerate(workers.map(function, tasks), start=1):
        yield result
        progress(done / total, f"{message}: tile {done} of {total}")
