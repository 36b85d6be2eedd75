"""Values of the preset adaptive, and breaklines, that contradict each other or are not valid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .refinement_parameters import GOALS, LABELS, LARGEST_FLOOR

if TYPE_CHECKING:
    from .refinement_parameters import Wanted

_ERROR = LABELS["ERROR"]


@dataclass(frozen=True)
class Around:
    """Other parameters that what is wanted has to fit.

    Parameters
    ----------
    preset : str
        Empty if a recipe file takes its place. Then geomesh itself finds what does not fit.
    bands : int
        Number of bands that the user chose; 0 for none.
    is_resized, is_hull : bool
        Whether the raster is resized, and whether the convex hull is to be covered.
    has_breaklines : bool
        Whether there is a layer of breaklines.
    """

    preset: str
    bands: int
    is_resized: bool
    is_hull: bool
    has_breaklines: bool


def find_refinement_fault(wanted: Wanted, around: Around) -> str:
    """Return what is wrong, in one line, or an empty text."""
    return (
        _find_number_fault(wanted)
        or _find_goal_fault(wanted, around)
        or _find_preset_fault(wanted, around)
        or _find_breaklines_fault(wanted, around)
    )


def _find_number_fault(wanted: Wanted) -> str:
    if wanted.nodes is not None and wanted.percent is not None:
        return "Node budget is set twice, as a number and as a percentage: clear one of the two."
    for name, value in (("NODES_PERCENT", wanted.percent), ("TIME_LIMIT", wanted.seconds)):
        if value is not None and not 0 < value < math.inf:
            return f"{LABELS[name]} is {value:g}: give a number above 0."
    angle = wanted.min_angle
    if angle is not None and not 0 <= angle <= LARGEST_FLOOR:
        return f"{LABELS['MIN_ANGLE']} is {angle:g}: give a number from 0 to {LARGEST_FLOOR}."
    return ""


def _find_goal_fault(wanted: Wanted, around: Around) -> str:
    goal = GOALS[wanted.goal]
    if not wanted.is_error:
        if wanted.error is None:
            return ""
        return (
            f"{_ERROR} is set, but the goal is the {goal}: choose {GOALS['--max-error']} or "
            f"{GOALS['--rmse']} as the goal, or clear the error."
        )
    if wanted.error is None:
        return f"The goal is the {goal}: also set {_ERROR}."
    try:
        errors = wanted.errors
    except ValueError:
        return (
            f"{_ERROR} is {wanted.error!r}: give a number such as 2.5, or one for each band, as in "
            "5,5,8."
        )
    if not all(0 < error < math.inf for error in errors):
        return f"{_ERROR} must be above 0 in each band. Write decimals with a point, as in 0.5."
    if around.bands and len(errors) not in (1, around.bands):
        return (
            f"{_ERROR} has {len(errors)} numbers for {around.bands} bands: give one, or one for "
            "each band."
        )
    return ""


def _find_preset_fault(wanted: Wanted, around: Around) -> str:
    if around.preset == "adaptive":
        if around.is_resized:
            return "The preset adaptive cannot resize the raster: clear Resize, or choose features."
        if around.is_hull:
            return (
                "The preset adaptive covers the valid data or the whole image: choose one of them "
                "as the area to cover."
            )
        return ""
    if not around.preset:
        return ""
    if wanted.is_error:
        goal = GOALS[wanted.goal]
        return f"Only the preset adaptive can reach a {goal}: choose it, or another goal."
    for name, is_set in (
        ("MIN_ANGLE", wanted.min_angle is not None),
        ("MODEL", wanted.model is not None),
        ("EFFORT", wanted.effort is not None),
        ("KEEP_FEATURES", wanted.keep_features),
        ("TIME_LIMIT", wanted.seconds is not None),
    ):
        if is_set:
            return f"{LABELS[name]} is for the preset adaptive: choose it, or clear the value."
    return ""


def _find_breaklines_fault(wanted: Wanted, around: Around) -> str:
    if not wanted.canny and not around.has_breaklines:
        return ""
    if wanted.canny and around.has_breaklines:
        return (
            "Breaklines are set twice, as a layer and as edges of the image: choose one of the two."
        )
    if around.preset == "paper" or around.is_hull or around.is_resized:
        return (
            "Breaklines need a mesh that follows the pixels of the raster: choose the preset "
            "features or adaptive, without Resize or the convex hull."
        )
    return ""
