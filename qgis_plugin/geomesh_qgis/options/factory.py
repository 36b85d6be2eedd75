"""What QGIS asks for the page Settings > Options > geomesh."""

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
    """Makes the page whenever the options are opened."""

    def __init__(self) -> None:
        super().__init__("geomesh", QIcon(str(_ICON)))

    def createWidget(self, parent: QWidget | None) -> QgsOptionsPageWidget:
        """Make the page."""
        return OptionsPage(parent)
