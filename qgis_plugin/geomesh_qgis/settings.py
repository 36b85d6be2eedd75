"""What the plugin keeps in the user's settings."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsApplication, QgsSettings

from .engine.environment import Installation, find

# The name by which QGIS opens the page.
PAGE = "geomeshOptions"

_PYTHON = "geomesh/python"


def python_setting() -> str:
    """Return the environment that the user chose; "" if none."""
    return str(QgsSettings().value(_PYTHON, "", type=str))


def set_python_setting(place: str) -> None:
    """Keep the environment that the user chose; "" for none."""
    if place.strip():
        QgsSettings().setValue(_PYTHON, place.strip())
    else:
        QgsSettings().remove(_PYTHON)


def managed_folder() -> Path:
    """Return the folder of the plugin's own environment, one for each profile of the user."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "geomesh" / "environment"


def installation() -> Installation:
    """Return the geomesh to run.

    Raises
    ------
    EnvironmentProblem
        If there is none that works.
    """
    return find(python_setting(), managed_folder())
