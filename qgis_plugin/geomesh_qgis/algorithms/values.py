"""Checks of parameter values: whether a parameter is set, and whether a number is a number."""

from __future__ import annotations

from typing import Any

from qgis.core import NULL, QgsProcessingAlgorithm, QgsProcessingContext, QgsProperty


def is_given(parameters: dict[str, Any], name: str, context: QgsProcessingContext) -> bool:
    """Return whether a parameter has a value. An expression can give no value."""
    value = parameters.get(name)
    if isinstance(value, QgsProperty):
        value, _ = value.value(context.expressionContext(), None)
    return value is not None and value != NULL and value not in ("", [])


def find_number_fault(algorithm: QgsProcessingAlgorithm, parameters: dict[str, Any]) -> str:
    """Return which number is a text that is not a number. QGIS would use 0 for such a text."""
    for definition in algorithm.parameterDefinitions():
        value = parameters.get(definition.name())
        if definition.type() == "number" and isinstance(value, str) and value.strip():
            try:
                float(value)
            except ValueError:
                return f"{definition.description()} is {value!r}: give a number."
    return ""
