"""The algorithm Mesh quality: Ki and the standard measures."""

from __future__ import annotations

import tempfile
from pathlib import Path

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterVectorDestination,
    QgsProcessingParameterVectorLayer,
    QgsProviderRegistry,
)

from ..files import is_geopackage
from ..provenance import read_document
from ..reports import quality_report, save_report
from ..results import dress_vector_layer, layer_uri, load_when_done
from .base import GeomeshAlgorithm

SPACES = ("image", "map")

# Share of the progress that measuring has, if a page is made too.
_SHARE = 0.6


class MeshQuality(GeomeshAlgorithm):
    """Computes quality measures of the triangles of a mesh."""

    NAME = "meshquality"
    TITLE = "Mesh quality"
    GROUP = "Inspect"
    TAGS = ("triangles", "Ki", "angle", "aspect ratio", "shape", "measure", "statistics")
    SUMMARY = "Measures every triangle of a mesh: the paper's Ki and the standard quality measures."
    HELP = """
<p>The output has one field for each measure. The quality report in the results viewer shows a
summary. The page, also in the results viewer, shows all about the mesh, to read and to print: a map
with the worst triangles, the image beside the mesh, the certificate in words, and the recipe.</p>
<p><b>Mesh</b>: any layer of a GeoPackage that <i>Raster to mesh</i> has written.<br/>
<b>Unit of lengths</b>: pixels of the image, or map units. With map units, there is a second set of
fields, whose names begin with <i>map_</i>.</p>
"""

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        self.addParameter(
            QgsProcessingParameterVectorLayer(
                "INPUT", "Mesh", [QgsProcessing.SourceType.TypeVectorAnyGeometry]
            )
        )
        self.addParameter(
            QgsProcessingParameterEnum(
                "SPACE", "Unit of lengths", ["pixels of the image", "map units"], False, 0
            )
        )
        self.addParameter(
            QgsProcessingParameterVectorDestination(
                "OUTPUT", "Measured triangles", QgsProcessing.SourceType.TypeVectorPolygon
            )
        )
        self.addParameter(
            QgsProcessingParameterFileDestination(
                "REPORT", "Quality report", "HTML files (*.html)", None, True
            )
        )
        self.addParameter(
            QgsProcessingParameterFileDestination(
                "PAGE", "Page about the mesh, to print", "HTML files (*.html)", None, True
            )
        )
        self.addOutput(QgsProcessingOutputNumber("KI_MEAN", "Mean Ki"))
        self.addOutput(QgsProcessingOutputNumber("MIN_ANGLE", "Smallest angle (degrees)"))

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        path = self._find_path(parameters, context)
        if not is_geopackage(path):
            return (
                "The layer is not from a GeoPackage that Raster to mesh has written: choose a "
                "layer of such a file."
            )
        return (
            self.find_mesh_output_fault(parameters, context, [path])
            or self.find_file_output_fault("REPORT", parameters, context, [path])
            or self._find_page_fault(parameters, context, path)
        )

    def _find_page_fault(self, parameters: dict, context: QgsProcessingContext, path: str) -> str:
        page = self.parameterAsFileOutput(parameters, "PAGE", QgsProcessingContext())
        if page and not page.lower().endswith((".html", ".htm")):
            return f"{page} does not end in .html: the page is an HTML file."
        return self.find_file_output_fault("PAGE", parameters, context, [path])

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Get the file of the layer here, because the algorithm runs in another thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        self._path = self._find_path(parameters, context)
        return True

    def _find_path(self, parameters: dict, context: QgsProcessingContext) -> str:
        layer = self.parameterAsVectorLayer(parameters, "INPUT", context)
        parts = QgsProviderRegistry.instance().decodeUri("ogr", layer.source()) if layer else {}
        return str(parts.get("path") or "")

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Compute the measures. Write the fields, the report and the page."""
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        report = self.parameterAsFileOutput(parameters, "REPORT", context)
        page = self.parameterAsFileOutput(parameters, "PAGE", context)
        space = SPACES[self.parameterAsEnum(parameters, "SPACE", context)]
        with tempfile.TemporaryDirectory(prefix="geomesh-") as folder:
            whole = is_geopackage(output)
            stored = output if whole else str(Path(folder) / "mesh.gpkg")
            measured = _SHARE if page else 1
            share = measured if whole else 0.8 * measured
            summary = self.run_geomesh(
                ["quality", "--space", space, "--", self._path], feedback, stored, (0, share)
            )
            if not whole:
                self.run_geomesh(["convert", "--", stored], feedback, output, (share, measured))
            if page:
                self.run_geomesh(["report", "--", self._path], feedback, page, (measured, 1))
            about = read_document(stored)
        uri = layer_uri(output, "triangles")
        dress_vector_layer(uri, "quality")
        name = Path(self._path).stem
        load_when_done(
            context,
            output,
            {"triangles": uri},
            title=f"{name}, measured",
            unnamed=self.parameterDefinition("OUTPUT").description(),
            about=about,
        )
        measures = summary["measures"]
        found = {
            "OUTPUT": uri,
            "KI_MEAN": measures["ki"]["mean"],
            "MIN_ANGLE": measures["min_angle"]["min"],
        }
        if report:
            unit = "pixels" if space == "image" else "map units"
            save_report(quality_report(name, summary, unit), report)
            found["REPORT"] = report
        if page:
            found["PAGE"] = page
        return found
