"""The algorithm DEM to TIN: heights of a raster as a mesh, within a tolerance."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingOutputVectorLayer,
)

from ..files import find_output_fault, is_geopackage, layer_files
from ..heights import find_height_range
from ..inputs import find_raster_fault, nodata_of, raster_options
from ..meshes import TIN, remember_mesh
from ..provenance import read_document
from ..results import (
    NewLayer,
    chosen_name,
    dress_tin,
    dress_vector_layer,
    layer_uri,
    load_layers,
    take_request,
)
from .base import RasterAlgorithm, tell_certificate
from .shapes import find_breaklines_fault, shape_options
from .tin_parameters import find_tin_fault, tin_parameters
from .values import find_number_fault, is_given

if TYPE_CHECKING:
    from collections.abc import Mapping

# What is in the GeoPackage and worth a layer of the project.
_VECTORS = ("triangles", "nodes")


class DemToTin(RasterAlgorithm):
    """Converts a DEM to a triangulated irregular network: a mesh layer with heights."""

    NAME = "demtotin"
    TITLE = "DEM to TIN"
    GROUP = "Terrain"
    TAGS = (
        *("terrain", "elevation", "height", "DTM", "DSM", "surface", "mesh", "raster to TIN"),
        *("triangulation", "triangles", "Delaunay", "breaklines", "simplify", "z tolerance"),
    )
    SUMMARY = (
        "Turns a DEM into a TIN: as few triangles as are needed to stay within a tolerance of "
        "every pixel."
    )
    HELP = """
<p>You can press <b>Run</b> without changing anything. Flat ground gets few and large triangles,
rough ground many and small ones. The TIN is a mesh layer; its colours change at round heights, so
that their borders are contours. It is checked before it is written.</p>
<p><b>Tolerance</b>: no valid pixel is farther from the TIN, in the DEM's unit. If not set: a
hundredth of the range of heights.<br/>
<b>Most nodes</b>: an upper limit. If it comes before the tolerance, you get the best TIN of so many
nodes, and the log tells its largest error.<br/>
<b>Breaklines</b>: lines or polygons that become edges of the TIN.<br/>
<b>Boundary</b>: polygons. The TIN covers the ground inside.<br/>
<b>Smallest angle</b>: no triangle has a smaller one.<br/>
<b>Z factor</b> (advanced): multiplies the heights.<br/>
<b>Triangles and nodes</b>: the TIN as vector layers with Z, in a GeoPackage, which the other
algorithms for terrain read.</p>
<p>Pixels without data stay without triangles.</p>
"""
    WORDS: ClassVar[Mapping[str, str]] = {
        "--max-error": "the tolerance",
        "--nodes": "Most nodes",
        "--mask": "the boundary",
        "--z-factor": "the Z factor",
        "--z ": "the band of heights ",
    }

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        for parameter in tin_parameters():
            self.addParameter(parameter)
        points = QgsProcessing.SourceType.TypeVectorPoint
        for output in (
            QgsProcessingOutputVectorLayer("NODES_LAYER", "Nodes", points),
            QgsProcessingOutputNumber("NODE_COUNT", "Number of nodes"),
            QgsProcessingOutputNumber("TRIANGLE_COUNT", "Number of triangles"),
            QgsProcessingOutputNumber("MAX_ERROR", "Largest height error"),
            QgsProcessingOutputNumber("TOLERANCE", "Tolerance"),
        ):
            self.addOutput(output)

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        raster = self.parameterAsRasterLayer(parameters, "INPUT", context)
        read = [
            *layer_files(raster),
            *layer_files(self.parameterAsVectorLayer(parameters, "BOUNDARY", context)),
            *layer_files(self.parameterAsVectorLayer(parameters, "BREAKLINES", context)),
        ]
        return (
            find_raster_fault(raster)
            or find_number_fault(self, parameters)
            or find_tin_fault(self, parameters, context)
            or self.find_mesh_layer_fault("OUTPUT", parameters, context, read)
            or self._find_vectors_fault(parameters, context, read)
            or find_breaklines_fault(self, parameters, context)
        )

    def _find_vectors_fault(
        self, parameters: dict, context: QgsProcessingContext, read: list[str]
    ) -> str:
        path = self.parameterAsOutputLayer(parameters, "VECTORS", QgsProcessingContext())
        if not path:
            return ""
        if not is_geopackage(path):
            return f"{path} does not end in .gpkg: only a GeoPackage holds triangles and nodes."
        return find_output_fault(path, context.project(), read)

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Make the TIN, style it and let QGIS load it."""
        tin = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        vectors = self.parameterAsOutputLayer(parameters, "VECTORS", context)
        with tempfile.TemporaryDirectory(prefix="geomesh-") as name:
            folder = Path(name)
            stored = vectors or str(folder / "mesh.gpkg")
            source = raster_options(self.raster, folder, feedback)
            options, tolerance = self._options(source[-1], parameters, context, feedback)
            options += shape_options(self, parameters, context, folder, feedback, area="BOUNDARY")
            figures = self.run_geomesh(["mesh", *options, *source], feedback, stored, (0, 0.9))
            self.run_geomesh(["convert", "--", stored], feedback, tin, (0.9, 1))
            about = read_document(stored)
        dress_tin(tin)
        uris = {layer: layer_uri(vectors, layer) for layer in _VECTORS if vectors}
        for layer, uri in uris.items():
            dress_vector_layer(uri, layer)
        self._load(context, tin, vectors, about)
        tell_certificate(figures, about, feedback)
        feedback.pushInfo(_about_heights(about))
        results = {
            "OUTPUT": tin,
            "NODE_COUNT": figures["nodes"],
            "TRIANGLE_COUNT": figures["triangles"],
            "MAX_ERROR": about["refinement"]["bands"][0]["max_error"],
            "TOLERANCE": tolerance,
        }
        if vectors:
            results |= {"VECTORS": uris["triangles"], "NODES_LAYER": uris["nodes"]}
        return results

    def _options(
        self,
        path: str,
        parameters: dict,
        context: QgsProcessingContext,
        feedback: QgsProcessingFeedback,
    ) -> tuple[list[str], float]:
        """Return the geomesh options for numbers, and the tolerance."""
        band = self.parameterAsInt(parameters, "BAND", context)
        heights = find_height_range(path, band, nodata_of(self.raster), feedback)
        if is_given(parameters, "TOLERANCE", context):
            tolerance = self.parameterAsDouble(parameters, "TOLERANCE", context)
            feedback.pushInfo(f"Tolerance: {tolerance:g}")
        else:
            # A flat DEM fits any tolerance.
            tolerance = float(f"{(heights.span or 1) / 100:.3g}")
            feedback.pushInfo(
                f"Tolerance: {tolerance:g}, a hundredth of the range of heights "
                f"({heights.low:g} to {heights.high:g})"
            )
        angle = self.parameterAsDouble(parameters, "MIN_ANGLE", context)
        factor = self.parameterAsDouble(parameters, "Z_FACTOR", context)
        options = ["--preset", "adaptive", "--bidx", str(band), "--z", str(band)]
        options += ["--max-error", repr(tolerance), "--min-angle", repr(angle)]
        if factor != 1:
            options += ["--z-factor", repr(factor)]
        if is_given(parameters, "NODES", context):
            options += ["--nodes", str(self.parameterAsInt(parameters, "NODES", context))]
        if heights.is_scaled:
            options += ["--unscale"]  # QGIS shows these heights, not the numbers in the file
        return options, tolerance

    def _load(self, context: QgsProcessingContext, tin: str, vectors: str, about: dict) -> None:
        """Let QGIS load the TIN, as it does for its own TINs, and vectors if it was going to."""
        name = self.raster.name
        new = [
            NewLayer(
                tin,
                "TIN",
                name=f"{TIN}{name}",
                output="OUTPUT",
                is_mesh=True,
                dress=partial(remember_mesh, path=vectors) if vectors else None,
            )
        ]
        asked = take_request(context, vectors) if vectors else None
        if asked is not None:
            triangles, nodes = (layer_uri(vectors, layer) for layer in _VECTORS)
            chosen = chosen_name(asked, self.parameterDefinition("VECTORS").description())
            new = [
                NewLayer(triangles, "triangles", name, chosen, asked.outputName),
                *new,
                NewLayer(nodes, "nodes", name, output="NODES_LAYER"),
            ]
        load_layers(context, new, about, context.project())


def _about_heights(about: dict) -> str:
    """Return the unit of the heights as geomesh knows it."""
    height = about["mesh"]["height"]
    unit = height["unit"]
    told = f"heights: in {unit.replace('foot', 'feet') if 'foot' in unit else unit + 's'}"
    if height["assumed"]:
        told += ", which is assumed"
    return told if height["factor"] == 1 else f"{told}, times {height['factor']:g}"
