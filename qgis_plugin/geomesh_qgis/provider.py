"""The Processing provider "geomesh"."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .algorithms.contours import Contours
from .algorithms.dem_to_tin import DemToTin
from .algorithms.export_tin import ExportTin
from .algorithms.mesh_quality import MeshQuality
from .algorithms.raster_to_mesh import RasterToMesh
from .algorithms.stages import Stages
from .algorithms.volume import Volume

ICON = Path(__file__).parent / "icon.svg"


# In the order of the menu.
ALGORITHMS = (RasterToMesh, DemToTin, Contours, Volume, ExportTin, MeshQuality, Stages)


class GeomeshProvider(QgsProcessingProvider):
    """Makes geomesh's algorithms available to the toolbox, models, batches and qgis_process."""

    ID = "geomesh"

    def loadAlgorithms(self) -> None:
        """Add the algorithms."""
        for algorithm in ALGORITHMS:
            self.addAlgorithm(algorithm())

    def id(self) -> str:
        """Return the provider part of the algorithms' identifiers, before the colon."""
        return self.ID

    def name(self) -> str:
        """Return the name in the toolbox."""
        return "geomesh"

    def longName(self) -> str:
        """Return the longer name."""
        return "geomesh: rasters to triangle meshes"

    def icon(self) -> QIcon:
        """Return the icon."""
        return QIcon(str(ICON))

    def svgIconPath(self) -> str:
        """Return the path of the icon as a vector file."""
        return str(ICON)

    def defaultVectorFileExtension(self, hasGeometry: bool = True) -> str:
        """Return the format of temporary outputs: only a GeoPackage can hold a whole mesh."""
        return "gpkg"

    def supportedOutputVectorLayerExtensions(self) -> list[str]:
        """Return the formats that geomesh writes and QGIS reads."""
        return ["gpkg", "geojson", "fgb"]

    def supportsNonFileBasedOutput(self) -> bool:
        """Return False, because outputs are files, not tables of a database."""
        return False
