"""The menu geomesh in the Raster menu: an entry for each algorithm, which opens its dialog."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Callable

from qgis.core import QgsMapLayer, QgsRasterLayer
from qgis.PyQt.QtGui import QIcon
from qgis.PyQt.QtWidgets import QAction, QWidget

from .algorithms.base import RasterAlgorithm
from .algorithms.raster_to_mesh import RasterToMesh
from .meshes import find_mesh
from .provider import ALGORITHMS, ICON

if TYPE_CHECKING:
    from .algorithms.base import GeomeshAlgorithm


def more_actions(parent: QWidget, open_dialog: Callable[[str], None]) -> list[QAction]:
    """Return the actions of all algorithms but Raster to mesh, whose action is the button's.

    Parameters
    ----------
    parent : QWidget
        Owner of the actions.
    open_dialog : callable(name)
        Opens the dialog of an algorithm.
    """
    actions = []
    group = RasterToMesh.GROUP
    for algorithm in ALGORITHMS:
        if algorithm is RasterToMesh:
            continue
        if group != algorithm.GROUP:
            group = algorithm.GROUP
            line = QAction(parent)
            line.setSeparator(True)
            actions.append(line)
        action = QAction(QIcon(str(ICON)), f"{algorithm.TITLE}…", parent)
        action.setObjectName(f"geomesh_{algorithm.NAME}")
        action.triggered.connect(partial(open_dialog, algorithm.NAME))
        actions.append(action)
    return actions


def first_values(name: str, layer: QgsMapLayer | None) -> dict[str, str]:
    """Return the values with which a dialog opens: the layer, if it can be the input."""
    algorithm = next(each for each in ALGORITHMS if name == each.NAME)
    return {"INPUT": layer.id()} if layer is not None and _fits(algorithm, layer) else {}


def _fits(algorithm: type[GeomeshAlgorithm], layer: QgsMapLayer) -> bool:
    if issubclass(algorithm, RasterAlgorithm):
        return isinstance(layer, QgsRasterLayer)
    return bool(find_mesh(layer))
