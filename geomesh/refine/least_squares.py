"""The plan of a least-squares refinement: a few passes over shifted blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geomesh.refine.block import Block
from geomesh.refine.moments import image_of
from geomesh.refine.units import sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask
    from geomesh.refine.parts import Part, Partition
    from geomesh.refine.settings import Stage


@dataclass(frozen=True)
class Step:
    """What to do with one block in one pass.

    Parameters
    ----------
    stage : Stage
    target : int
        Number of nodes that only this block has in the end; -1 to measure the error only.
    is_first : bool
        Whether the nodes have no values yet.
    floor : float
        Squared sine of the smallest angle.
    model : int
        `LINEAR` or `CONSTANT`.
    """

    stage: Stage
    target: int
    is_first: bool
    floor: float
    model: int


@dataclass(frozen=True)
class Report:
    """The number of nodes that only one block has, its squared error, and its pixels."""

    own: int
    error: float
    pixels: int


def refine_block(part: Part, pixels: Floats, valid: Mask, step: Step) -> tuple[Part, Report]:
    """Refine one block: see `geomesh.refine.passes.Work`."""
    if step.is_first:
        part = replace(part, values=sampled(part.points, pixels, valid))
    block = Block(part, image_of(pixels, valid), step.floor, step.model)
    if step.is_first:
        block.relax(2, moving=False)
    if step.target >= 0:
        block.adjust(step.target, step.stage.batches)
        for share in step.stage.replacements:
            block.replace(share, step.target)
        if step.stage.finish:
            block.finish(step.stage.finish)
    return block.part(), Report(block.own, block.error, block.pixels)


def share_out(weights: NDArray[np.float64], total: int) -> NDArray[np.int64]:
    """Return whole numbers in proportion to weights (k,), with the given sum.

    The largest remainders are rounded up; of equal ones the first.
    """
    if total <= 0:
        return np.zeros(len(weights), np.int64)
    weights = np.maximum(weights, 1e-9 * max(weights.max(initial=0), 1e-200))
    exact = weights * (total / weights.sum())
    whole: NDArray[np.int64] = np.floor(exact).astype(np.int64)
    order = np.argsort(whole - exact, kind="stable")
    whole[order[: total - int(whole.sum())]] += 1
    shares: NDArray[np.int64] = whole
    return shares


def targets(blocks: Partition, reports: list[Report] | None, wanted: int) -> NDArray[np.int64]:
    """Return the number of nodes that each block should have of its own.

    In the first pass in proportion to its squared error, later by the same factor in each.
    """
    room = wanted - int(blocks.shared.sum())
    if reports is not None:
        return share_out(np.array([report.error for report in reports]), room)
    return share_out(blocks.own().astype(np.float64), room)
