"""The tile plan: how an image is divided into tiles, for any number of workers.

The plan depends on the image only. A tile gives the results for the pixels of its core. It
also reads a halo around the core, so that the results do not depend on the position of the
tiles.
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
    """A block of the image. It gives the results for `core`; `read` is the core with its halo."""

    core: Window
    read: Window


def plan_tiles(extent: Window, *, core: int = CORE, halo: int = HALO) -> list[Tile]:
    """Return tiles, row by row, whose cores cover each pixel of `extent` once.

    `core` is the side of a core and `halo` the width of the halo, in pixels.
    """
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
    """Yield ``function(task)`` for each of `total` tasks, in their order, and report progress.

    There is one task for each tile. The order of the results is the order of the plan: it does
    not depend on which worker finishes first.
    """
    progress(0.0, f"{message}: {total} tiles")
    for done, result in enumerate(workers.map(function, tasks), start=1):
        yield result
        progress(done / total, f"{message}: tile {done} of {total}")
