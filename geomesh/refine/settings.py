"""Settings of a refinement, and the size of its blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from geomesh.refine.least_squares import STAGES, Stage

if TYPE_CHECKING:
    from geomesh.parameters import Effort, Model

# Blocks have at least this side in pixels, and about this many nodes; but not more pixels than
# a worker has memory for.
_SMALLEST = 512
_NODES = 650
_LARGEST = 2048


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
