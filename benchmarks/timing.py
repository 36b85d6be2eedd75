"""Time contenders in alternating rounds, and store the results."""

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
    """One row of the table: geomesh, one peer, and whether their results agree.

    Parameters
    ----------
    case : str
        The kind and amount of work.
    peer : str
        What geomesh is compared with; empty if there is no peer.
    ours, theirs : sequence of float
        One value per round, in `unit`.
    expected : float, optional
        Minimum ratio theirs / ours that geomesh should reach.
    agree : bool
        Whether the results agree.
    evidence : str
        How the results were compared, in a few words.
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
        """Theirs / ours for each round: in one round, other programs slow down both."""
        return [b / a for a, b in zip(self.ours, self.theirs, strict=False)]

    @property
    def reached(self) -> bool:
        """True if the median ratio is at least the expected ratio."""
        return self.expected is None or median(self.ratios) >= self.expected


def alternate(rounds: int, *contenders: Callable[[], Any]) -> tuple[list[list[float]], list[Any]]:
    """Run all contenders one after the other, `rounds` times.

    Returns
    -------
    times : list of list of float
        For each contender, the wall-clock seconds of each round.
    results : list
        For each contender, its result in the last round.
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
    """Return the median and, if there is more than one value, the range, as text."""
    if not values:
        return "-"
    middle = f"{median(values):.3g}"
    return middle if len(values) == 1 else f"{middle} [{min(values):.3g} to {max(values):.3g}]"
