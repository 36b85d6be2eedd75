"""The algorithm Export TIN: a mesh with heights in a format of engineers or of 3-D programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
)

from .mesh_input import MeshAlgorithm, height_parameter, mesh_parameter
from .values import find_number_fault, is_given

if TYPE_CHECKING:
    from collections.abc import Mapping

FORMATS = {
    ".xml": "LandXML 1.2",
    ".dxf": "AutoCAD DXF",
    ".stl": "STL",
    ".obj": "Wavefront OBJ",
    ".ply": "PLY",
    ".glb": "glTF",
    ".vtu": "VTK",
    ".2dm": "SMS 2DM mesh",
    ".gr3": "SELFE and SCHISM grid",
    ".nc": "UGRID mesh",
}


class ExportTin(MeshAlgorithm):
    """Writes a TIN for another program."""

    NAME = "exporttin"
    TITLE = "Export TIN"
    GROUP = "Terrain"
    TAGS = (
        *("LandXML", "DXF", "STL", "OBJ", "PLY", "GLB", "glTF", "VTU", "2DM", "gr3", "CAD"),
        *("3D", "print", "stake-out", "terrain", "mesh", "surface", "convert"),
    )
    SUMMARY = "Writes a TIN for CAD, machine control, 3-D printing, games or flow models."
    HELP = """
<p>The <b>extension</b> of the file chooses the format:</p>
<p><i>.xml</i> LandXML 1.2: points, faces, breaklines, CRS and units<br/>
<i>.dxf</i> faces, and breaklines as 3-D polylines<br/>
<i>.stl</i> a surface, or a closed solid to print<br/>
<i>.obj</i>, <i>.ply</i>, <i>.glb</i>, <i>.vtu</i> models for 3-D programs<br/>
<i>.2dm</i>, <i>.gr3</i>, <i>.nc</i> meshes for flow models; QGIS opens .2dm and .nc</p>
<p><b>TIN</b>: a layer that <i>DEM to TIN</i> has made, or any layer of a GeoPackage of geomesh with
heights.<br/>
<b>Base of a solid</b>: for .stl. The height of the flat bottom, in the unit of the heights.<br/>
<b>Band of heights</b> (advanced): for a mesh without heights.</p>
<p>The log tells what a format cannot hold: some store metres from a local origin, or no CRS.</p>
"""
    WORDS: ClassVar[Mapping[str, str]] = {**MeshAlgorithm.WORDS, "--solid": "the base of a solid"}

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        real = QgsProcessingParameterNumber.Type.Double
        filters = ";;".join(f"{name} (*{extension})" for extension, name in FORMATS.items())
        base = QgsProcessingParameterNumber("SOLID", "Base of a solid (STL)", real, None, True)
        base.setHelp("Height of the flat bottom. If not set: the surface alone")
        for parameter in (
            mesh_parameter("INPUT", "TIN"),
            base,
            height_parameter(),
            QgsProcessingParameterFileDestination("OUTPUT", "Exported TIN", filters),
        ):
            self.addParameter(parameter)

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", QgsProcessingContext())
        extension = Path(output).suffix.lower()
        if extension not in FORMATS:
            return f"{output} has no extension of a format: choose one of {', '.join(FORMATS)}."
        if is_given(parameters, "SOLID", context) and extension != ".stl":
            return f"Base of a solid is for STL, and {output} is none: clear it, or write an .stl."
        read = self.read_files(parameters, context)
        return (
            self.find_input_fault(parameters, context)
            or find_number_fault(self, parameters)
            or self.find_file_output_fault("OUTPUT", parameters, context, read)
        )

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Write the file."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        options = self.height_options(parameters, context)
        if is_given(parameters, "SOLID", context):
            options += ["--solid", repr(self.parameterAsDouble(parameters, "SOLID", context))]
        figures = self.run_geomesh(["convert", *options, "--", self.path], feedback, output)
        feedback.pushInfo(f"{figures['nodes']:,} nodes, {figures['triangles']:,} triangles")
        return {"OUTPUT": output}
