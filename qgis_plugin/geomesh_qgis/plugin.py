"""The plugin: its provider, its button, its menu and its options page."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from qgis.core import Qgis, QgsApplication, QgsMapLayer, QgsRasterLayer
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtWidgets import QAction, QPushButton

from . import settings
from .algorithms.raster_to_mesh import RasterToMesh
from .engine.environment import EnvironmentProblem
from .menu import first_values, more_actions
from .options.factory import OptionsFactory
from .provider import ICON, GeomeshProvider

if TYPE_CHECKING:
    from qgis.gui import QgisInterface

MENU = "&geomesh"


class GeomeshPlugin:
    """The class that QGIS loads. Without a desktop, it calls only `initProcessing`."""

    def __init__(self, iface: QgisInterface | None) -> None:
        self._iface = iface
        self._provider: GeomeshProvider | None = None
        self._options: OptionsFactory | None = None
        self._action: QAction | None = None
        self._menu: list[QAction] = []

    def initProcessing(self) -> None:
        """Add the algorithms to Processing."""
        # Do not register a second provider: this would delete the first one.
        if QgsApplication.processingRegistry().providerById(GeomeshProvider.ID) is None:
            self._provider = GeomeshProvider()
            QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self) -> None:
        """Add the toolbar button, the menu in the Raster menu and the options page."""
        self.initProcessing()
        self._options = OptionsFactory()
        self._iface.registerOptionsWidgetFactory(self._options)
        action = QAction(QIcon(str(ICON)), "Raster to mesh…", self._iface.mainWindow())
        action.setObjectName("geomeshRasterToMesh")
        action.setToolTip(
            "<b>Raster to mesh</b><br>Turn the raster that is selected in the layer panel into a "
            "triangle mesh"
        )
        action.triggered.connect(partial(self._open_dialog, RasterToMesh.NAME))
        self._action = action
        self._iface.addToolBarIcon(action)
        self._menu = [action, *more_actions(self._iface.mainWindow(), self._open_dialog)]
        for each in self._menu:
            self._iface.addPluginToRasterMenu(MENU, each)
        self._iface.currentLayerChanged.connect(self._enable_action)
        self._enable_action(self._iface.activeLayer())

    def unload(self) -> None:
        """Remove everything that the plugin added."""
        if self._action is not None:
            self._iface.currentLayerChanged.disconnect(self._enable_action)
            self._iface.removeToolBarIcon(self._action)
            for each in self._menu:
                self._iface.removePluginRasterMenu(MENU, each)
                each.deleteLater()
            self._action, self._menu = None, []
        if self._options is not None:
            self._iface.unregisterOptionsWidgetFactory(self._options)
            self._options = None
        if self._provider is not None:
            QgsApplication.processingRegistry().removeProvider(self._provider)
            self._provider = None

    def _enable_action(self, layer: QgsMapLayer | None) -> None:
        self._action.setEnabled(isinstance(layer, QgsRasterLayer) and layer.isValid())

    def _open_dialog(self, name: str, *_: object) -> None:
        """Open the dialog of an algorithm, with the active layer as its input."""
        import processing

        try:
            settings.installation()
        except EnvironmentProblem as problem:
            self._offer_options(str(problem))
            return
        values = first_values(name, self._iface.activeLayer())
        processing.execAlgorithmDialog(f"{GeomeshProvider.ID}:{name}", values)

    def _offer_options(self, reason: str) -> None:
        """Say why no mesh can be made yet, with a button that opens the options page."""
        bar = self._iface.messageBar()
        item = bar.createMessage("geomesh", reason)
        button = QPushButton("Open the options…")
        button.setObjectName("geomeshOpenOptions")
        button.clicked.connect(bar.popWidget)
        button.clicked.connect(
            lambda: self._iface.showOptionsDialog(self._iface.mainWindow(), settings.PAGE)
        )
        item.layout().addWidget(button)
        bar.pushWidget(item, Qgis.MessageLevel.Warning)
