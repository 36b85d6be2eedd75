"""Values of parameters: whether they are given at all, and whether numbers are numbers."""

from __future__ import annotations

from typing import Any

from qgis.core import NULL, QgsProcessingAlgorithm, QgsProcessingContext, QgsProperty


def is_given(parameters: dict[str, Any], name: str, context: QgsProcessingContext) -> bool:
    """Tell whether a parameter has a value; an expression may give none."""
    value = parameters.get(name)
    if isinstance(value, QgsProperty):
        value, _ = value.value(context.expressionContext(), None)
    return value is not None and value != NULL and value not in ("", [])


def find_number_fault(algorithm: QgsProcessingAlgorithm, parameters: dict[str, Any]) -> str:
    """Return which number is a text of something else, for QGIS would take it for 0."""
    for definition in algorithm.parameterDefinitions():
        value = parameters.get(definition.name())
        if definition.type() == "number" and isinstance(value, str) and value.strip():
            try:
                float(value)
            except ValueError:
                return f"{definition.description()} is {value!r}: give a number."
    return ""
