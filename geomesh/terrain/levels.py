"""The levels of contours: multiples of an interval, or those that a user names."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import ROUND_FLOOR, Context, Decimal, localcontext
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import LevelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.arrays.types import Floats, Mask

MOST_LEVELS = 10_000

# Without an interval there are at least so many levels, and at most twice as many.
_FEWEST = 10
_ROUND = (1.0, 2.0, 2.5, 5.0)

# Digits of the numbers of which levels are made: multiples of 0.1 are 0.3, not 0.30000000000000004.
_DIGITS = 60


@dataclass(frozen=True, eq=False)
class Levels:
    """The levels at which contours are traced.

    Parameters
    ----------
    values : float64 (L,)
        In rising order.
    is_index : bool (L,)
        Which of them are index contours.
    interval : float, optional
        None if the user has named the levels.
    base : float
    chosen : bool
        Whether the interval follows from the heights, because the user gave none.
    """

    values: Floats
    is_index: Mask
    interval: float | None
    base: float
    chosen: bool = False


def plan_levels(
    low: float,
    high: float,
    *,
    interval: float | None = None,
    base: float = 0.0,
    levels: Sequence[float] | None = None,
    index: int = 5,
) -> Levels:
    """Return the levels of contours of heights between `low` and `high`.

    A node on a level counts as above it, so there is no contour at `low` itself.

    Parameters
    ----------
    low, high : float
        Least and greatest height; NaN if there are no heights.
    interval : float, optional
        Levels are ``base + k * interval``. Default: a round number that gives 10 to 20 levels.
    base : float
    levels : sequence of float, optional
        The levels themselves, in rising order, instead of an interval.
    index : int
        Every `index`-th level is an index contour, counted from the base, or in `levels` from
        the first. 0: none.

    Raises
    ------
    LevelError
        If a value is not valid, or there would be more than `MOST_LEVELS` levels.
    """
    if index < 0:
        raise LevelError(f"`index` is {index}: give 5 for every fifth level, or 0 for none")
    if levels is not None:
        if interval is not None:
            raise LevelError("`levels` and `interval` were both given: choose one of them")
        return _named(levels, base, index)
    if not math.isfinite(base):
        raise LevelError(f"`base` is {base:g}: give a height, such as 0")
    if interval is not None and not (math.isfinite(interval) and interval > 0):
        raise LevelError(f"`interval` is {interval:g}: give a height above 0, such as 10")
    chosen = interval is None
    interval = round_interval(high - low) if interval is None else float(interval)
    if not low < high:  # flat, or NaN
        return Levels(np.empty(0), np.empty(0, np.bool_), interval, base, chosen)
    with localcontext(Context(prec=_DIGITS)):
        step, origin = Decimal(repr(interval)), Decimal(repr(float(base)))
        first, last = (
            int(((Decimal(repr(float(end))) - origin) / step).to_integral_value(ROUND_FLOOR))
            for end in (low, high)
        )
        first += 1
        if last - first >= MOST_LEVELS:
            count = min(last - first + 1, 10**300)
            raise LevelError(
                f"`interval` is {interval:g}, which gives {count:.6g} levels for heights from "
                f"{low:g} to {high:g}, and at most {MOST_LEVELS:,} are possible: try "
                f"{round_interval(high - low):g}"
            )
        ranks = range(first, last + 1)
        values = np.array([float(origin + rank * step) for rank in ranks], np.float64)
    multiples = np.array([index > 0 and rank % index == 0 for rank in ranks], np.bool_)
    return Levels(*_distinct(values, multiples), interval, base, chosen)


def round_interval(extent: float) -> float:
    """Return the round number (1, 2, 2.5 or 5 times a power of ten) that divides an extent well.

    It fits 10 to 20 times. It is 1 for an extent of 0 or NaN.
    """
    if not (math.isfinite(extent) and extent > 0):
        return 1.0
    with localcontext(Context(prec=_DIGITS)):
        most = Decimal(extent) / _FEWEST
        power = Decimal(10) ** most.adjusted()
        fitting = [Decimal(factor) * power for factor in _ROUND if Decimal(factor) * power <= most]
        return float(fitting[-1])


def _distinct(values: Floats, is_index: Mask) -> tuple[Floats, Mask]:
    """Return each level once: an interval may be too small for the digits of the heights."""
    kept = np.ones(len(values), np.bool_)
    kept[1:] = values[1:] != values[:-1]
    return values[kept], is_index[kept]


def _named(levels: Sequence[float], base: float, index: int) -> Levels:
    values = np.array(levels, np.float64).reshape(-1)
    if not len(values):
        raise LevelError("`levels` is empty: give heights such as 100,200,500")
    if len(values) > MOST_LEVELS:
        raise LevelError(f"`levels` has {len(values):,} heights: give at most {MOST_LEVELS:,}")
    for value in values[~np.isfinite(values)][:1]:
        raise LevelError(f"`levels` has {value:g}: give heights such as 100,200,500")
    steps = np.diff(values)
    for k in np.flatnonzero(steps <= 0)[:1]:
        if steps[k] == 0:
            raise LevelError(f"`levels` has {values[k]:g} twice: give each height once")
        raise LevelError(
            f"`levels` has {values[k]:g} before {values[k + 1]:g}: give them in rising order"
        )
    counted = np.arange(len(values)) % index == 0 if index else np.zeros(len(values), np.bool_)
    return Levels(values, counted, None, base)
