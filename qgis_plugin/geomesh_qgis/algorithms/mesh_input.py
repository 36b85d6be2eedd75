"""Algorithms that read a mesh of geomesh, from any layer that shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingParameterMapLayer,
    QgsProcessingParameterString,
)

from ..meshes import find_mesh, find_mesh_fault, name_of_mesh
from .base import GeomeshAlgorithm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from qgis.core import QgsProcessingParameterDefinition

_HELP = "The TIN, or a layer of a GeoPackage that geomesh has written"


def mesh_parameter(
    name: str, label: str, *, rasters: bool = False, optional: bool = False
) -> QgsProcessingParameterMapLayer:
    """Return a parameter for a layer that shows a mesh, or for a raster if that is possible."""
    kinds = QgsProcessing.SourceType
    types = [kinds.TypeMesh, kinds.TypeVectorAnyGeometry] + [kinds.TypeRaster] * rasters
    parameter = QgsProcessingParameterMapLayer(name, label, None, optional, types)
    parameter.setHelp(_HELP + (", or a raster of heights" if rasters else ""))
    return parameter


def height_parameter() -> QgsProcessingParameterDefinition:
    """Return the advanced parameter BAND: which column of a mesh is its height."""
    parameter = QgsProcessingParameterString("BAND", "Band of heights", None, False, True)
    parameter.setHelp(
        "For a mesh that Raster to mesh has made: number or name of the band that is the height. "
        "A mesh of DEM to TIN has its heights"
    )
    parameter.setFlags(parameter.flags() | parameter.Flag.FlagAdvanced)
    return parameter


class MeshAlgorithm(GeomeshAlgorithm):
    """An algorithm that reads the mesh behind the layer INPUT."""

    WORDS: ClassVar[Mapping[str, str]] = {
        "choose the band of heights with --z 1": 'set "Band of heights" (advanced)',
        "choose that of the heights with --z": 'set "Band of heights" (advanced)',
        "--z": "Band of heights",
    }

    path: str
    mesh_name: str

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Find the file of the layer here, because the algorithm runs in another thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        layer = self.parameterAsLayer(parameters, "INPUT", context)
        self.path, self.mesh_name = find_mesh(layer), name_of_mesh(layer)
        return True

    def find_input_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the mesh cannot be used, or an empty text."""
        return find_mesh_fault(self.parameterAsLayer(parameters, "INPUT", context))

    def read_files(self, parameters: dict, context: QgsProcessingContext) -> Sequence[str]:
        """Return the files that the run reads."""
        return [find_mesh(self.parameterAsLayer(parameters, "INPUT", context))]

    def height_options(self, parameters: dict, context: QgsProcessingContext) -> list[str]:
        """Return the geomesh option for BAND."""
        band = self.parameterAsString(parameters, "BAND", context).strip()
        return ["--z", band] if band else []
