"""The algorithm Contours of a TIN: lines of equal height, exact on its triangles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingParameterNumber,
    QgsProcessingParameterVectorDestination,
)

from ..results import NewLayer, chosen_name, dress_vector_layer, load_layers, take_request
from .mesh_input import MeshAlgorithm, height_parameter, mesh_parameter
from .values import find_number_fault, is_given

if TYPE_CHECKING:
    from collections.abc import Mapping


class Contours(MeshAlgorithm):
    """Draws the contours of a TIN."""

    NAME = "contours"
    TITLE = "Contours of a TIN"
    GROUP = "Terrain"
    TAGS = ("isolines", "contour lines", "level", "elevation", "height", "terrain", "mesh", "index")
    SUMMARY = "Draws lines of equal height on a TIN, with thicker and labelled index contours."
    HELP = """
<p>The lines are exact on the triangles and joined into longest lines, and they never cross. Higher
ground is to the left of a line.</p>
<p><b>TIN</b>: a layer that <i>DEM to TIN</i> has made, or any layer of a GeoPackage of geomesh with
heights.<br/>
<b>Interval</b>: from one contour to the next, in the unit of the heights. If not set: a round
number that gives 10 to 20 levels; the log tells it.<br/>
<b>Base</b>: the height from which levels are counted.<br/>
<b>Index contours</b>: every so many levels is an index contour: a thicker line with its level. 0:
none.<br/>
<b>Band of heights</b> (advanced): for a mesh without heights.</p>
"""
    WORDS: ClassVar[Mapping[str, str]] = {
        **MeshAlgorithm.WORDS,
        "--interval": "the interval",
        "--base": "the base",
        "--index": "index contours",
    }

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        number = QgsProcessingParameterNumber
        whole, real = number.Type.Integer, number.Type.Double
        interval = number("INTERVAL", "Interval", real, None, True)
        interval.setHelp("If not set: a round number that gives 10 to 20 levels")
        index = number("INDEX", "Index contours: every so many levels", whole, 5, False, 0)
        index.setHelp("They are thicker and have labels. 0: none")
        for parameter in (
            mesh_parameter("INPUT", "TIN"),
            interval,
            number("BASE", "Base (height from which levels are counted)", real, 0),
            index,
            height_parameter(),
            QgsProcessingParameterVectorDestination(
                "OUTPUT", "Contours", QgsProcessing.SourceType.TypeVectorLine
            ),
        ):
            self.addParameter(parameter)
        self.addOutput(QgsProcessingOutputNumber("LINE_COUNT", "Number of lines"))
        self.addOutput(QgsProcessingOutputNumber("LEVEL_COUNT", "Number of levels"))
        self.addOutput(QgsProcessingOutputNumber("INTERVAL", "Interval"))

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        if is_given(parameters, "INTERVAL", context):
            interval = self.parameterAsDouble(parameters, "INTERVAL", context)
            if not 0 < interval < math.inf:
                return f"Interval is {interval:g}: give a height above 0, or none."
        return (
            self.find_input_fault(parameters, context)
            or find_number_fault(self, parameters)
            or self.find_mesh_output_fault(
                parameters, context, self.read_files(parameters, context)
            )
        )

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Write the contours, style them and let QGIS load them."""
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        options = self.height_options(parameters, context)
        options += ["--base", repr(self.parameterAsDouble(parameters, "BASE", context))]
        options += ["--index", str(self.parameterAsInt(parameters, "INDEX", context))]
        if is_given(parameters, "INTERVAL", context):
            interval = self.parameterAsDouble(parameters, "INTERVAL", context)
            options += ["--interval", repr(interval)]
        figures = self.run_geomesh(["contours", *options, "--", self.path], feedback, output)
        if figures["lines"]:
            feedback.pushInfo(
                f"{figures['lines']:,} lines at {figures['levels']:,} levels from "
                f"{figures['lowest']:g} to {figures['highest']:g}, interval {figures['interval']:g}"
            )
        else:
            feedback.pushWarning("No contours: no level lies between the heights of the TIN")
        dress_vector_layer(output, "contours")
        asked = take_request(context, output)
        if asked is not None:
            chosen = chosen_name(asked, self.parameterDefinition("OUTPUT").description())
            name = chosen or f"Contours of {self.mesh_name}"
            new = NewLayer(output, "contours", name=name, output=asked.outputName)
            load_layers(context, [new], None, asked.project)
        return {
            "OUTPUT": output,
            "LINE_COUNT": figures["lines"],
            "LEVEL_COUNT": figures["levels"],
            "INTERVAL": figures["interval"],
        }
