"""What the plugin keeps in the user's settings, and its page in Settings > Options."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsApplication, QgsSettings
from qgis.gui import QgsOptionsPageWidget, QgsOptionsWidgetFactory
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtWidgets import QWidget

from .engine.environment import Installation, find

# The name by which QGIS opens the page.
PAGE = "geomeshOptions"

_PYTHON = "geomesh/python"

_ICON = Path(__file__).parent / "icon.svg"


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


class OptionsFactory(QgsOptionsWidgetFactory):
    """Makes the page whenever the options are opened."""

    def __init__(self) -> None:
        super().__init__("geomesh", QIcon(str(_ICON)))

    def createWidget(self, parent: QWidget | None) -> QgsOptionsPageWidget:
        """Make the page."""
        from .options.page import OptionsPage

        return OptionsPage(parent)
