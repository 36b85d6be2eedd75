"""The factory with which QGIS creates the page Settings > Options > geomesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from qgis.gui import QgsOptionsPageWidget, QgsOptionsWidgetFactory
from qgis.PyQt.QtGui import QIcon

from .page import OptionsPage

if TYPE_CHECKING:
    from qgis.PyQt.QtWidgets import QWidget

_ICON = Path(__file__).parent.parent / "icon.svg"


class OptionsFactory(QgsOptionsWidgetFactory):
    """Creates the page each time the options dialog is opened."""

    def __init__(self) -> None:
        super().__init__("geomesh", QIcon(str(_ICON)))

    def createWidget(self, parent: QWidget | None) -> QgsOptionsPageWidget:
        """Create the page."""
        return OptionsPage(parent)
