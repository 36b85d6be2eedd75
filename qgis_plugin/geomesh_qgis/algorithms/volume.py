"""The algorithm Volume of a TIN: cut and fill over a level, another TIN, or a raster."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
    QgsRasterLayer,
)

from ..files import layer_files
from ..inputs import RasterInput, describe_raster, find_raster_fault, raster_options
from ..meshes import find_mesh, find_mesh_fault
from ..reports import save_report, volume_report
from .mesh_input import MeshAlgorithm, height_parameter, mesh_parameter
from .values import find_number_fault, is_given

if TYPE_CHECKING:
    from collections.abc import Mapping

# Numbers of geomesh, and what the outputs call them.
FIGURES = {
    "cut": "Cut",
    "fill": "Fill",
    "net": "Net (cut minus fill)",
    "cut_area": "Area of cut",
    "fill_area": "Area of fill",
    "missing_area": "Area without heights",
}

# Without a CRS, nothing says how long a map unit is.
_UNITS = {"m3": ("m³", "m²")}
_NO_METRES = ("map units² × m", "map units²")


class Volume(MeshAlgorithm):
    """Measures the volume between a TIN and a base."""

    NAME = "volume"
    TITLE = "Volume of a TIN"
    GROUP = "Terrain"
    TAGS = ("cut", "fill", "earthwork", "stockpile", "reservoir", "terrain", "mesh", "surface")
    SUMMARY = "Measures cut and fill between a TIN and a level, another TIN, or a raster."
    HELP = """
<p><b>Cut</b> is the volume of the TIN above the base, <b>fill</b> the volume below it: what has to
be taken away and brought to make the ground as the base is. <b>Net</b> is cut minus fill. Volumes
are in cubic metres, areas in square metres, and both are exact for the two surfaces.</p>
<p><b>TIN</b>: a layer that <i>DEM to TIN</i> has made, or any layer of a GeoPackage of geomesh with
heights.<br/>
<b>Base level</b>: a height, in the unit of the heights.<br/>
<b>Base surface</b>: another TIN, or a raster of heights with one band, instead of a level. Both
need the same CRS. What only one of them covers is left out, and reported as an area.<br/>
If neither is set: the lowest height of the TIN.</p>
<p>The report in the results viewer shows all numbers.</p>
"""
    WORDS: ClassVar[Mapping[str, str]] = {**MeshAlgorithm.WORDS, "--base": "the base"}

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        real = QgsProcessingParameterNumber.Type.Double
        level = QgsProcessingParameterNumber("LEVEL", "Base level", real, None, True)
        level.setHelp("In the unit of the heights. If no base is set: the lowest height of the TIN")
        for parameter in (
            mesh_parameter("INPUT", "TIN"),
            level,
            mesh_parameter("BASE", "Base surface", rasters=True, optional=True),
            height_parameter(),
            QgsProcessingParameterFileDestination(
                "REPORT", "Volume report", "HTML files (*.html)", None, True
            ),
        ):
            self.addParameter(parameter)
        for name, label in FIGURES.items():
            self.addOutput(QgsProcessingOutputNumber(name.upper(), label))

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        has_level = is_given(parameters, "LEVEL", context)
        if has_level and is_given(parameters, "BASE", context):
            return "The base is set twice, as a level and as a surface: clear one of the two."
        if has_level and not math.isfinite(self.parameterAsDouble(parameters, "LEVEL", context)):
            return "Base level is not a height: give a number."
        base = self.parameterAsLayer(parameters, "BASE", context)
        read = [*self.read_files(parameters, context), *layer_files(base)]
        return (
            self.find_input_fault(parameters, context)
            or find_number_fault(self, parameters)
            or self._find_base_fault(parameters, context)
            or self.find_file_output_fault("REPORT", parameters, context, read)
        )

    def _find_base_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        if not is_given(parameters, "BASE", context):
            return ""
        base = self.parameterAsLayer(parameters, "BASE", context)
        if base is None:
            return "The base surface cannot be read: choose another one."
        if isinstance(base, QgsRasterLayer):
            return find_raster_fault(base)
        return find_mesh_fault(base)

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Read the properties of the base here, because the algorithm runs in another thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        base = self.parameterAsLayer(parameters, "BASE", context)
        self._base: RasterInput | str = (
            describe_raster(base) if isinstance(base, QgsRasterLayer) else find_mesh(base)
        )
        self._base_name = "" if base is None else base.name()
        return True

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Measure the volume. Write the report."""
        report = self.parameterAsFileOutput(parameters, "REPORT", context)
        options = self.height_options(parameters, context)
        with tempfile.TemporaryDirectory(prefix="geomesh-") as folder:
            base = self._base
            if is_given(parameters, "LEVEL", context):
                base = repr(self.parameterAsDouble(parameters, "LEVEL", context))
            elif isinstance(base, RasterInput):
                if base.options:
                    feedback.pushWarning(
                        f"CRS and nodata value of {base.name} are those of its file, not those "
                        "that were set in the layer properties"
                    )
                base = raster_options(base, Path(folder), feedback)[-1]
            options += ["--base", base] if base else []
            found = self.run_geomesh(["volume", *options, "--", self.path], feedback, None)
        over = self._base_name or f"level {found['base']:,.10g}"
        volume, area = _UNITS.get(found["unit"], _NO_METRES)
        rows = {
            label: f"{found[name]:,.1f} {area if 'area' in name else volume}"
            for name, label in FIGURES.items()
        }
        for label, value in rows.items():
            feedback.pushInfo(f"{label}: {value}")
        results = {name.upper(): found[name] for name in FIGURES}
        if report:
            save_report(volume_report(self.mesh_name, over, rows), report)
            results["REPORT"] = report
        return results
