"""Settings of a refinement: what each pass does, and the size of its blocks.

This module imports no kernels, so that only those are compiled that a goal needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from geomesh.parameters import Effort, Model

# Blocks have at least this side in pixels, and about this many nodes; but not more pixels than
# a worker has memory for.
_SMALLEST = 512
_NODES = 650
_LARGEST = 2048


@dataclass(frozen=True)
class Stage:
    """What one pass does.

    Parameters
    ----------
    share : float
        Share of the wanted nodes that the mesh has after the pass.
    replacements : tuple of float
        Shares of the nodes to replace, one after the other.
    finish : int
        Rounds of moves and flips at the end.
    batches : int
        Batches in which nodes are inserted.
    """

    share: float
    replacements: tuple[float, ...] = ()
    finish: int = 0
    batches: int = 4


# The first pass makes the result independent of the start; the last one takes away the seams of
# the one before.
STAGES: Mapping[str, tuple[Stage, ...]] = MappingProxyType(
    {
        "fast": (Stage(0.3, batches=5), Stage(1.0, finish=1), Stage(1.0, finish=1)),
        "normal": (
            Stage(0.3, batches=8),
            Stage(1.0, (0.15, 0.1)),
            Stage(1.0, (0.15, 0.1, 0.1), 2),
            Stage(1.0, (), 2),
        ),
        "best": (
            Stage(0.3, batches=8),
            Stage(1.0, (0.15, 0.1, 0.1)),
            Stage(1.0, (0.15, 0.15, 0.1, 0.1), 2),
            Stage(1.0, (0.15, 0.1, 0.1, 0.1), 3),
            Stage(1.0, (), 3),
        ),
    }
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
    model: Model
    effort: Effort

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
    size = max(_SMALLEST, 4 * spacing, math.sqrt(_NODES * pixels / max(nodes, 1)))
    return min(size, _LARGEST)
