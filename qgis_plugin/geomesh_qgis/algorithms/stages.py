"""Stages of the pipeline: the four-panel figure."""

from __future__ import annotations

import tempfile
from pathlib import Path

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterRasterLayer,
)

from ..inputs import bounds_options, describe_raster, raster_path
from ..reports import picture_report
from .base import PRESETS, GeomeshAlgorithm
from .recipe_parameters import find_recipe_fault, recipe_options, recipe_parameters


class Stages(GeomeshAlgorithm):
    """Draws what each stage of the pipeline gives."""

    NAME = "stages"
    TITLE = "Stages of the pipeline"
    GROUP = "Inspect"
    TAGS = ("figure", "Canny", "SIFT", "edges", "keypoints", "Delaunay", "picture")
    SUMMARY = "Draws what each stage gives: gray image, Canny edges, keypoints and mesh."
    HELP = """
<p>To see why a mesh is as it is, and to choose thresholds. A raster of more than 2048 pixels a side
is shown by its middle; choose another part by its <b>extent</b>.</p>
"""

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Declare the parameters and the outputs."""
        for parameter in (
            QgsProcessingParameterRasterLayer("INPUT", "Raster"),
            QgsProcessingParameterEnum("PRESET", "Preset", list(PRESETS.values()), False, 0),
            QgsProcessingParameterExtent("EXTENT", "Extent to show", None, True),
            *recipe_parameters(),
            QgsProcessingParameterFileDestination(
                "OUTPUT",
                "Picture",
                "PNG files (*.png);;PDF files (*.pdf);;SVG files (*.svg)",
            ),
            QgsProcessingParameterFileDestination(
                "REPORT", "Report", "HTML files (*.html)", None, True
            ),
        ):
            self.addParameter(parameter)

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values cannot work, or an empty text."""
        return find_recipe_fault(self, parameters, context)

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Ask the raster layer what is needed: later this runs in another thread."""
        layer = self.parameterAsRasterLayer(parameters, "INPUT", context)
        if layer is None or not layer.isValid():
            raise QgsProcessingException("The raster cannot be read; choose another one.")
        self._raster = describe_raster(layer)
        return True

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Draw the figure and show it in the report."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        report = self.parameterAsFileOutput(parameters, "REPORT", context)
        options = list(self._raster.options)
        options += ["--preset", list(PRESETS)[self.parameterAsEnum(parameters, "PRESET", context)]]
        extent = self.parameterAsExtent(parameters, "EXTENT", context, self._raster.crs)
        if not extent.isNull():
            options += bounds_options(extent)
        options += recipe_options(self, parameters, context)
        with tempfile.TemporaryDirectory(prefix="geomesh-") as name:
            source = raster_path(self._raster, Path(name), feedback)
            self.run_geomesh(["stages", *options, "--", source], feedback, output)
        if not report:
            return {"OUTPUT": output}
        Path(report).write_text(
            picture_report(f"Stages of {self._raster.name}", Path(output)), encoding="utf-8"
        )
        return {"OUTPUT": output, "REPORT": report}
