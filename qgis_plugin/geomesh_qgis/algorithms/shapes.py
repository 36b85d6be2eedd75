"""Areas and breaklines of layers, as options of geomesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..inputs import export_breaklines, export_shapes
from .values import is_given

if TYPE_CHECKING:
    from pathlib import Path

    from qgis.core import (
        QgsProcessingAlgorithm,
        QgsProcessingContext,
        QgsProcessingFeedback,
    )


def find_breaklines_fault(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> str:
    """Return why the layer BREAKLINES cannot be used, or an empty text."""
    if not is_given(parameters, "BREAKLINES", context):
        return ""
    if algorithm.parameterAsSource(parameters, "BREAKLINES", context) is not None:
        return ""
    return "The layer of breaklines cannot be read: choose another one."


def shape_options(
    algorithm: QgsProcessingAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    folder: Path,
    feedback: QgsProcessingFeedback,
    *,
    area: str,
) -> list[str]:
    """Return the options for BREAKLINES and for an area. Their layers are exported to `folder`.

    Parameters
    ----------
    area : str
        Name of the parameter that has the polygons.
    """
    options: list[str] = []
    mask = algorithm.parameterAsSource(parameters, area, context)
    if mask is not None:
        options += ["--mask", export_shapes(mask, folder / "mask.gpkg", feedback)]
    lines = algorithm.parameterAsSource(parameters, "BREAKLINES", context)
    if lines is not None:
        options += ["--breaklines", export_breaklines(lines, folder, feedback)]
    return options
