"""The tile plan: which pixels are read together, whatever the number of workers.

The plan depends on the image alone. A tile answers for the pixels of its core
and reads a halo around it, so that what it finds in the core does not depend on
where the tiles lie.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from geomesh.grid import Window

CORE = 1024
HALO = 64

Result = TypeVar("Result")
Progress = Callable[[float, str], None]


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


def part_of(progress: Progress, start: float, stop: float) -> Progress:
    """Return a callable that reports 0..1 as `start`..`stop` to `progress`."""

    def report(fraction: float, message: str) -> None:
        progress(start + fraction * (stop - start), message)

    return report


def map_tiles(
    function: Callable[[Tile], Result],
    tiles: Sequence[Tile],
    *,
    progress: Progress,
    message: str,
) -> Iterator[Result]:
    """Yield ``function(tile)`` for each tile, in the order of the plan, reporting as it goes."""
    for done, tile in enumerate(tiles):
        progress(done / len(tiles), message)
        yield function(tile)
    progress(1.0, message)
