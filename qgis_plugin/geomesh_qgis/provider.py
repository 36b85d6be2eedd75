"""The Processing provider "geomesh"."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .algorithms.mesh_quality import MeshQuality
from .algorithms.raster_to_mesh import RasterToMesh
from .algorithms.stages import Stages

ICON = Path(__file__).parent / "icon.svg"


class GeomeshProvider(QgsProcessingProvider):
    """Offers geomesh's algorithms to the toolbox, to models, batches and qgis_process."""

    ID = "geomesh"

    def loadAlgorithms(self) -> None:
        """Add the algorithms."""
        for algorithm in (RasterToMesh, MeshQuality, Stages):
            self.addAlgorithm(algorithm())

    def id(self) -> str:
        """Return the part of algorithms' names before the colon."""
        return self.ID

    def name(self) -> str:
        """Return what the toolbox shows."""
        return "geomesh"

    def longName(self) -> str:
        """Return what it is in a few words."""
        return "geomesh: rasters to triangle meshes"

    def icon(self) -> QIcon:
        """Return the picture beside the name."""
        return QIcon(str(ICON))

    def svgIconPath(self) -> str:
        """Return the picture as a vector file."""
        return str(ICON)

    def defaultVectorFileExtension(self, hasGeometry: bool = True) -> str:
        """Return what temporary outputs are: only a GeoPackage holds a whole mesh."""
        return "gpkg"

    def supportedOutputVectorLayerExtensions(self) -> list[str]:
        """Return what geomesh writes and QGIS reads."""
        return ["gpkg", "geojson", "fgb"]

    def supportsNonFileBasedOutput(self) -> bool:
        """Tell that outputs are files, not tables of a database."""
        return False
