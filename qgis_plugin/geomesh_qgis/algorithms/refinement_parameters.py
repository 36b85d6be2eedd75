"""Parameters of the preset adaptive: the goal, how to reach it, and breaklines."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterNumber,
    QgsProcessingParameterString,
)

from .values import is_given

if TYPE_CHECKING:
    from collections.abc import Mapping

# The options of geomesh, and what the dialog calls them.
GOALS = {
    "--nodes": "number of nodes",
    "--max-error": "largest error",
    "--rmse": "root mean square error",
}
MODELS = {
    "linear": "linear: values at the nodes",
    "constant": "constant: one value for each triangle",
}
EFFORTS = {"fast": "fast", "normal": "normal", "best": "best"}

ADAPTIVE = "adaptive"

_LARGEST_FLOOR = 25

_GOAL = "Goal"
_ERROR = "Error to reach (raster units; one, or one for each band)"
_NODES = "Node budget"
_PERCENT = "Node budget (% of the valid pixels)"
_ANGLE = "Smallest angle (degrees)"
_MODEL = "Surface"
_EFFORT = "Effort"
_BREAKLINES = "Breaklines"
_CANNY = "Use edges of the image as breaklines (Canny)"
_KEEP = "Keep feature nodes where they are"
_LIMIT = "Time limit of the refinement (seconds)"

# What only the preset adaptive has.
_ONLY_ADAPTIVE = {
    "MIN_ANGLE": _ANGLE,
    "MODEL": _MODEL,
    "EFFORT": _EFFORT,
    "KEEP_FEATURES": _KEEP,
    "TIME_LIMIT": _LIMIT,
}

TIPS = {
    "NODES": (
        "adaptive: exactly so many nodes; with an error as the goal, at most so many. Other "
        "presets: keeps the strongest features, spread evenly. If not set: 1 % of the valid "
        "pixels for adaptive, or all features"
    ),
    "NODES_PERCENT": "The node budget as a share of the valid pixels, instead of a number",
    "GOAL": (
        "For the preset adaptive. Number of nodes: the best mesh of so many nodes. Largest error: "
        "no valid pixel is farther from the mesh than the error to reach. Root mean square error: "
        "the error to reach holds on average. Both use as few nodes as possible"
    ),
    "ERROR": (
        "For the goals largest error and root mean square error: one number for all bands, or "
        "one for each band with commas between them, such as 5,5,8. Decimals have a point"
    ),
    "MIN_ANGLE": (
        "For the preset adaptive: no triangle has a smaller angle. 0 to 25. If not set: 10"
    ),
    "MODEL": (
        "For the preset adaptive: what shows the raster best. Linear: a surface that is smooth in "
        "each triangle. Constant: one value for each triangle, as the layer triangles shows it. If "
        "not set: linear"
    ),
    "EFFORT": "For the preset adaptive: more time gives a better mesh. If not set: normal",
    "BREAKLINES": (
        "Lines or polygons, such as coasts and roads. They become edges of the mesh. Presets "
        "features and adaptive"
    ),
    "CANNY_BREAKLINES": "The long, strong edges of the image become edges of the mesh",
    "KEEP_FEATURES": (
        "For the preset adaptive: features of the image that are nodes at the start are not moved "
        "or removed"
    ),
    "TIME_LIMIT": (
        "For the preset adaptive: the refinement ends after this time, with the mesh as it is then"
    ),
}


def goal_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the parameters that say what the mesh should reach."""
    number, choice = QgsProcessingParameterNumber, QgsProcessingParameterEnum
    whole, real = number.Type.Integer, number.Type.Double
    return [
        choice("GOAL", _GOAL, list(GOALS.values()), False, 0),
        QgsProcessingParameterString("ERROR", _ERROR, None, False, True),
        number("NODES", _NODES, whole, None, True, 1),
        number("NODES_PERCENT", _PERCENT, real, None, True, 0, 100),
        number("MIN_ANGLE", _ANGLE, real, None, True, 0, _LARGEST_FLOOR),
        choice("MODEL", _MODEL, list(MODELS.values()), False, None, True),
        choice("EFFORT", _EFFORT, list(EFFORTS.values()), False, None, True),
    ]


def breakline_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the parameters of the lines that become edges of the mesh."""
    kinds = QgsProcessing.SourceType
    return [
        QgsProcessingParameterFeatureSource(
            "BREAKLINES", _BREAKLINES, [kinds.TypeVectorLine, kinds.TypeVectorPolygon], None, True
        ),
        QgsProcessingParameterBoolean("CANNY_BREAKLINES", _CANNY, False),
    ]


def advanced_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the advanced parameters of the preset adaptive."""
    real = QgsProcessingParameterNumber.Type.Double
    made = [
        QgsProcessingParameterBoolean("KEEP_FEATURES", _KEEP, False),
        QgsProcessingParameterNumber("TIME_LIMIT", _LIMIT, real, None, True, 0),
    ]
    for parameter in made:
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        parameter.setFlags(parameter.flags() | advanced)
    return made


def refinement_options(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> list[str]:
    """Return the geomesh options for the parameters that are set, without breaklines of a layer."""
    options: list[str] = []
    if is_given(parameters, "NODES", context):
        options += ["--nodes", str(algorithm.parameterAsInt(parameters, "NODES", context))]
    if is_given(parameters, "NODES_PERCENT", context):
        percent = algorithm.parameterAsDouble(parameters, "NODES_PERCENT", context)
        options += ["--nodes", f"{percent!r}%"]
    if _wants_error(algorithm, parameters, context):
        errors = _errors(algorithm, parameters, context)
        options += [_goal(algorithm, parameters, context), ",".join(map(repr, errors))]
    if is_given(parameters, "MIN_ANGLE", context):
        angle = algorithm.parameterAsDouble(parameters, "MIN_ANGLE", context)
        options += ["--min-angle", repr(angle)]
    for name, choices in (("MODEL", MODELS), ("EFFORT", EFFORTS)):
        if is_given(parameters, name, context):
            chosen = list(choices)[algorithm.parameterAsEnum(parameters, name, context)]
            options += [f"--{name.lower()}", chosen]
    if algorithm.parameterAsBool(parameters, "KEEP_FEATURES", context):
        options += ["--keep-features"]
    if is_given(parameters, "TIME_LIMIT", context):
        seconds = algorithm.parameterAsDouble(parameters, "TIME_LIMIT", context)
        options += ["--time-limit", repr(seconds)]
    if algorithm.parameterAsBool(parameters, "CANNY_BREAKLINES", context):
        options += ["--breaklines", "canny"]
    return options


def find_refinement_fault(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    presets: Mapping[str, str],
) -> str:
    """Return which values contradict each other or are not valid, or an empty text."""
    given = {name for name in parameters if is_given(parameters, name, context)}
    # A recipe file takes the place of the preset: geomesh itself finds what does not fit it.
    preset = list(presets)[algorithm.parameterAsEnum(parameters, "PRESET", context)]
    preset = "" if "RECIPE" in given else preset
    return (
        _find_budget_fault(algorithm, parameters, context, given)
        or _find_goal_fault(algorithm, parameters, context, given)
        or _find_preset_fault(algorithm, parameters, context, given, preset)
        or _find_breaklines_fault(algorithm, parameters, context, given, preset)
    )


def _find_budget_fault(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    given: set[str],
) -> str:
    if {"NODES", "NODES_PERCENT"} <= given:
        return f"{_NODES} is set twice, as a number and as a percentage: clear one of the two."
    for name, label in (("NODES_PERCENT", _PERCENT), ("TIME_LIMIT", _LIMIT)):
        if name in given:
            value = algorithm.parameterAsDouble(parameters, name, context)
            if not 0 < value < math.inf:
                return f"{label} is {value:g}: give a number above 0."
    if "MIN_ANGLE" in given:
        angle = algorithm.parameterAsDouble(parameters, "MIN_ANGLE", context)
        if not 0 <= angle <= _LARGEST_FLOOR:
            return f"{_ANGLE} is {angle:g}: give a number from 0 to {_LARGEST_FLOOR}."
    return ""


def _find_goal_fault(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    given: set[str],
) -> str:
    goal = GOALS[_goal(algorithm, parameters, context)]
    if not _wants_error(algorithm, parameters, context):
        if "ERROR" in given:
            return (
                f"{_ERROR} is set, but the goal is the {goal}: choose {GOALS['--max-error']} or "
                f"{GOALS['--rmse']} as the goal, or clear the error."
            )
        return ""
    if "ERROR" not in given:
        return f"The goal is the {goal}: also set {_ERROR}."
    try:
        errors = _errors(algorithm, parameters, context)
    except ValueError:
        text = algorithm.parameterAsString(parameters, "ERROR", context)
        return (
            f"{_ERROR} is {text!r}: give a number such as 2.5, or one for each band, as in 5,5,8."
        )
    if not all(0 < error < math.inf for error in errors):
        return f"{_ERROR} must be above 0 in each band. Write decimals with a point, as in 0.5."
    bands = algorithm.parameterAsInts(parameters, "BANDS", context)
    if bands and len(errors) not in (1, len(bands)):
        return (
            f"{_ERROR} has {len(errors)} numbers for {len(bands)} bands: give one, or one for each "
            "band."
        )
    return ""


def _find_preset_fault(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    given: set[str],
    preset: str,
) -> str:
    """Return which value needs another preset. `preset` is empty if a recipe file says it."""
    if preset == ADAPTIVE:
        if "RESIZE" in given:
            return "The preset adaptive cannot resize the raster: clear Resize, or choose features."
        if "DOMAIN" in given and algorithm.parameterAsEnum(parameters, "DOMAIN", context) == 2:
            return (
                "The preset adaptive covers the valid data or the whole image: choose one of them "
                "as the area to cover."
            )
        return ""
    if not preset:
        return ""
    if _wants_error(algorithm, parameters, context):
        goal = GOALS[_goal(algorithm, parameters, context)]
        return f"Only the preset adaptive can reach a {goal}: choose it, or another goal."
    for name, label in _ONLY_ADAPTIVE.items():
        if name == "KEEP_FEATURES":
            used = algorithm.parameterAsBool(parameters, name, context)
        else:
            used = name in given
        if used:
            return f"{label} is for the preset adaptive: choose that preset, or clear the value."
    return ""


def _find_breaklines_fault(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    given: set[str],
    preset: str,
) -> str:
    canny = algorithm.parameterAsBool(parameters, "CANNY_BREAKLINES", context)
    if not canny and "BREAKLINES" not in given:
        return ""
    if canny and "BREAKLINES" in given:
        return (
            "Breaklines are set twice, as a layer and as edges of the image: choose one of the two."
        )
    if (
        "BREAKLINES" in given
        and algorithm.parameterAsSource(parameters, "BREAKLINES", context) is None
    ):
        return "The layer of breaklines cannot be read: choose another one."
    hull = "DOMAIN" in given and algorithm.parameterAsEnum(parameters, "DOMAIN", context) == 2
    if preset == "paper" or hull or "RESIZE" in given:
        return (
            "Breaklines need a mesh that follows the pixels of the raster: choose the preset "
            "features or adaptive, without Resize or the convex hull."
        )
    return ""


def _goal(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> str:
    return list(GOALS)[algorithm.parameterAsEnum(parameters, "GOAL", context)]


def _wants_error(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> bool:
    return _goal(algorithm, parameters, context) != "--nodes"


def _errors(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> list[float]:
    """Return the errors to reach. Raises ValueError if the text is not a list of numbers."""
    value = parameters.get("ERROR")
    if isinstance(value, (list, tuple)):  # from a program
        return [float(each) for each in value]
    text = algorithm.parameterAsString(parameters, "ERROR", context)
    return [float(part) for part in re.split(r"\s*[,;]\s*|\s+", text.strip())]
