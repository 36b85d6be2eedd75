"""A limit on the time that a long step may take."""

from __future__ import annotations

import math
from time import monotonic
from typing import TYPE_CHECKING

from geomesh.errors import RecipeError

if TYPE_CHECKING:
    from collections.abc import Callable


def never() -> bool:
    """Return False: there is no limit."""
    return False


def deadline(seconds: float | None) -> Callable[[], bool]:
    """Return a function that says whether so many seconds have passed since now.

    Parameters
    ----------
    seconds : float, optional
        None: there is no limit.

    Raises
    ------
    RecipeError
        If `seconds` is not a positive number.
    """
    if seconds is None:
        return never
    if not (isinstance(seconds, int | float) and 0 < seconds < math.inf):
        raise RecipeError(f"time_limit is {seconds!r}: expected a number of seconds above 0")
    end = monotonic() + seconds
    return lambda: monotonic() > end
