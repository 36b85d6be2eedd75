"""Parameters of the preset adaptive: the goal, how to reach it, and breaklines."""

from __future__ import annotations

import re
from dataclasses import dataclass

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

LARGEST_FLOOR = 25

# Names in the dialog. Messages use them too.
LABELS = {
    "GOAL": "Goal",
    "ERROR": "Error to reach (raster units; one, or one for each band)",
    "NODES": "Node budget",
    "NODES_PERCENT": "Node budget (% of the valid pixels)",
    "MIN_ANGLE": "Smallest angle (degrees)",
    "MODEL": "Surface",
    "EFFORT": "Effort",
    "BREAKLINES": "Breaklines",
    "CANNY_BREAKLINES": "Use edges of the image as breaklines (Canny)",
    "KEEP_FEATURES": "Keep feature nodes where they are",
    "TIME_LIMIT": "Time limit of the refinement (seconds)",
}

TIPS = {
    "NODES": (
        "adaptive: exactly so many nodes; with an error as the goal, at most so many. If not set: "
        "1 % of the valid pixels, at least twice the nodes of outline and breaklines. Other "
        "presets: keeps the strongest features, spread evenly. If not set: all features"
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
        choice("GOAL", LABELS["GOAL"], list(GOALS.values()), False, 0),
        number("NODES", LABELS["NODES"], whole, None, True, 1),
        number("NODES_PERCENT", LABELS["NODES_PERCENT"], real, None, True, 0, 100),
        QgsProcessingParameterString("ERROR", LABELS["ERROR"], None, False, True),
        number("MIN_ANGLE", LABELS["MIN_ANGLE"], real, None, True, 0, LARGEST_FLOOR),
        choice("MODEL", LABELS["MODEL"], list(MODELS.values()), False, None, True),
        choice("EFFORT", LABELS["EFFORT"], list(EFFORTS.values()), False, None, True),
    ]


def breakline_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the parameters of the lines that become edges of the mesh."""
    return [
        breaklines_layer(),
        QgsProcessingParameterBoolean("CANNY_BREAKLINES", LABELS["CANNY_BREAKLINES"], False),
    ]


def breaklines_layer() -> QgsProcessingParameterDefinition:
    """Return the parameter of a layer of breaklines."""
    kinds = QgsProcessing.SourceType
    types = [kinds.TypeVectorLine, kinds.TypeVectorPolygon]
    return QgsProcessingParameterFeatureSource(
        "BREAKLINES", LABELS["BREAKLINES"], types, None, True
    )


def advanced_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the advanced parameters of the preset adaptive."""
    real = QgsProcessingParameterNumber.Type.Double
    made = [
        QgsProcessingParameterBoolean("KEEP_FEATURES", LABELS["KEEP_FEATURES"], False),
        QgsProcessingParameterNumber("TIME_LIMIT", LABELS["TIME_LIMIT"], real, None, True, 0),
    ]
    for parameter in made:
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        parameter.setFlags(parameter.flags() | advanced)
    return made


@dataclass(frozen=True)
class Wanted:
    """The values of the parameters. None: not set.

    Parameters
    ----------
    goal : str
        A key of `GOALS`.
    error : str or None
        What the user wrote: a number, or one for each band.
    nodes : int or None
    percent : float or None
        Share of the valid pixels, instead of `nodes`.
    min_angle : float or None
        In degrees.
    model, effort : str or None
        Keys of `MODELS` and `EFFORTS`.
    keep_features : bool
    seconds : float or None
        Limit of time.
    canny : bool
        Whether edges of the image become breaklines.
    """

    goal: str
    error: str | None
    nodes: int | None
    percent: float | None
    min_angle: float | None
    model: str | None
    effort: str | None
    keep_features: bool
    seconds: float | None
    canny: bool

    @property
    def is_error(self) -> bool:
        """Whether the goal is an error."""
        return self.goal != "--nodes"

    @property
    def errors(self) -> list[float]:
        """The errors to reach. Raises ValueError if the text is not a list of numbers."""
        return [float(part) for part in re.split(r"\s*[,;]\s*|\s+", (self.error or "").strip())]


def read_wanted(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> Wanted:
    """Return the values of the parameters."""

    def number(name: str) -> float | None:
        if not is_given(parameters, name, context):
            return None
        return algorithm.parameterAsDouble(parameters, name, context)

    def choice(name: str, choices: dict[str, str]) -> str | None:
        if not is_given(parameters, name, context):
            return None
        return list(choices)[algorithm.parameterAsEnum(parameters, name, context)]

    error = None
    if is_given(parameters, "ERROR", context):
        value = parameters["ERROR"]
        if isinstance(value, (list, tuple)):  # from a program
            error = ",".join(map(str, value))
        else:
            error = algorithm.parameterAsString(parameters, "ERROR", context)
    nodes = number("NODES")
    return Wanted(
        goal=list(GOALS)[algorithm.parameterAsEnum(parameters, "GOAL", context)],
        error=error,
        nodes=None if nodes is None else algorithm.parameterAsInt(parameters, "NODES", context),
        percent=number("NODES_PERCENT"),
        min_angle=number("MIN_ANGLE"),
        model=choice("MODEL", MODELS),
        effort=choice("EFFORT", EFFORTS),
        keep_features=algorithm.parameterAsBool(parameters, "KEEP_FEATURES", context),
        seconds=number("TIME_LIMIT"),
        canny=algorithm.parameterAsBool(parameters, "CANNY_BREAKLINES", context),
    )


def refinement_options(wanted: Wanted) -> list[str]:
    """Return the geomesh options for the values that are set, without breaklines of a layer."""
    options: list[str] = []
    if wanted.nodes is not None:
        options += ["--nodes", str(wanted.nodes)]
    if wanted.percent is not None:
        options += ["--nodes", f"{wanted.percent!r}%"]
    if wanted.is_error:
        options += [wanted.goal, ",".join(map(repr, wanted.errors))]
    if wanted.min_angle is not None:
        options += ["--min-angle", repr(wanted.min_angle)]
    if wanted.model is not None:
        options += ["--model", wanted.model]
    if wanted.effort is not None:
        options += ["--effort", wanted.effort]
    if wanted.keep_features:
        options += ["--keep-features"]
    if wanted.seconds is not None:
        options += ["--time-limit", repr(wanted.seconds)]
    if wanted.canny:
        options += ["--breaklines", "canny"]
    return options
