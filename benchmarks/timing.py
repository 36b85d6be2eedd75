"""Timing contenders in turn, and what came of it."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


@dataclass(frozen=True)
class Row:
    """One line of the table: geomesh, one peer, and whether their results agree.

    Parameters
    ----------
    case : str
        What was done, to how much.
    peer : str
        What geomesh is compared with; empty if with nothing.
    ours, theirs : sequence of float
        One figure a round, in `unit`.
    expected : float, optional
        The least ratio theirs / ours that geomesh sets itself.
    agree : bool
    evidence : str
        What was compared of the two results, in a few words.
    """

    case: str
    peer: str
    ours: Sequence[float]
    theirs: Sequence[float]
    expected: float | None
    agree: bool
    evidence: str
    unit: str = "s"

    @property
    def ratios(self) -> list[float]:
        """Theirs / ours, round by round: neighbours in time share the machine's mood."""
        return [b / a for a, b in zip(self.ours, self.theirs, strict=False)]

    @property
    def reached(self) -> bool:
        """Whether the median ratio is as expected."""
        return self.expected is None or median(self.ratios) >= self.expected


def alternate(rounds: int, *contenders: Callable[[], Any]) -> tuple[list[list[float]], list[Any]]:
    """Run the contenders in turn, `rounds` times.

    Returns
    -------
    times : list of list of float
        For each contender, the wall-clock seconds of each round.
    results : list
        For each contender, what it returned last.
    """
    times: list[list[float]] = [[] for _ in contenders]
    results: list[Any] = [None] * len(contenders)
    for _ in range(rounds):
        for k, contender in enumerate(contenders):
            results[k] = None
            gc.collect()
            gc.disable()
            try:
                start = perf_counter()
                results[k] = contender()
                times[k].append(perf_counter() - start)
            finally:
                gc.enable()
    return times, results


def spread(values: Sequence[float]) -> str:
    """Return the median and, of more than one value, the range."""
    if not values:
        return "-"
    middle = f"{median(values):.3g}"
    return middle if len(values) == 1 else f"{middle} [{min(values):.3g} to {max(values):.3g}]"
