"""The settings of the plugin, saved in the user's profile."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsApplication, QgsSettings

from .engine.environment import Installation, find

# The name with which QGIS opens the options page.
PAGE = "geomeshOptions"

_PYTHON = "geomesh/python"


def python_setting() -> str:
    """Return the environment that the user chose, or "" if none."""
    return str(QgsSettings().value(_PYTHON, "", type=str))


def set_python_setting(place: str) -> None:
    """Save the environment that the user chose, or "" for none."""
    if place.strip():
        QgsSettings().setValue(_PYTHON, place.strip())
    else:
        QgsSettings().remove(_PYTHON)


def managed_folder() -> Path:
    """Return the folder of the plugin's own environment. Each user profile has its own."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "geomesh" / "environment"


def installation() -> Installation:
    """Return the geomesh to run.

    Raises
    ------
    EnvironmentProblem
        If no geomesh works.
    """
    return find(python_setting(), managed_folder())
