"""The algorithm Stages of the pipeline: a figure with four panels."""

from __future__ import annotations

import tempfile
from pathlib import Path

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterRasterLayer,
)

from ..files import layer_files
from ..inputs import find_raster_fault, raster_options
from ..reports import picture_report, save_report
from .base import PRESETS, RasterAlgorithm, preset_parameter
from .recipe_parameters import find_recipe_fault, recipe_options, recipe_parameters
from .values import find_number_fault


class Stages(RasterAlgorithm):
    """Draws the result of each stage of the pipeline."""

    NAME = "stages"
    TITLE = "Stages of the pipeline"
    GROUP = "Inspect"
    TAGS = ("figure", "Canny", "SIFT", "edges", "keypoints", "Delaunay", "picture")
    SUMMARY = "Draws the result of each stage: gray image, Canny edges, keypoints and mesh."
    HELP = """
<p>Use it to understand a mesh and to choose thresholds. An adaptive mesh only begins with the
keypoints; then its nodes move. If the raster has more than 2048 pixels a
side, only its middle is shown. To show another part, set the <b>extent</b>.</p>
"""

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        for parameter in (
            QgsProcessingParameterRasterLayer("INPUT", "Raster"),
            preset_parameter(),
            QgsProcessingParameterExtent("EXTENT", "Extent to show", None, True),
            *recipe_parameters(),
            QgsProcessingParameterFileDestination(
                "OUTPUT",
                "Picture",
                "PNG files (*.png);;PDF files (*.pdf);;SVG files (*.svg)",
            ),
            QgsProcessingParameterFileDestination(
                "REPORT", "Stages report", "HTML files (*.html)", None, True
            ),
        ):
            self.addParameter(parameter)

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        raster = self.parameterAsRasterLayer(parameters, "INPUT", context)
        read = [*layer_files(raster), self.parameterAsFile(parameters, "RECIPE", context)]
        return (
            find_raster_fault(raster)
            or self.find_file_output_fault("OUTPUT", parameters, context, read)
            or self.find_file_output_fault("REPORT", parameters, context, read)
            or find_number_fault(self, parameters)
            or find_recipe_fault(self, parameters, context)
        )

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Draw the figure and show it in the report."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        report = self.parameterAsFileOutput(parameters, "REPORT", context)
        options = ["--preset", list(PRESETS)[self.parameterAsEnum(parameters, "PRESET", context)]]
        options += self.extent_options(parameters, context)
        options += recipe_options(self, parameters, context)
        with tempfile.TemporaryDirectory(prefix="geomesh-") as name:
            source = raster_options(self.raster, Path(name), feedback)
            self.run_geomesh(["stages", *options, *source], feedback, output)
        if not report:
            return {"OUTPUT": output}
        save_report(picture_report(f"Stages of {self.raster.name}", Path(output)), report)
        return {"OUTPUT": output, "REPORT": report}
