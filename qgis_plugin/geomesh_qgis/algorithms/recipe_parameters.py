"""The recipe parameters as advanced parameters. If one is not set, the preset's value is used."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any

from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFile,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRange,
    QgsProcessingParameterString,
)

from .values import is_given

_GRAY = re.compile(r"auto|luma|mean|pca|band:[1-9]\d*")
_SIZE = re.compile(r"\s*([1-9]\d*)\s*[,x×]\s*([1-9]\d*)\s*")


@dataclass(frozen=True)
class Setting:
    """A parameter of a recipe.

    Parameters
    ----------
    name : str
        Name of the field of geomesh's Recipe. In capitals, it is the name of the Processing
        parameter.
    label : str
        Text in the dialog, with the unit.
    kind : {"whole", "real", "range", "choice", "flag", "some", "gray", "size"}
    low : float, optional
        Minimum value.
    choices : tuple of str
        Possible values.
    """

    name: str
    label: str
    kind: str
    low: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def parameter(self) -> str:
        """Name of the Processing parameter."""
        return self.name.upper()


SETTINGS = (
    Setting("gray", "Gray image: luma, mean, pca or band:N", "gray"),
    Setting("stretch", "Stretch between percentiles", "range"),
    Setting("stretch_gray", "Stretch the gray image instead of each band", "flag"),
    Setting("sobel", "Use the Sobel magnitude instead of the gray image", "flag"),
    Setting("resize", "Resize to width, height (pixels)", "size"),
    Setting("canny_low", "Canny: low threshold (gray levels)", "real", 0),
    Setting("canny_high", "Canny: high threshold (gray levels)", "real", 0),
    Setting("canny_l2", "Canny: L2 norm of the gradient", "flag"),
    Setting("sift_source", "SIFT: image to search", "choice", choices=("gray", "edges")),
    Setting("sift_upsample", "SIFT: double the image first", "flag"),
    Setting("sift_contrast_threshold", "SIFT: contrast threshold", "real", 0),
    Setting("sift_edge_threshold", "SIFT: edge threshold", "real", 0),
    Setting("sift_sigma", "SIFT: blur of the first octave (pixels)", "real", 0),
    Setting("sift_octave_layers", "SIFT: layers in each octave", "whole", 1),
    Setting("sift_max_octave", "SIFT: highest octave (-1: the doubled image)", "whole", -1),
    Setting("edge_distance", "Maximum distance of nodes from an edge (pixels)", "real", 0),
    Setting("border_spacing", "Minimum distance between border nodes (pixels)", "real", 0),
    Setting("min_hole", "Smallest hole or island to keep (pixels)", "whole", 0),
    Setting(
        "statistics",
        "Statistics of each band",
        "some",
        choices=("mean", "std", "min", "max", "median", "majority", "variety"),
    ),
)


def recipe_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return the advanced parameters."""
    made = [_define(setting) for setting in SETTINGS]
    made.append(
        QgsProcessingParameterFile(
            "RECIPE",
            "Recipe file (used instead of the preset)",
            QgsProcessingParameterFile.Behavior.File,
            "",
            None,
            True,
            "Recipes (*.json);;All files (*)",
        )
    )
    for parameter in made:
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        parameter.setFlags(parameter.flags() | advanced)
    return made


def recipe_options(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> list[str]:
    """Return the geomesh options for the parameters that are set."""
    options: list[str] = []
    recipe = algorithm.parameterAsFile(parameters, "RECIPE", context)
    if recipe:
        options += ["--recipe", recipe]
    for setting in SETTINGS:
        value = _value(setting, algorithm, parameters, context)
        if value is not None:
            options += ["--set", f"{setting.name}={json.dumps(value)}"]
    return options


def find_recipe_fault(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> str:
    """Return which value is not valid, and why, or an empty text."""
    gray = algorithm.parameterAsString(parameters, "GRAY", context)
    if gray and not _GRAY.fullmatch(gray):
        return f"Gray image is {gray!r}: choose luma, mean, pca or band:N, such as band:4."
    size = algorithm.parameterAsString(parameters, "RESIZE", context)
    if size and not _SIZE.fullmatch(size):
        return f"Resize is {size!r}: give width and height, such as 512, 512."
    stretch = _stretch(algorithm, parameters, context)
    if stretch is not None and not (len(stretch) == 2 and 0 <= stretch[0] < stretch[1] <= 100):
        return (
            "Stretch between percentiles: give two rising numbers from 0 to 100, such as 2 and 98."
        )
    low, high = (
        algorithm.parameterAsDouble(parameters, name, context)
        if is_given(parameters, name, context)
        else None
        for name in ("CANNY_LOW", "CANNY_HIGH")
    )
    if low is not None and high is not None and low > high:
        return f"Canny's low threshold ({low:g}) is above the high one ({high:g}): exchange them."
    return ""


def _define(setting: Setting) -> QgsProcessingParameterDefinition:
    name, label = setting.parameter, setting.label
    if setting.kind in ("whole", "real"):
        number = QgsProcessingParameterNumber
        kind = number.Type.Integer if setting.kind == "whole" else number.Type.Double
        return number(name, label, kind, None, True, setting.low)
    if setting.kind == "range":
        kind = QgsProcessingParameterNumber.Type.Double
        return QgsProcessingParameterRange(name, label, kind, None, True)
    if setting.kind == "flag":
        return QgsProcessingParameterEnum(name, label, ["no", "yes"], False, None, True)
    if setting.kind in ("choice", "some"):
        several = setting.kind == "some"
        return QgsProcessingParameterEnum(name, label, list(setting.choices), several, None, True)
    return QgsProcessingParameterString(name, label, None, False, True)


def _value(
    setting: Setting,
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
) -> Any:
    """Return the value of a parameter in the form of a recipe, or None if it is not set."""
    given = (parameters, setting.parameter, context)
    if not is_given(parameters, setting.parameter, context):
        return None
    if setting.kind == "whole":
        return algorithm.parameterAsInt(*given)
    if setting.kind == "real":
        return algorithm.parameterAsDouble(*given)
    if setting.kind == "range":
        return _stretch(algorithm, parameters, context)
    if setting.kind == "flag":
        return bool(algorithm.parameterAsEnum(*given))
    if setting.kind == "choice":
        return setting.choices[algorithm.parameterAsEnum(*given)]
    if setting.kind == "some":
        return [setting.choices[index] for index in algorithm.parameterAsEnums(*given)]
    text = algorithm.parameterAsString(*given)
    if setting.kind == "size":
        return [int(number) for number in _SIZE.fullmatch(text).groups()]
    return text


def _stretch(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> list[float] | None:
    """Return the two percentiles. In the dialog, NaN means that a value is not set."""
    if not is_given(parameters, "STRETCH", context):
        return None
    limits = algorithm.parameterAsRange(parameters, "STRETCH", context)
    return None if limits and all(map(math.isnan, limits)) else limits
